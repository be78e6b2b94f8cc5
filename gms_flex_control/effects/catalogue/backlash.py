# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Play in the transmission."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import sizes
from gms_flex_control.effects.signals import TORSION, TORSION_RATE
import numpy as np


class Backlash(Term):
    """The spring carries no torque within the gap: e -> dz(e, half_gap)."""

    name = 'backlash'
    stage = Stage.TORSION
    evidence = 'torsion'
    confusable = ('actuator_deadzone',)
    discriminated_by = 'slow reversals under load, and with the link free'
    parameters = (Parameter('half_gap', 'rad', 'half width of the play', lower=0.0,
                            typical=lambda s: 0.2 * s.torsion),)
    guesses = staticmethod(
        lambda s: [] if s.rigid else sizes(s.torsion * np.geomspace(0.01, 0.6, 12)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        e = s[TORSION]
        s[TORSION] = e - min(max(e, -p[0]), p[0])
        if -p[0] < e < p[0]:
            s[TORSION_RATE] = 0.0
