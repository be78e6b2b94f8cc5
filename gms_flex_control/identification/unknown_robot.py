# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A robot nobody has described: each joint a rigid axis of its own, to be estimated whole."""

from dataclasses import fields, replace

from gms_flex_control.errors import IdentificationError
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.friction import FrictionParams, StribeckParams
from gms_flex_control.params.robot import EncoderParams, RobotParams
import numpy as np


def rigid_axes(recording):
    """
    Return a robot of decoupled rigid axes with placeholders for all it would have to know.

    Parameters
    ----------
    recording : Recording
        Names the joints.

    Returns
    -------
    RobotParams
        As `rigid_joints`.

    """
    return rigid_joints(recording.joints)


def rigid_joints(names):
    """
    Return a robot of decoupled rigid axes of these names.

    Parameters
    ----------
    names : sequence of str
        Of the joints.

    Returns
    -------
    RobotParams
        Unit inertia and friction; `--estimate all` replaces them.

    """
    n = len(names)
    one, zero = np.ones(n), np.zeros(n)
    steady = StribeckParams(static=one, coulomb=one, velocity=one, viscous=zero)
    return RobotParams(
        joints=tuple(names), motors=('',) * n, encoder=EncoderParams(),
        arm=ArmParams(kind='decoupled', mass=zero, length=zero, com=zero, inertia=one,
                      motor_inertia=zero, stiffness=np.full(n, np.inf), damping=zero),
        friction=FrictionParams(forward=steady, backward=steady, stiffness=np.full((n, 1), 100.0),
                                weight=np.ones((n, 1)), attraction=one))


def only_joints(robot, joints):
    """
    Return a decoupled robot with some of its joints.

    Parameters
    ----------
    robot : RobotParams
        All joints.
    joints : sequence of str
        Which to keep, in this order.

    Raises
    ------
    IdentificationError
        If a joint is not the robot's, or the joints of the arm act on each other.

    """
    unknown = [joint for joint in joints if joint not in robot.joints]
    if unknown:
        raise IdentificationError(f'--joints {unknown[0]}: the robot has '
                                  f'{", ".join(robot.joints)}')
    if robot.arm.kind != 'decoupled' and tuple(joints) != robot.joints:
        raise IdentificationError('the links of an arm act on each other: identify all '
                                  'its joints together, or describe it as decoupled axes')
    order = [robot.joints.index(joint) for joint in joints]
    friction = robot.friction
    return replace(
        robot, joints=tuple(joints), motors=tuple(robot.motors[k] for k in order),
        arm=_taken(robot.arm, order, ('kind', 'gravity')),
        friction=_taken(friction, order, ('forward', 'backward'),
                        forward=_taken(friction.forward, order),
                        backward=_taken(friction.backward, order)),
        effects=tuple(spec for spec in robot.effects if spec.joint in joints))


def _taken(params, order, kept=(), **values):
    taken = {field.name: getattr(params, field.name)[order] for field in fields(params)
             if field.name not in kept}
    return replace(params, **taken, **values)
