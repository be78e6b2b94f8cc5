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
    confusable = ()
    tells = 'slow motion of the motor with the link taken off'
    parameters = (
        Parameter('coulomb', 'N m', 'level', lower=0.0),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1 * scales.friction, positive=True)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.3 * scales.friction,)

    @classmethod
    def holding_torque(cls, values):
        """Return the friction torque [N m] that it adds where a motor stands still."""
        return values[0]

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[MOTOR_TORQUE] -= p[0] * min(max(s[DQ_MOTOR] * 1e3, -1.0), 1.0)
