# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Largest torque the actuator gives."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import sizes
from gms_flex_control.effects.signals import TORQUE
import numpy as np


class ActuatorSaturation(Term):
    """u -> clip(u, limit)."""

    name = 'actuator_saturation'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    discriminated_by = 'faster motion, which asks for torque well beyond the limit'
    needs_commands = True
    parameters = (Parameter('limit', 'N m', 'largest torque either way', lower=0.0),)
    guesses = staticmethod(lambda s: sizes(s.torque * np.linspace(0.2, 0.95, 16)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORQUE] = min(max(s[TORQUE], -p[0]), p[0])
