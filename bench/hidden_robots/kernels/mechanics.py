# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Equation (1) written out for one or two joints, and for any number that do not interact."""

from functools import cache

from bench.hidden_robots.kernels import compiled
from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.effects import table as effect_table
from gms_flex_control.records import FLOAT
import numpy as np


@cache
def constants_layout(n, n_blocks):
    """
    Return the dtype of a hidden robot's constants.

    ``planar``, 1 for a chain of two; ``own`` (n,), the diagonal inertia in absolute angles, and
    ``cross``, that of links 1 and 2 together [kg m^2]; ``moment`` (n,) [kg m]; ``gravity``;
    ``offset``; ``motor_inertia``, ``stiffness``, ``damping``, ``flexible`` (n,); ``carried``
    (n,), inertia that couples the motor of a joint with the link before it [kg m^2]; ``base``,
    inertia [kg m^2], frequency [rad/s] and damping ratio of the base, inertia 0 for none.
    """
    vectors = ('own', 'moment', 'offset', 'motor_inertia', 'stiffness', 'damping', 'flexible',
               'carried')
    return records.layout(
        *((name, FLOAT, (n,)) for name in vectors), ('planar', FLOAT, (1,)),
        ('cross', FLOAT, (1,)), ('gravity', FLOAT, (2,)), ('base', FLOAT, (3,)),
        ('friction', gms.constants_layout(n, n_blocks)), ('effects', effect_table.LAYOUT))


def constants(robot, *, carried=None, base=(0.0, 1.0, 0.0)):
    """
    Return a robot without changes among its effects as the record the kernels take.

    It has two joints in a plane, or joints that do not interact. ``carried`` (n_joints,) is the
    inertia that couples each motor with the link before it [kg m^2]; ``base`` inertia, angular
    frequency and damping ratio of a base that gives way, inertia 0: none.
    """
    arm, n = robot.arm, robot.n_joints
    planar = arm.kind == 'planar' and n == 2
    own = arm.inertia + arm.mass * arm.com ** 2
    moment, cross, offset = arm.mass * arm.com, 0.0, np.array(arm.offset)
    if planar:
        own[0] += arm.mass[1] * arm.length[0] ** 2
        moment[0] += arm.mass[1] * arm.length[0]
        cross = arm.length[0] * moment[1]
    return records.build(
        constants_layout(*robot.friction.stiffness.shape), planar=float(planar), own=own,
        cross=cross, moment=moment, gravity=arm.gravity, offset=offset,
        motor_inertia=arm.motor_inertia, flexible=~arm.rigid,
        stiffness=np.where(arm.rigid, 0.0, arm.stiffness),
        damping=np.where(arm.rigid, 0.0, arm.damping),
        carried=np.zeros(n) if carried is None else carried, base=base,
        friction=gms.constants_of(robot.friction),
        effects=effect_table.build(robot.effects, robot.joints))


@compiled
def weight(c, j, angle):
    """Return the torque of gravity about joint ``j`` of a link at an absolute ``angle``."""
    return c.moment[j] * (c.gravity[1] * np.cos(angle) - c.gravity[0] * np.sin(angle))


@compiled
def accelerate(c, q, v, link_torque, motor_torque, link, motor):
    """
    Write the accelerations of links and motors (n,) into ``link`` and ``motor``.

    ``link_torque`` and ``motor_torque`` (n,) are all torques on them but those of inertia and
    gravity; of a rigid joint the motor's is part of the link's.
    """
    if c.planar[0] > 0.0:
        accelerate_chain(c, q, v, link_torque, motor_torque, link, motor)
        return
    for j in range(q.shape[0]):
        torque = link_torque[j] + weight(c, j, q[j] + c.offset[j])
        if c.flexible[j]:
            link[j] = torque / c.own[j]
            motor[j] = motor_torque[j] / c.motor_inertia[j]
        else:
            link[j] = torque / (c.own[j] + c.motor_inertia[j])
            motor[j] = link[j]


@compiled
def accelerate_chain(c, q, v, link_torque, motor_torque, link, motor):
    """Write the accelerations of two links in a plane and of their motors; see accelerate."""
    first = q[0] + c.offset[0]
    between = q[1] + c.offset[1]
    coupled = c.cross[0] * np.cos(between)
    h = c.cross[0] * np.sin(between)
    outer = weight(c, 1, first + between)
    right_1 = link_torque[0] + weight(c, 0, first) + outer + h * (2.0 * v[0] + v[1]) * v[1]
    right_2 = link_torque[1] + outer - h * v[0] * v[0]
    m_11 = c.own[0] + c.own[1] + 2.0 * coupled
    m_12 = c.own[1] + coupled
    m_22 = c.own[1]
    if not c.flexible[0]:
        m_11 += c.motor_inertia[0]
    if not c.flexible[1]:
        m_22 += c.motor_inertia[1]
    s = c.carried[1]
    if s != 0.0:  # the motor of joint 2 turns with link 1: eliminated from its equation
        m_11 -= s * s / c.motor_inertia[1]
        right_1 -= s * motor_torque[1] / c.motor_inertia[1]
    determinant = m_11 * m_22 - m_12 * m_12
    link[0] = (m_22 * right_1 - m_12 * right_2) / determinant
    link[1] = (m_11 * right_2 - m_12 * right_1) / determinant
    for j in range(2):
        motor[j] = link[j]
        if c.flexible[j]:
            motor[j] = motor_torque[j] / c.motor_inertia[j]
    if s != 0.0:
        motor[1] -= s * link[0] / c.motor_inertia[1]
