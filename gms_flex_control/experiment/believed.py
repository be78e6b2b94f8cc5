# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The robot as a controller may wrongly believe it to be."""

from dataclasses import replace

# the mixed model error of docs/model.md
FRICTION, STIFFNESS, MASS = 0.85, 1.05, 0.93


def scaled_friction(friction, factor):
    """
    Return FrictionParams with every torque level scaled; displacements and v_s stay.

    Parameters
    ----------
    friction : FrictionParams
        True friction.
    factor : float
        Of static, coulomb, viscous and block stiffness.

    Returns
    -------
    FrictionParams

    """
    def of_direction(steady):
        return replace(steady, static=steady.static * factor, coulomb=steady.coulomb * factor,
                       viscous=steady.viscous * factor)

    return replace(friction, forward=of_direction(friction.forward),
                   backward=of_direction(friction.backward),
                   stiffness=friction.stiffness * factor)


def mixed_error(robot):
    """
    Return the robot with friction x 0.85, joint stiffness x 1.05 and link masses x 0.93.

    Parameters
    ----------
    robot : RobotParams
        As it is.

    Returns
    -------
    RobotParams
        As the controller believes it to be.

    """
    arm = replace(robot.arm, stiffness=robot.arm.stiffness * STIFFNESS,
                  mass=robot.arm.mass * MASS, inertia=robot.arm.inertia * MASS)
    return replace(robot, arm=arm, friction=scaled_friction(robot.friction, FRICTION))
