# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Ripple of motor or gear, periodic in the motor angle."""

import math

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import HIGHEST_ORDER, orders, waves
from gms_flex_control.effects.signals import MOTOR_TORQUE, Q_MOTOR
import numpy as np


class TorqueRipple(Term):
    """y += amplitude sin(order q_motor + phase)."""

    name = 'torque_ripple'
    stage = Stage.MOTOR
    evidence = 'motor angle'
    confusable = ('kinematic_error',)
    discriminated_by = 'the same motion under another load'
    fed_forward = True
    parameters = (
        Parameter('amplitude', 'N m', 'amplitude', lower=0.0, typical=lambda s: 0.1 * s.friction),
        Parameter('order', '1', 'periods per revolution', lower=0.0,
                  searched=(1.5, math.inf)),  # a slower wave is a constant and a slope
        Parameter('phase', 'rad', 'phase at q_motor = 0'))
    guesses = staticmethod(lambda s: waves(
        0.05 * s.friction, (*orders(s.turned, HIGHEST_ORDER, 2.0), *s.fine_orders)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[MOTOR_TORQUE] += p[0] * np.sin(p[1] * s[Q_MOTOR] + p[2])
