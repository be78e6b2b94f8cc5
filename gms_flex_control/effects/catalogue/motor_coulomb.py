# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Dry friction of the motor side."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_MOTOR, MOTOR_TORQUE


class MotorCoulomb(Term):
    """y -= coulomb sgn(dq_motor), linear below 1e-3 rad/s so that it can hold."""

    name = 'motor_coulomb'
    stage = Stage.MOTOR
    evidence = 'motor rate'
    discriminated_by = 'slow motion of the motor with the link taken off'
    parameters = (Parameter('coulomb', 'N m', 'level', lower=0.0,
                            typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction, positive=True))
    holding_torque = staticmethod(lambda values: values[0])

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] -= p[0] * min(max(s[DQ_MOTOR] * 1e3, -1.0), 1.0)
