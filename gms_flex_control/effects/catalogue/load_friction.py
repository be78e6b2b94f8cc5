# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction that grows with the torque carried."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import FRICTION, SPRING


class LoadFriction(Term):
    """
    F -> F (1 + ratio abs(s) / load).

    s is what the transmission carries: weight, inertia and friction of the link. Along a recording
    it follows from the motion where the joint is rigid: torque explains no torque.
    """

    name = 'load_friction'
    stage = Stage.FRICTION
    evidence = 'torsion'
    discriminated_by = 'the same motion under another load'
    fed_forward = True
    parameters = (
        Parameter('ratio', '1', 'relative growth at the load', lower=0.0, relative=True,
                  typical=0.2),
        Parameter('load', 'N m', 'torque at which it is reached', lower=0.0, fixed=True))
    guesses = staticmethod(lambda s: linear(0.1, s.spring, positive=True))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if p[1] > 0.0:
            s[FRICTION] *= 1.0 + p[0] * abs(s[SPRING]) / p[1]
