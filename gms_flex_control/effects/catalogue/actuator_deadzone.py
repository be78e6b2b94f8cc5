# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Small commands that move nothing."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import TORQUE


class ActuatorDeadzone(Term):
    """u -> dz(u, deadzone)."""

    name = 'actuator_deadzone'
    stage = Stage.ACTUATOR
    parameters = (
        Parameter('deadzone', 'N m', 'half width', lower=0.0),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[TORQUE] -= min(max(s[TORQUE], -p[0]), p[0])
