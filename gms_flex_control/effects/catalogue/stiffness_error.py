# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Joint stiffness other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear
from gms_flex_control.params.robot import RobotParams


class StiffnessError(Change):
    """K -> K (1 + ratio)."""

    name = 'stiffness_error'
    evidence = 'torsion'
    confusable = ('stiffness_drift',)
    discriminated_by = 'a longer recording, or one before and one after warming up'
    replaces = 'stiffness'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.99, relative=True,
                            typical=0.2),)
    guesses = staticmethod(lambda s: [] if s.rigid else linear(0.1))
    excludes = staticmethod(lambda rigid: () if rigid else ('torque_gain',))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        stiffness = robot.arm.stiffness.copy()
        stiffness[joint] *= 1.0 + values[0]
        return replace(robot, arm=replace(robot.arm, stiffness=stiffness))
