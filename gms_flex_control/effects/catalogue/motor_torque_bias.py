# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Constant torque on the motor, as from an amplifier offset."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import MOTOR_TORQUE


class MotorTorqueBias(Term):
    """y += bias."""

    name = 'motor_torque_bias'
    stage = Stage.MOTOR
    parameters = (
        Parameter('bias', 'N m', 'torque'),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[MOTOR_TORQUE] += p[0]
