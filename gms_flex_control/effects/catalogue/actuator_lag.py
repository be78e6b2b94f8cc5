# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""First-order lag of the torque loop."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import sizes
from gms_flex_control.effects.signals import TORQUE
import numpy as np


class ActuatorLag(Term):
    """time_constant du/dt + u = command, the mean over the step, exact for a held command."""

    name = 'actuator_lag'
    stage = Stage.ACTUATOR
    memory_size = 1
    evidence = 'time since reversal'
    confusable = ('input_delay', 'recording_delay')
    discriminated_by = 'torque that changes faster, up to a tenth of the sample rate'
    of_feedback = True
    needs_commands = True
    parameters = (Parameter('time_constant', 's', 'time constant', lower=0.0, typical=8e-3),)
    guesses = staticmethod(lambda s: sizes((0.001, 0.003, 0.006, 0.012, 0.02)))
    excludes = staticmethod(lambda rigid: ('input_delay',))  # their sum alone shows

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[0] > 0.0:
            short, gone = memory[0] - s[TORQUE], -np.expm1(-dt / p[0])
            memory[0] -= short * gone
            s[TORQUE] += short * gone * p[0] / dt
