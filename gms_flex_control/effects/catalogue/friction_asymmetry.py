# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction stronger one way than the other."""

from dataclasses import replace

from gms_flex_control.effects.base import LEAST_RELATIVE, Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, FRICTION
from gms_flex_control.params.friction import StribeckParams
import numpy as np


class FrictionAsymmetry(Term):
    """F -> F (1 + ratio sgn(dq_link))."""

    name = 'friction_asymmetry'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('constant_link_torque', 'viscous_asymmetry')
    discriminated_by = 'motion both ways over the whole range, with rests between'
    replaces = 'asymmetry'
    parameters = (Parameter('ratio', '1', 'relative difference', typical=0.2,
                            searched=(LEAST_RELATIVE, -LEAST_RELATIVE)),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        factor = np.maximum(1.0 + direction * values[0], 0.05)  # levels stay above zero
        return replace(steady, static=steady.static * factor, coulomb=steady.coulomb * factor,
                       viscous=steady.viscous * factor)

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        if s[DQ_LINK] > 0.0:
            s[FRICTION] *= 1.0 + p[0]
        elif s[DQ_LINK] < 0.0:
            s[FRICTION] *= 1.0 - p[0]
