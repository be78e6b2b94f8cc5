# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Stop met beyond an angle: a one-sided spring."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import Guess
from gms_flex_control.effects.signals import LINK_TORQUE, Q_LINK
import numpy as np


class EndStop(Term):
    """x -= stiffness (q_link - angle) beyond the angle, on its side of zero."""

    name = 'end_stop'
    stage = Stage.LINK
    evidence = 'link angle'
    discriminated_by = 'slow motion into the stop and out of it'
    parameters = (
        Parameter('angle', 'rad', 'where it begins'),
        Parameter('stiffness', 'N m/rad', 'stiffness of the stop', lower=0.0,
                  typical=lambda s: s.friction / 0.01))

    @staticmethod
    def guesses(scales) -> list:
        span, stiffness = scales.highest - scales.lowest, scales.friction / 0.05
        inside = span * np.array([0.02, 0.05, 0.1, 0.18])
        above, below = scales.highest - inside, scales.lowest + inside
        return [Guess(((angle, stiffness),), lambda c, angle=angle: (angle, c[0] * stiffness), 0.0)
                for angle in (*above[above > 0.0], *below[below < 0.0])]

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        depth = s[Q_LINK] - p[0]
        if depth * p[0] > 0.0:
            s[LINK_TORQUE] -= p[1] * depth
