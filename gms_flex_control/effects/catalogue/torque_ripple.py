# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Ripple of motor or gear, periodic in the motor angle."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import HIGHEST_ORDER, orders, waves
from gms_flex_control.effects.signals import MOTOR_TORQUE, Q_MOTOR
import numpy as np


class TorqueRipple(Term):
    """y += amplitude sin(order q_motor + phase)."""

    name = 'torque_ripple'
    stage = Stage.MOTOR
    slowest = 1.5             # order it is looked for: a slower wave is a constant and a slope
    evidence = 'motor angle'
    confusable = ('kinematic_error',)
    tells = 'the same path under another load'
    fed_forward = True
    parameters = (
        Parameter('amplitude', 'N m', 'amplitude', lower=0.0),
        Parameter('order', '1', 'periods per revolution', lower=0.0),
        Parameter('phase', 'rad', 'phase at q_motor = 0'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return waves(0.05 * scales.friction,
                     (*orders(scales.turned, HIGHEST_ORDER, 2.0), *scales.fine_orders))

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.1 * scales.friction, None, None)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[MOTOR_TORQUE] += p[0] * np.sin(p[1] * s[Q_MOTOR] + p[2])
