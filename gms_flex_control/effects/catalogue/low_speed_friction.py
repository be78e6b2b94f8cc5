# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction at low speed of another shape than the Stribeck curve."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import shapes
from gms_flex_control.effects.signals import DQ_LINK, FRICTION
import numpy as np


class LowSpeedFriction(Term):
    """
    F -> F (1 + ratio exp(-abs(v) / velocity)).

    Sign, and what friction is at rest, are those of the blocks. A Stribeck curve cannot rise with
    speed; this one does where the ratio is below zero.
    """

    name = 'low_speed_friction'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('stribeck_error',)
    discriminated_by = 'slow motion at many constant speeds'
    fed_forward = True
    parameters = (
        Parameter('ratio', '1', 'relative change as the speed nears zero', relative=True,
                  typical=0.3),
        Parameter('velocity', 'rad/s', 'speed over which it decays', lower=0.0,
                  typical=lambda s: 0.3 * s.speed))
    guesses = staticmethod(
        lambda s: shapes(0.1, s.speed * np.geomspace(0.03, 0.6, 5), positive=False))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[FRICTION] *= 1.0 + p[0] * np.exp(-abs(s[DQ_LINK]) / p[1])
