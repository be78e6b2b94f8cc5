# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Friction stronger one way than the other."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, FRICTION


class FrictionAsymmetry(Term):
    """F -> F (1 + ratio sgn(dq_link))."""

    name = 'friction_asymmetry'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('constant_link_torque',)
    tells = 'motion both ways over the whole range, with rests between'
    parameters = (
        Parameter('ratio', '1', 'relative difference'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        if s[DQ_LINK] > 0.0:
            s[FRICTION] *= 1.0 + p[0]
        elif s[DQ_LINK] < 0.0:
            s[FRICTION] *= 1.0 - p[0]
