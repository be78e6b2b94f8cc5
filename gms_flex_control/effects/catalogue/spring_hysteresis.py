# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Rate-independent loss in the spring."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import shapes
from gms_flex_control.effects.signals import SPRING, TORSION
import numpy as np


class SpringHysteresis(Term):
    """A Maxwell element beside the spring: it yields at a force, after a torsion."""

    name = 'spring_hysteresis'
    stage = Stage.SPRING
    memory_size = 3
    evidence = 'torsion'
    discriminated_by = 'slow torque up and down to several heights, with the link held'
    parameters = (
        Parameter('force', 'N m', 'torque at which the element yields', lower=0.0,
                  typical=lambda s: 0.2 * s.friction),
        Parameter('yield', 'rad', 'torsion at which it yields', lower=0.0,
                  typical=lambda s: s.torsion))
    guesses = staticmethod(lambda s: [] if s.rigid else shapes(
        0.1 * s.friction, s.torsion * np.geomspace(0.02, 2.0, 8)))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        e_before, torque, begun = memory[0], memory[1], memory[2]
        if begun > 0.0 and p[1] > 0.0:
            torque += p[0] / p[1] * (s[TORSION] - e_before)
        memory[0], memory[1], memory[2] = s[TORSION], min(max(torque, -p[0]), p[0]), 1.0
        s[SPRING] += memory[1]
