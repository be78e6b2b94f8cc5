# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""JointTrajectory messages, as MoveIt and rqt_joint_trajectory_controller send them."""

from gms_flex_control.nodes.messages import to_nanoseconds
from gms_flex_control.nodes.refusal import first_bad, LARGEST_STATE, order_of, RefusedError
import numpy as np

_ROWS = ('positions', 'velocities', 'accelerations')
_MOST_POINTS = 1000  # a loop in the same process waits while they are read
_AT_REST = 1e-6  # the last velocity [rad/s]


def read_joint_trajectory(message, joints):
    """
    Return the points of a JointTrajectory.

    Parameters
    ----------
    message : trajectory_msgs.msg.JointTrajectory
        It names all joints, in any order; velocities and accelerations may be left out.
    joints : sequence of str
        Our order.

    Returns
    -------
    times : ndarray, shape (m,)
        ``time_from_start`` of each point, rising [ns].
    states : ndarray, shape (m, 5, n_joints)
        Value and time derivatives 1 to 4, NaN where the message does not tell; of the last
        point what it does not tell is zero.

    Raises
    ------
    RefusedError
        If joints are missing or unknown, lengths do not fit, numbers are not finite or too
        large, times do not rise, or the last point moves.

    """
    order = order_of(joints, message.joint_names, 'the names of a joint trajectory')
    if len(message.joint_names) != len(joints):
        raise RefusedError(f'a joint trajectory names {list(message.joint_names)}, of which only '
                           f'{list(joints)} are known')
    if len(message.points) > _MOST_POINTS:
        raise RefusedError(f'a joint trajectory has {len(message.points)} points, '
                           f'{_MOST_POINTS} at most')
    times = np.array([to_nanoseconds(point.time_from_start) for point in message.points])
    if times.size and (times[0] < 0 or (np.diff(times) <= 0).any()):
        raise RefusedError('time_from_start of a joint trajectory must not be negative and must '
                           f'rise from point to point, got {(times / 1e9).tolist()[:8]} s')
    states = np.full((len(times), 5, len(joints)), np.nan)
    for i, point in enumerate(message.points):
        for row, name in enumerate(_ROWS):
            values = getattr(point, name)
            if len(values) or name == 'positions':
                states[i, row] = _checked(values, f'{name} of point {i}', order, joints)
    if len(states):
        last = states[-1]
        if np.abs(np.nan_to_num(last[1])).max() > _AT_REST:
            raise RefusedError(f'the last point of a joint trajectory must be at rest, got '
                               f'velocities {last[1].tolist()}')
        last[1:] = 0.0
    return times, states


def _checked(values, what, order, joints):
    if len(values) != len(joints):
        raise RefusedError(f'{what} of a joint trajectory are {len(values)} for {len(joints)} '
                           'joints')
    bad = first_bad(values, LARGEST_STATE)
    if bad is not None:
        raise RefusedError(f'{what} of a joint trajectory hold {values[bad]}')
    return [values[index] for index in order]
