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
    def of_direction(steady):
        return replace(steady, static=steady.static * factor, coulomb=steady.coulomb * factor,
                       viscous=steady.viscous * factor)

    return replace(friction, forward=of_direction(friction.forward),
                   backward=of_direction(friction.backward),
                   stiffness=friction.stiffness * factor)


def mixed_error(robot) -> RobotParams:
    """Return the robot with friction x 0.85, joint stiffness x 1.05 and link masses x 0.93."""
    arm = replace(robot.arm, stiffness=robot.arm.stiffness * STIFFNESS,
                  mass=robot.arm.mass * MASS, inertia=robot.arm.inertia * MASS)
    return replace(robot, arm=arm, friction=scaled_friction(robot.friction, FRICTION))


def random_error(rng, robot, least=0.01, most=0.03) -> RobotParams:
    """
    Return a robot as its user may believe it to be: every parameter a little off, no effects.

    Every relative error has a size of ``least`` to ``most`` and either sign; those of mass and
    inertia of a link are one.
    """
    def off(values):
        shape = np.shape(values)
        return 1.0 + rng.uniform(least, most, shape) * rng.choice([-1.0, 1.0], shape)

    arm, friction, sides = robot.arm, robot.friction, []
    links = off(arm.mass)
    for steady in (friction.forward, friction.backward):
        level = off(steady.static)
        sides.append(replace(steady, static=steady.static * level, coulomb=steady.coulomb * level,
                             velocity=steady.velocity * off(steady.velocity),
                             viscous=steady.viscous * off(steady.viscous)))
    return replace(
        robot, effects=(),
        arm=replace(arm, mass=arm.mass * links, inertia=arm.inertia * links,
                    motor_inertia=arm.motor_inertia * off(arm.motor_inertia),
                    stiffness=arm.stiffness * off(arm.stiffness)),
        friction=replace(friction, forward=sides[0], backward=sides[1],
                         stiffness=friction.stiffness * off(friction.stiffness[:, :1]),
                         attraction=friction.attraction * off(friction.attraction)))
