# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Friction that changes over the run, by warming or wear."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import FRICTION, TIME


class FrictionDrift(Term):
    """F -> F (1 + ratio t / duration)."""

    name = 'friction_drift'
    stage = Stage.FRICTION
    parameters = (
        Parameter('ratio', '1', 'relative change over the duration'),
        Parameter('duration', 's', 'time in which the change happens', lower=0.0),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        if p[1] > 0.0:
            s[FRICTION] *= 1.0 + p[0] * s[TIME] / p[1]
