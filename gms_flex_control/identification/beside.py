# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction known otherwise, such as that of a simulated plant, beside what was identified."""

from gms_flex_control.friction.stribeck import steady_friction
from gms_flex_control.schema.build import robot_values
import numpy as np


def known_values(robot, found, joint):
    """
    Return the parameters of one joint by the names of estimates.

    Parameters
    ----------
    robot : RobotParams
        Of known parameters.
    found : RobotParams
        The identified one; it tells the order of the blocks.
    joint : str
        Which joint.

    Returns
    -------
    dict of str to float
        Blocks are matched in the order they slip; they are left out where their number differs,
        since then no block stands for another.

    """
    values = {}
    if joint not in robot.joints:
        return values
    for name, value in robot_values(robot).items():
        if f'.{joint}.' in name and not isinstance(value, list):
            values[name] = value
    known, mine = (_slip_order(each, joint) for each in (robot, found))
    if len(known) == len(mine):
        j = robot.joints.index(joint)
        for theirs, own in zip(known, mine, strict=True):
            for part in ('stiffness', 'weight'):
                values[f'friction.{joint}.{part}[{own}]'] = float(
                    getattr(robot.friction, part)[j, theirs])
    return values


def _slip_order(robot, joint):
    j = robot.joints.index(joint)
    stiffness, weight = robot.friction.stiffness[j], robot.friction.weight[j]
    used = np.flatnonzero(weight > 0.0)
    return used[np.argsort(weight[used] / np.maximum(stiffness[used], 1e-300))]


def known_steady(robot, joint, velocity):
    """
    Return the steady friction of one joint, Eq. (6).

    Parameters
    ----------
    robot : RobotParams
        Of known friction.
    joint : str
        Which joint.
    velocity : ndarray, shape (V,)
        [rad/s].

    Returns
    -------
    ndarray, shape (V,)
        [N m].

    """
    tiled = np.tile(np.asarray(velocity, dtype=float)[:, None], robot.n_joints)
    return steady_friction(tiled, robot.friction)[:, robot.joints.index(joint)]


def known_presliding(robot, joint, displacement):
    """
    Return the torque of one joint pushed from rest with unloaded blocks, Eq. (2).

    Parameters
    ----------
    robot : RobotParams
        Of known friction.
    joint : str
        Which joint.
    displacement : ndarray, shape (D,)
        [rad], 0 or above.

    Returns
    -------
    ndarray, shape (D,)
        [N m]; the mean F_s of both directions where all blocks slip.

    """
    friction, j = robot.friction, robot.joints.index(joint)
    static = 0.5 * (friction.forward.static[j] + friction.backward.static[j])
    return np.minimum(np.asarray(displacement)[:, None] * friction.stiffness[j],
                      friction.weight[j] * static).sum(axis=1)


def presliding_difference(result, robot):
    """
    Return how far an identified presliding curve is from the known one.

    Parameters
    ----------
    result : JointResult
        Identified.
    robot : RobotParams
        Of known friction.

    Returns
    -------
    share, where : float
        Largest difference over the known F_s, and the displacement it occurs at [rad]; NaN
        without a curve.

    """
    x, torque = result.curve[:2]
    if not len(x):
        return np.nan, np.nan
    j = robot.joints.index(result.joint)
    static = 0.5 * (robot.friction.forward.static[j] + robot.friction.backward.static[j])
    off = np.abs(torque - known_presliding(robot, result.joint, x)) / static
    worst = int(np.argmax(off))
    return float(off[worst]), float(x[worst])
