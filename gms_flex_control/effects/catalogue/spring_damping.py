# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Damping of the joint spring beyond the modelled one."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import SPRING, TWIST_RATE


class SpringDamping(Term):
    """s += damping (dq_motor - dq_link)."""

    name = 'spring_damping'
    stage = Stage.SPRING
    parameters = (
        Parameter('damping', 'N m s/rad', 'damping of the twist', lower=0.0),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[SPRING] += p[0] * s[TWIST_RATE]
