# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Torque constant other than believed."""

from gms_flex_control.effects.base import LEAST_RELATIVE, Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import TORQUE


class TorqueGain(Term):
    """u -> u (1 + gain_error)."""

    name = 'torque_gain'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    discriminated_by = 'a known weight hung on the link'
    # no drive gives more than twice its torque
    parameters = (Parameter('gain_error', '1', 'relative error', searched=(LEAST_RELATIVE, 1.0),
                            typical=0.2),)
    guesses = staticmethod(lambda s: linear(0.1))
    # together they would scale the whole joint
    excludes = staticmethod(lambda rigid: ('link_inertia_error', 'motor_inertia_error') if rigid
                            else ('stiffness_error',))
    torque_scale = staticmethod(lambda values, supply: 1.0 + values[0])

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORQUE] *= 1.0 + p[0]
