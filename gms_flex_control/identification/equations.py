# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The equations of motion as fits with weights that cannot be negative.

The motor's equation ``J ddq_motor + K (q_motor - q_link) = u`` and the whole joint's,
``M ddq + C dq + g + J ddq_motor + F = u``: inertia, stiffness and friction are positive,
however roughly they are known.
"""

from typing import NamedTuple

from gms_flex_control.data.signals import (
    derivative_window,
    friction_columns,
    is_moving,
    quantum,
    sign_fit,
    smoothed,
)
from gms_flex_control.dynamics.chain import inverse_dynamics
import numpy as np

FEWEST = 40   # rows of a fit
_TRAVEL = 30  # encoder steps a joint must move for its torque to be judged


class Motion(NamedTuple):
    """Filtered channels of all joints, arrays (S, n), on the rows without gaps."""

    q_link: np.ndarray
    dq_link: np.ndarray
    ddq_link: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    ddq_motor: np.ndarray
    tau: np.ndarray
    moved: np.ndarray  # (n,), joints that move far enough for their torque to be judged


def filtered(signals, robot):
    """Return the Motion of a recording (Signals) of a robot (RobotParams)."""
    window = max(derivative_window(signals.time, q) for q in signals.q_link.T)
    sides = [signals.q_link.T, np.where(robot.arm.rigid, signals.q_link, signals.q_motor).T,
             signals.tau_motor.T]
    known = np.all(np.isfinite(signals.q_link), axis=1)
    time, gap = signals.time, 3 * signals.period
    rows = smoothed(time, [time, *(channel for side in sides for channel in side)], window)
    at, n = rows[0].value, len(signals.joints)
    stamps = time[known]
    wide = np.flatnonzero(np.diff(stamps) > max(gap, window / 8))
    good = np.ones(len(at), dtype=bool)
    for k in wide:
        good[np.searchsorted(at, stamps[k] - window / 2):
             np.searchsorted(at, stamps[k + 1] + window / 2)] = False
    link, motor, tau = rows[1:n + 1], rows[n + 1:2 * n + 1], rows[2 * n + 1:]
    columns = [[getattr(part, name)[good] for part in side] for side in (link, motor)
               for name in ('value', 'first', 'second')]
    unknown = ~np.isfinite(signals.tau_motor[2:]).any(axis=0)
    torque = np.stack([part.value[good] for part in tau], axis=1)
    torque[:, unknown] = np.nan
    moved = [len(at) and np.ptp(part.value) > _TRAVEL * quantum(q)
             for part, q in zip(link, signals.q_link.T, strict=True)]
    result = Motion(*(np.stack(column, axis=1) for column in columns), torque,
                    np.array(moved, dtype=bool))
    blind = ~np.isfinite(sides[1]).any(axis=1)
    for values in result[3:6]:
        values[:, blind] = np.nan
    return result


def rigid_torque(motion, arm, order=None):
    """
    Return the torque (S, n) that moves the links, and the motors of rigid joints.

    ``M(q) ddq + C dq + g`` along a Motion, as in dynamics.chain; with ``order`` the recorded
    joints are taken as the robot's in that order.
    """
    order = np.arange(arm.n_joints) if order is None else np.asarray(order)
    return inverse_dynamics(*(values[:, order] for values in motion[:3]), arm)


def total_torque(motion, robot):
    """Return the frictionless torque (S, n) at the motors."""
    inertia = np.where(robot.arm.rigid, 0.0, robot.arm.motor_inertia)
    motor = np.where(np.isfinite(motion.ddq_motor), motion.ddq_motor, motion.ddq_link)
    return rigid_torque(motion, robot.arm) + inertia * motor


def spring_joints(robot, motion):
    """Return the numbers of the joints whose twist is recorded."""
    return [j for j in range(robot.n_joints)
            if not robot.arm.rigid[j] and np.isfinite(motion.q_motor[:, j]).all()]


def torque_joints(robot, motion):
    """Return the numbers of the joints whose torque is recorded and can be judged."""
    return [j for j in range(robot.n_joints) if np.isfinite(motion.tau[:, j]).all()
            and np.ptp(motion.tau[:, j]) > 0 and motion.moved[j]]


def spring_fit(tau, acceleration, twist):
    """Return what inertia and spring explain of a torque, and the share the spring adds."""
    free = [np.ones_like(tau)]
    both = sign_fit(tau, [acceleration, twist], free).as_is
    alone = sign_fit(tau, [acceleration], free).as_is
    return both, (both - alone) / max(1.0 - alone, 1e-12)


def balance_fit(motion, tau, total, j):
    """Return the fit (sign_fit) of a torque by rigid-body torque and friction of joint j."""
    rows = is_moving(motion.dq_link[:, j])
    if rows.sum() < FEWEST:
        return None
    angle = motion.q_link[rows, j]
    columns = [total[rows, j], *friction_columns(motion.dq_link[rows, j])]
    constant = np.ones(int(rows.sum()))
    known = sign_fit(tau[rows], columns, [constant])
    loose = sign_fit(tau[rows], columns, [constant, np.sin(angle), np.cos(angle)])
    return known, loose
