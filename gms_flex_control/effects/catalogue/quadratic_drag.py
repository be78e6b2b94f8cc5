# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Drag of a fluid."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, LINK_TORQUE


class QuadraticDrag(Term):
    """x -= drag dq abs(dq)."""

    name = 'quadratic_drag'
    stage = Stage.LINK
    evidence = 'link rate'
    confusable = ('viscous_error',)
    discriminated_by = 'faster motion, over a range of speeds of 1 to 5'
    fed_forward = True
    parameters = (Parameter('drag', 'N m s^2/rad^2', 'coefficient', lower=0.0,
                            typical=lambda s: 0.2 * s.friction / s.speed ** 2),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed ** 2, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[LINK_TORQUE] -= p[0] * s[DQ_LINK] * abs(s[DQ_LINK])
