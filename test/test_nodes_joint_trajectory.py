# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a JointTrajectory says, and which are refused."""

import numpy as np
import pytest

messages = pytest.importorskip('trajectory_msgs.msg')
joint_trajectory = pytest.importorskip('gms_flex_control.nodes.joint_trajectory')
refusal = pytest.importorskip('gms_flex_control.nodes.refusal')
JOINTS = ('a', 'b')


def message(*points, names=('b', 'a')):
    """Return a JointTrajectory of (time [s], positions, velocities)."""
    found = messages.JointTrajectory(joint_names=list(names))
    for time, positions, velocities in points:
        found.points.append(messages.JointTrajectoryPoint(positions=positions,
                                                          velocities=velocities))
        found.points[-1].time_from_start.sec = time
    return found


def test_points_are_read_in_our_order_with_what_they_leave_open():
    times, states = joint_trajectory.read_joint_trajectory(
        message((1, [1.0, 2.0], [3.0, 4.0]), (2, [5.0, 6.0], [])), JOINTS)
    assert times.tolist() == [1_000_000_000, 2_000_000_000]
    assert states[0, :2].tolist() == [[2.0, 1.0], [4.0, 3.0]] and np.isnan(states[0, 2:]).all()
    assert states[1].tolist() == [[6.0, 5.0], *[[0.0, 0.0]] * 4]


@pytest.mark.parametrize('given, reason', [
    (message((1, [1.0, 2.0], []), names=('a', 'c')), "lack 'b'"),
    (message((1, [1.0, 2.0, 3.0], []), names=('a', 'b', 'c')), 'of which only'),
    (message((2, [1.0, 2.0], []), (2, [1.0, 2.0], [])), 'must rise from point to point'),
    (message((-1, [1.0, 2.0], [])), 'must not be negative'),
    (message((1, [1.0], [])), 'positions of point 0 of a joint trajectory are 1 for 2 joints'),
    (message((1, [1.0, float('nan')], [])), 'hold nan'),
    (message((1, [1.0, 2.0], [0.0, 0.5])), 'must be at rest')])
def test_what_makes_no_sense_is_refused_with_the_reason(given, reason):
    with pytest.raises(refusal.RefusedError, match=reason):
        joint_trajectory.read_joint_trajectory(given, JOINTS)
