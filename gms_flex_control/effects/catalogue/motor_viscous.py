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
    confusable = ()
    tells = 'fast motion of the motor with the link taken off'
    fed_forward = True
    parameters = (
        Parameter('viscous', 'N m s/rad', 'viscous coefficient', lower=0.0),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1 * scales.friction / scales.speed, positive=True)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.2 * scales.friction / scales.speed,)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[MOTOR_TORQUE] -= p[0] * s[DQ_MOTOR]
