# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Rest position of the spring away from zero."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.signals import TWIST


class SpringOffset(Term):
    """e -> e + offset."""

    name = 'spring_offset'
    stage = Stage.TWIST
    parameters = (
        Parameter('offset', 'rad', 'twist of the unloaded spring, negative'),
    )

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[TWIST] += p[0]
