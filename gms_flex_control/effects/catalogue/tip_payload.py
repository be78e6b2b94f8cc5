# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Mass carried at the tip."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear
from gms_flex_control.params.robot import RobotParams
import numpy as np


class TipPayload(Change):
    """
    The last link carries a point mass at its end.

    In space that is the frame ``arm.tip``, or the farthest one that is fixed to the last link.
    """

    name = 'tip_payload'
    whole_arm = True
    needs_chain = True
    evidence = 'link acceleration'
    confusable = ('link_inertia_error',)
    discriminated_by = 'the same motion with the last link bent and stretched'
    parameters = (Parameter('mass', 'kg', 'mass of the payload', lower=0.0,
                            typical=lambda s: 0.1 * s.mass),)
    guesses = staticmethod(lambda s: linear(0.05, positive=True))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        arm = robot.arm
        mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
        end = arm.length[-1] if arm.frames is None else arm.frames.end
        whole = mass[-1] + values[0]
        if whole == 0.0:
            return robot
        com[-1] = (arm.mass[-1] * arm.com[-1] + values[0] * end) / whole
        inertia[-1] += (_about(arm.mass[-1], arm.com[-1] - com[-1])
                        + _about(values[0], end - com[-1]))
        mass[-1] = whole
        return replace(robot, arm=replace(arm, mass=mass, com=com, inertia=inertia))


def _about(mass, away):
    """Return the inertia of a mass at a distance, or at a vector (3,) in space."""
    if np.ndim(away) == 0:
        return mass * away ** 2
    return mass * (away @ away * np.eye(3) - np.outer(away, away))
