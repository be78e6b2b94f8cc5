# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The robot as a controller may wrongly believe it to be."""

from dataclasses import replace

from gms_flex_control.params.friction import FrictionParams
from gms_flex_control.params.robot import RobotParams

# the mixed model error of docs/model.md
FRICTION, STIFFNESS, MASS = 0.85, 1.05, 0.93


def scaled_friction(friction, factor) -> FrictionParams:
    """
    Return FrictionParams with every torque level scaled; displacements and v_s stay.

    Scaled are static, coulomb, viscous and block stiffness.
    """
    return friction.each_way(
        lambda steady: steady.scaled(static=factor, coulomb=factor, viscous=factor),
        stiffness=friction.stiffness * factor)


def mixed_error(robot) -> RobotParams:
    """Return the robot with friction x 0.85, joint stiffness x 1.05 and link masses x 0.93."""
    return replace(robot, friction=scaled_friction(robot.friction, FRICTION), arm=replace(
        robot.arm.scaled(MASS), stiffness=robot.arm.stiffness * STIFFNESS))
