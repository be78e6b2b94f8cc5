# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Play in the transmission."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import TWIST, TWIST_RATE


class Backlash(Term):
    """The spring carries no torque within the gap: e -> dz(e, half_gap)."""

    name = 'backlash'
    stage = Stage.TWIST
    parameters = (
        Parameter('half_gap', 'rad', 'half width of the play', lower=0.0),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        e = s[TWIST]
        s[TWIST] = e - min(max(e, -p[0]), p[0])
        if -p[0] < e < p[0]:
            s[TWIST_RATE] = 0.0
