# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Slope of the friction over velocity other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, FRICTION
from gms_flex_control.params.friction import StribeckParams
import numpy as np


class ViscousError(Term):
    """F -> F + slope v."""

    name = 'viscous_error'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('quadratic_drag',)
    discriminated_by = 'faster motion, over a range of speeds of 1 to 5'
    replaces = 'viscous'
    least_is_value = True     # no viscous friction at all
    parameters = (Parameter('slope', 'N m s/rad', 'further viscous friction',
                            typical=lambda s: 0.3 * s.friction / s.speed),)
    guesses = staticmethod(lambda s: linear(0.1 * s.friction / s.speed))

    @classmethod
    def search_bounds(cls, joint_index, robot) -> tuple[list[float], list[float]]:
        """Return what is looked for, two lists: all of it may be gone either way."""
        steady = robot.friction.forward, robot.friction.backward
        return [-max(float(one.viscous[joint_index]) for one in steady)], [cls.parameters[0].upper]

    @staticmethod
    def in_friction(steady, direction, values) -> StribeckParams:
        return replace(steady, viscous=np.maximum(steady.viscous + values[0], 0.0))

    @staticmethod
    def apply(s, p, memory, dt) -> None:
        s[FRICTION] += p[0] * s[DQ_LINK]
