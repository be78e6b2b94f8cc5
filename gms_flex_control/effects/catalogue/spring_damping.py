# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Damping of the joint spring beyond the modelled one."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import SPRING, TORSION_RATE


class SpringDamping(Term):
    """s += damping (dq_motor - dq_link)."""

    name = 'spring_damping'
    stage = Stage.SPRING
    evidence = 'time since reversal'
    discriminated_by = 'free swings of the link with the motor held'
    parameters = (Parameter('damping', 'N m s/rad', 'damping of the torsion', lower=0.0,
                            typical=lambda s: 0.2 * (s.inertia * s.spring / s.torsion) ** 0.5),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.003, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[SPRING] += p[0] * s[TORSION_RATE]
