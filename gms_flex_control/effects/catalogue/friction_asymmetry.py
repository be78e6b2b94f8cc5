# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Friction stronger one way than the other."""

from dataclasses import replace

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.signals import DQ_LINK, FRICTION
import numpy as np


class FrictionAsymmetry(Term):
    """F -> F (1 + ratio sgn(dq_link))."""

    name = 'friction_asymmetry'
    stage = Stage.FRICTION
    evidence = 'link rate'
    confusable = ('constant_link_torque', 'viscous_asymmetry')
    tells = 'motion both ways over the whole range, with rests between'
    replaces = 'asymmetry'
    parameters = (
        Parameter('ratio', '1', 'relative difference', relative=True),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.1)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.2,)

    @classmethod
    def search_bounds(cls, joint_index, robot):
        """Return what is looked for, two lists: as much more one way as less the other."""
        lower, upper = super().search_bounds(joint_index, robot)
        return lower, [-lower[0], *upper[1:]]

    @classmethod
    def in_friction(cls, steady, direction, values):
        """Return the friction parameters of one direction with the effect in them."""
        factor = np.maximum(1.0 + direction * values[0], 0.05)  # levels stay above zero
        return replace(steady, static=steady.static * factor, coulomb=steady.coulomb * factor,
                       viscous=steady.viscous * factor)

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        if s[DQ_LINK] > 0.0:
            s[FRICTION] *= 1.0 + p[0]
        elif s[DQ_LINK] < 0.0:
            s[FRICTION] *= 1.0 - p[0]
