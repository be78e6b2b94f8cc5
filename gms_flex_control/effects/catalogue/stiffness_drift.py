# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Spring that changes over the run, as by warming."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import SPRING, TIME


class StiffnessDrift(Term):
    """s -> s (1 + ratio t / duration), and as at its end after the duration."""

    name = 'stiffness_drift'
    stage = Stage.SPRING
    evidence = 'time'
    confusable = ('stiffness_error',)
    discriminated_by = 'a longer recording, or one before and one after warming up'
    parameters = (
        Parameter('ratio', '1', 'relative change over the duration', relative=True, typical=0.2),
        Parameter('duration', 's', 'time in which the change happens', lower=0.0, fixed=True))
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1, s.duration))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[SPRING] *= 1.0 + p[0] * min(s[TIME] / p[1], 1.0)
