# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Joints or sides whose channels were exchanged: found by whose torque fits whose motion."""

from itertools import combinations

from gms_flex_control.data.signals import friction_columns, is_moving, sign_fit
from gms_flex_control.identification.equations import (
    balance_fit,
    FEWEST,
    rigid_torque,
    spring_fit,
    spring_joints,
    torque_joints,
    total_torque,
)
from gms_flex_control.identification.findings import Finding
import numpy as np

_SIDE_FACTOR = 8.0  # torque of the spring over that of the motor that cannot be
_FITS, _BETTER = 0.2, 0.25  # of the variance a joint may leave; of what it leaves unexchanged


def exchanged_angles(signals, robot, motion):
    """Find two joints whose motor follows the other's link far better than its own."""
    found = []
    for i, j in combinations(spring_joints(robot, motion), 2):
        def apart(a, b):
            return np.var(motion.q_motor[:, a] - motion.q_link[:, b])

        def unlike(a, b):
            return 1 - spring_fit(motion.tau[:, a], motion.ddq_motor[:, a],
                                  motion.q_motor[:, a] - motion.q_link[:, b])[0]
        judged = {i, j}.issubset(torque_joints(robot, motion))
        straight, crossed = ([unlike(i, i), unlike(j, j)], [unlike(i, j), unlike(j, i)]
                             ) if judged else ([0.0, 0.0], [1.0, 1.0])
        if apart(i, j) + apart(j, i) < 0.04 * (apart(i, i) + apart(j, j)) or (
                max(crossed) < 0.1 and min(straight) > 3 * max(crossed)
                and sum(crossed) < 0.2 * sum(straight)):
            found.append(_swap(signals, i, j, 'angles of one side',
                               'each motor follows the other link'))
    return found


def side_scales(signals, robot, motion):
    """Find a motor angle with another sign or scale than the link's, far beyond any twist."""
    found = []
    for j in spring_joints(robot, motion):
        x, y = (side[:, j] - side[:, j].mean() for side in (motion.q_link, motion.q_motor))
        if not (x.any() and y.any()):
            continue
        slope, fit = x @ y / (x @ x), x @ y / np.sqrt((x @ x) * (y @ y))
        twist = robot.arm.stiffness[j] * np.std(y - x)
        tau = motion.tau[:, j]
        torn = twist > _SIDE_FACTOR * np.std(tau) if np.isfinite(tau).all() else abs(
            np.log(abs(slope) + 1e-12)) > np.log(5.0)
        if abs(fit) > 0.9 and not 0.5 < slope < 2.0 and (torn or slope < 0.0):
            found.append(Finding(
                'side_scale', signals.joints[j], 'refuse', f'{signals.source}: the motor of '
                f'{signals.joints[j]} moves {slope:.4g} times as far as its link; give motor '
                'angles as seen at the joint (divide by the gear ratio, correct the sign)'))
    return found


def exchanged_torques(signals, robot, motion):
    """Find two joints each of whose torque fits the other's motion far better."""
    total, found = total_torque(motion, robot), []
    springs = spring_joints(robot, motion)

    def explained(torque, j):
        tau = motion.tau[:, torque]
        if j in springs:
            return spring_fit(tau, motion.ddq_motor[:, j],
                              motion.q_motor[:, j] - motion.q_link[:, j])[0]
        fits = balance_fit(motion, tau, total, j)
        return fits[0].as_is if fits else 0.0

    for i, j in combinations(torque_joints(robot, motion), 2):
        crossed = [1 - explained(i, j), 1 - explained(j, i)]
        straight = [1 - explained(i, i), 1 - explained(j, j)]
        if max(crossed) < 0.3 and sum(crossed) < 0.25 * sum(straight) and all(
                a < b for a, b in zip(crossed, straight, strict=True)):
            found.append(_swap(signals, i, j, 'torques', 'each fits the motion of the other'))
    return found


def exchanged_joints(signals, robot, motion):
    """Find two joints that, exchanged as a whole, fit the robot's inertia far better."""
    loads, springs = [], spring_joints(robot, motion)
    for j in range(robot.n_joints):
        twist = motion.q_motor[:, j] - motion.q_link[:, j]
        loads.append(robot.arm.stiffness[j] * twist if j in springs else motion.tau[:, j])
    if not all(np.isfinite(load).all() for load in loads):
        return []
    n = robot.n_joints
    base, found = _misfits(motion, robot, loads, range(n)), []
    for i, j in combinations(range(n), 2):
        if robot.arm.rigid[i] != robot.arm.rigid[j]:
            continue
        order = np.arange(n)
        order[[i, j]] = j, i
        other = _misfits(motion, robot, loads, order)
        if sum(other) < min(_FITS * n, _BETTER * sum(base)):
            found.append(_swap(signals, i, j, 'names', "the robot's inertia fits only then"))
    return found


def _misfits(motion, robot, loads, order):
    """Return per joint what inertia as given and free friction leave of the load's variance."""
    torque, rests = rigid_torque(motion, robot.arm, list(order)), []
    for own, recorded in enumerate(order):
        load, velocity = loads[recorded], motion.dq_link[:, recorded]
        # the stiffness belongs to the name: rescale where the robot's joints differ
        if not robot.arm.rigid[own]:
            load = load * (robot.arm.stiffness[own] / robot.arm.stiffness[recorded])
        rows = is_moving(velocity)
        error, load = (load - torque[:, own])[rows], load[rows]
        spread = np.var(load) if rows.sum() >= FEWEST else 0.0
        if spread > 0:
            left = 1 - sign_fit(error, friction_columns(velocity[rows]),
                                [np.ones_like(error)]).as_is
            rests.append(np.var(error) * left / spread)
        else:
            rests.append(0.0)
    return rests


def _swap(signals, i, j, what, reason):
    first, second = signals.joints[i], signals.joints[j]
    return Finding('swapped_joints', first, 'refuse', f'{signals.source}: the {what} of {first} '
                   f'and {second} seem exchanged ({reason}); exchange the names in the '
                   'recording or the robot file')
