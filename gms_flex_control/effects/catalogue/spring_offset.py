# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Rest position of the spring away from zero."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import TORSION


class SpringOffset(Term):
    """e -> e + offset."""

    name = 'spring_offset'
    stage = Stage.TORSION
    evidence = 'torsion'
    confusable = ('constant_link_torque',)
    discriminated_by = 'a recording with another load, or with the link held'
    needs_link_encoder = True
    parameters = (Parameter('offset', 'rad', 'torsion of the unloaded spring, negative',
                            typical=lambda s: 0.2 * s.torsion),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.05 * s.torsion))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[TORSION] += p[0]
