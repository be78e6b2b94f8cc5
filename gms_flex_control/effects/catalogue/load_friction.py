# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Friction that grows with the torque carried."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import FRICTION, SPRING


class LoadFriction(Term):
    """F -> F (1 + ratio abs(s) / load)."""

    name = 'load_friction'
    stage = Stage.FRICTION
    evidence = 'twist'
    confusable = ()
    tells = 'the same motion under another load'
    parameters = (
        Parameter('ratio', '1', 'relative growth at the load', lower=0.0),
        Parameter('load', 'N m', 'torque at which it is reached', lower=0.0),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1, scales.spring, positive=True)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        if p[1] > 0.0:
            s[FRICTION] *= 1.0 + p[0] * abs(s[SPRING]) / p[1]
