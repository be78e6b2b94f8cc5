# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Constant torque on the motor, as from an amplifier offset."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import MOTOR_TORQUE


class MotorTorqueBias(Term):
    """y += bias."""

    name = 'motor_torque_bias'
    stage = Stage.MOTOR
    evidence = 'motor rate'
    discriminated_by = 'a recording with another load, or with the link held'
    fed_forward = True
    parameters = (Parameter('bias', 'N m', 'torque', typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] += p[0]
