# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction that varies with the position of the link."""

import math

from gms_flex_control.effects.base import LEAST_RELATIVE, Parameter, Stage, Term
from gms_flex_control.effects.guess import orders, waves
from gms_flex_control.effects.signals import FRICTION, Q_LINK
import numpy as np


class PositionFriction(Term):
    """F -> F (1 + ratio cos(order q_link + phase))."""

    name = 'position_friction'
    stage = Stage.FRICTION
    evidence = 'link angle'
    discriminated_by = 'slow motion both ways over the whole range'
    fed_forward = True
    parameters = (
        Parameter('ratio', '1', 'relative variation', typical=0.2,
                  searched=(LEAST_RELATIVE, -LEAST_RELATIVE)),
        Parameter('order', '1', 'periods per revolution', lower=0.0, searched=(0.7, math.inf)),
        Parameter('phase', 'rad', 'phase at q_link = 0'))
    guesses = staticmethod(lambda s: waves(0.1, orders(s.highest - s.lowest, 6.0)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[FRICTION] *= 1.0 + p[0] * np.cos(p[1] * s[Q_LINK] + p[2])
