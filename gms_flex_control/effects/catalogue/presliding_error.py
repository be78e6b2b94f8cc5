# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction before sliding other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import Guess
from gms_flex_control.params.robot import RobotParams
import numpy as np

_RESOLVED = 4  # counts of an encoder within which no block slips: fewer show no loop


class PreslidingError(Change):
    """
    k_i -> (1 + stiffness) k_i; alpha_i -> alpha_i (1 + tilt x_i), their sum kept.

    x_i goes from -1 of the softest block of the joint to 1 of the stiffest, in equal steps.
    """

    name = 'presliding_error'
    evidence = 'time since reversal'
    confusable = ('friction_hysteresis',)
    discriminated_by = 'many small reversals, of a few mrad'
    replaces = 'blocks'
    parameters = (
        Parameter('stiffness', '1', 'relative error of all block stiffnesses', lower=-0.95,
                  typical=0.5),
        Parameter('tilt', '1', 'load moved from the softer to the stiffer blocks', lower=-1.0,
                  upper=1.0, typical=0.3))

    @staticmethod
    def guesses(scales) -> list:
        """Return how it might be there, list of Guess; not where counts hide presliding."""
        if scales.count * _RESOLVED > scales.presliding:
            return []
        return [Guess(((-0.3, 0.0),), lambda c: (max(-0.3 * c[0], -0.9), 0.0))]

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        friction = robot.friction
        stiffness, weight = friction.stiffness.copy(), friction.weight.copy()
        order = np.argsort(np.argsort(stiffness[joint], kind='stable'), kind='stable')
        tilted = weight[joint] * (1.0 + values[1] * (2.0 * order / max(len(order) - 1, 1) - 1.0))
        if tilted.sum() > 0.0:
            weight[joint] = tilted / tilted.sum()
        stiffness[joint] *= 1.0 + values[0]
        return replace(robot, friction=replace(friction, stiffness=stiffness, weight=weight))
