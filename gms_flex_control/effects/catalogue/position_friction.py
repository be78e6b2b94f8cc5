# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Friction that varies with the position of the link."""

from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.guess import orders, waves
from gms_flex_control.effects.signals import FRICTION, Q_LINK
import numpy as np


class PositionFriction(Term):
    """F -> F (1 + ratio cos(order q_link + phase))."""

    name = 'position_friction'
    stage = Stage.FRICTION
    slowest = 0.7             # order it is looked for
    evidence = 'link angle'
    confusable = ()
    tells = 'slow motion both ways over the whole range'
    fed_forward = True
    parameters = (
        Parameter('ratio', '1', 'relative variation', relative=True),
        Parameter('order', '1', 'periods per revolution', lower=0.0),
        Parameter('phase', 'rad', 'phase at q_link = 0'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return waves(0.1, orders(scales.highest - scales.lowest, 6.0))

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.2, None, None)

    @classmethod
    def search_bounds(cls, joint_index, robot):
        """Return what is looked for, two lists: as much more one way as less the other."""
        lower, upper = super().search_bounds(joint_index, robot)
        return lower, [-lower[0], *upper[1:]]

    @staticmethod
    def apply(s, p, memory, dt):
        """Change the signals of one joint."""
        s[FRICTION] *= 1.0 + p[0] * np.cos(p[1] * s[Q_LINK] + p[2])
