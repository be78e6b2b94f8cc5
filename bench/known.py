# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The true parameters of a simulated robot, by the names of what is identified."""

from gms_flex_control.answer import align
from gms_flex_control.identification.outcome import Identification, JointResult, number, short_name
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.build import robot_values
import numpy as np


def known_values(robot: RobotParams, found: RobotParams, joint: str) -> dict:
    """
    Return the parameters of one joint of a known robot by the names of estimates.

    Blocks are matched in the order they slip in the robot ``found``; they are left out where
    their number differs, since then no block corresponds to another.
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


def known_presliding(robot: RobotParams, joint: str, displacement: np.ndarray) -> np.ndarray:
    """
    Return the torque [N m] of one joint pushed by (D,) [rad] with unloaded blocks, Eq. (2).

    The mean F_s of both directions where all blocks slip.
    """
    friction, j = robot.friction, robot.joints.index(joint)
    static = 0.5 * (friction.forward.static[j] + friction.backward.static[j])
    return np.minimum(np.asarray(displacement)[:, None] * friction.stiffness[j],
                      friction.weight[j] * static).sum(axis=1)


def presliding_difference(result: JointResult, robot: RobotParams) -> tuple[float, float]:
    """
    Return the largest difference of an identified presliding curve from the known one.

    As a share of the known F_s, and the displacement it occurs at [rad]; NaN without a curve.
    """
    x, torque = result.curve[:2]
    if not len(x):
        return np.nan, np.nan
    j = robot.joints.index(result.joint)
    static = 0.5 * (robot.friction.forward.static[j] + robot.friction.backward.static[j])
    off = np.abs(torque - known_presliding(robot, result.joint, x)) / static
    worst = int(np.argmax(off))
    return float(off[worst]), float(x[worst])


def beside_truth(found: Identification, robot: RobotParams) -> str:
    """Return what was identified beside the true values, as text."""
    rows = []
    for result in found.joints:
        known = known_values(robot, found.robot, result.joint)
        rows += [(result.joint, short_name(one.name, result.joint), one.unit, number(one.value),
                  number(known.get(one.name, np.nan))) for one in result.estimates]
    curves = ', '.join(f'{result.joint} {100 * presliding_difference(result, robot)[0]:.3g} %'
                       for result in found.joints)
    return (align(['joint', 'parameter', 'unit', 'identified', 'true'], rows)
            + f'\npresliding curve off the true one by at most, of F_s: {curves}')
