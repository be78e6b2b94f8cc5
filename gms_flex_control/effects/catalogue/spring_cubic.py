# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Spring that stiffens or softens with torsion."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import SPRING, TORSION


class SpringCubic(Term):
    """s += cubic e^3."""

    name = 'spring_cubic'
    stage = Stage.SPRING
    evidence = 'torsion'
    discriminated_by = 'slow torque up to the largest, both ways, with the link held'
    parameters = (Parameter('cubic', 'N m/rad^3', 'cubic stiffness',
                            typical=lambda s: 0.1 * s.spring / s.torsion ** 3),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1 * s.spring / s.torsion ** 3))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[SPRING] += p[0] * s[TORSION] ** 3
