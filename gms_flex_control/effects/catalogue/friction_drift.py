# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction that changes over the run, by warming or wear."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import FRICTION, TIME


class FrictionDrift(Term):
    """F -> F (1 + ratio t / duration), and as at its end after the duration."""

    name = 'friction_drift'
    stage = Stage.FRICTION
    evidence = 'time'
    confusable = ('coulomb_error',)
    discriminated_by = 'the same motion at the beginning and at the end of a long run'
    parameters = (
        Parameter('ratio', '1', 'relative change over the duration', relative=True, typical=0.3),
        Parameter('duration', 's', 'time in which the change happens', lower=0.0, fixed=True))
    guesses = staticmethod(lambda s: linear(0.1, s.duration))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[FRICTION] *= 1.0 + p[0] * min(s[TIME] / p[1], 1.0)
