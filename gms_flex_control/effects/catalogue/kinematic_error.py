# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Position error of a strain-wave gear, twice per motor revolution."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import wave
from gms_flex_control.effects.signals import Q_MOTOR, TORSION
import numpy as np


class KinematicError(Term):
    """e -> e + amplitude sin(2 q_motor + phase)."""

    name = 'kinematic_error'
    stage = Stage.TORSION
    evidence = 'motor angle'
    confusable = ('torque_ripple',)
    discriminated_by = 'the same motion under another load'
    needs_link_encoder = True
    parameters = (
        Parameter('amplitude', 'rad', 'amplitude of the error', lower=0.0,
                  typical=lambda s: 0.1 * s.torsion),
        Parameter('phase', 'rad', 'phase at q_motor = 0'))
    guesses = staticmethod(lambda s: [] if s.rigid else wave(0.02 * s.torsion))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORSION] += p[0] * np.sin(2.0 * s[Q_MOTOR] + p[1])
