# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Joint stiffness other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter


class StiffnessError(Change):
    """K -> K (1 + ratio)."""

    name = 'stiffness_error'
    parameters = (
        Parameter('ratio', '1', 'relative error', lower=-0.99),
    )

    @staticmethod
    def change(robot, joint, values):
        """Return the robot with the effect in it."""
        stiffness = robot.arm.stiffness.copy()
        stiffness[joint] *= 1.0 + values[0]
        return replace(robot, arm=replace(robot.arm, stiffness=stiffness))
