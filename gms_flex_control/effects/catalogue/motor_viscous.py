# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Viscous friction of the motor side."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_MOTOR, MOTOR_TORQUE


class MotorViscous(Term):
    """y -= viscous dq_motor."""

    name = 'motor_viscous'
    stage = Stage.MOTOR
    evidence = 'motor rate'
    discriminated_by = 'fast motion of the motor with the link taken off'
    fed_forward = True
    parameters = (Parameter('viscous', 'N m s/rad', 'viscous coefficient', lower=0.0,
                            typical=lambda s: 0.2 * s.friction / s.speed),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] -= p[0] * s[DQ_MOTOR]
