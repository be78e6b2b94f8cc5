# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Small commands that move nothing."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import sizes
from gms_flex_control.effects.signals import TORQUE
import numpy as np


class ActuatorDeadzone(Term):
    """u -> dz(u, deadzone)."""

    name = 'actuator_deadzone'
    stage = Stage.ACTUATOR
    evidence = 'torque'
    confusable = ('backlash',)
    discriminated_by = 'fast motion with small torque beside slow motion with large torque'
    needs_commands = True
    parameters = (Parameter('deadzone', 'N m', 'half width', lower=0.0,
                            typical=lambda s: 0.3 * s.friction),)
    guesses = staticmethod(lambda s: sizes(s.friction * np.geomspace(0.02, 1.0, 10)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORQUE] -= min(max(s[TORQUE], -p[0]), p[0])
