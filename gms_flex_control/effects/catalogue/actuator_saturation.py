# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Largest torque the actuator gives."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import TORQUE


class ActuatorSaturation(Term):
    """u -> clip(u, limit)."""

    name = 'actuator_saturation'
    stage = Stage.ACTUATOR
    parameters = (
        Parameter('limit', 'N m', 'largest torque either way', lower=0.0),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[TORQUE] = min(max(s[TORQUE], -p[0]), p[0])
