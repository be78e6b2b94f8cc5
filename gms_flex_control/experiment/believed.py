# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The robot as a controller may wrongly believe it to be."""

from dataclasses import replace

from gms_flex_control.params.friction import FrictionParams
from gms_flex_control.params.robot import RobotParams
import numpy as np

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


def random_error(rng, robot, least=0.01, most=0.03) -> RobotParams:
    """
    Return a robot as its user may believe it to be: every parameter a little off, no effects.

    Every relative error has a size of ``least`` to ``most`` and either sign; those of mass and
    inertia of a link are one.
    """
    def off(values):
        shape = np.shape(values)
        return 1.0 + rng.uniform(least, most, shape) * rng.choice([-1.0, 1.0], shape)

    def off_way(steady):
        level = off(steady.static)
        return steady.scaled(static=level, coulomb=level, velocity=off(steady.velocity),
                             viscous=off(steady.viscous))

    arm, friction = robot.arm, robot.friction
    links, friction = off(arm.mass), friction.each_way(off_way)  # the order is that of the draws
    return replace(
        robot, effects=(),
        arm=replace(arm.scaled(links), motor_inertia=arm.motor_inertia * off(arm.motor_inertia),
                    stiffness=arm.stiffness * off(arm.stiffness)),
        friction=replace(friction, stiffness=friction.stiffness * off(friction.stiffness[:, :1]),
                         attraction=friction.attraction * off(friction.attraction)))
