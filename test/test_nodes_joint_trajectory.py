# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a JointTrajectory says, which are refused, and when a goal of the action is over."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

trajectory_msgs = pytest.importorskip('trajectory_msgs.msg')
joint_trajectory = pytest.importorskip('gms_flex_control.nodes.joint_trajectory')
messages = pytest.importorskip('gms_flex_control.nodes.messages')
reference_motion = pytest.importorskip('gms_flex_control.nodes.reference_motion')
JOINTS = ('a', 'b')
SECOND = 1_000_000_000


def message(*points, names=('b', 'a')):
    """Return a JointTrajectory of (time [s], positions, velocities)."""
    found = trajectory_msgs.JointTrajectory(joint_names=list(names))
    for time, positions, velocities in points:
        found.points.append(trajectory_msgs.JointTrajectoryPoint(positions=positions,
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
    with pytest.raises(messages.RefusedError, match=reason):
        joint_trajectory.read_joint_trajectory(given, JOINTS)


def test_points_without_time_are_refused_as_such_and_those_of_the_past_by_their_age():
    still = SimpleNamespace(q=np.zeros(2), dq=np.zeros(2))
    motion = reference_motion.ReferenceMotion(
        JOINTS, still, None, {'trajectory.autostart': False, 'trajectory.type': 'hold'},
        lambda *_, **__: None)
    motion.begin(0)
    motion.published = 5 * SECOND
    points = joint_trajectory.read_joint_trajectory(message((0, [1.0, 2.0], [])), JOINTS)
    with pytest.raises(messages.RefusedError, match='leaves no time to go there'):
        motion.through(motion.here(), *points, 0)
    with pytest.raises(reference_motion.PastError, match='was over 2 s ago'):
        motion.through(motion.here(), *points, 3 * SECOND)


def tolerance(name, position=0.0, velocity=0.0):
    """Return what a JointTolerance holds."""
    return SimpleNamespace(name=name, position=position, velocity=velocity)


def goal(path=(), at_end=(), allowance=0, points=1):
    """Return the Goal of a request."""
    request = SimpleNamespace(
        trajectory=message(*[(1, [0.0, 0.0], [])] * points),
        multi_dof_trajectory=SimpleNamespace(points=[]), path_tolerance=path,
        goal_tolerance=at_end,
        goal_time_tolerance=SimpleNamespace(sec=allowance, nanosec=0))
    return joint_trajectory.read_goal(request, JOINTS)


def verdict(of, late, position=(0.0, 0.0), velocity=(0.0, 0.0)):
    return of.verdict(JOINTS, np.array([position, velocity]), late * SECOND)


def test_a_goal_without_tolerances_is_over_when_the_arm_has_stopped():
    """As with joint_trajectory_controller, stopped_velocity_tolerance 0.01 rad/s by default."""
    assert verdict(goal(), -1, (9.0, 9.0), (9.0, 9.0)) is None
    assert verdict(goal(), 1000, (9.0, 9.0), (0.0, 0.02)) is None
    assert verdict(goal(), 0, (9.0, 9.0), (0.0, 0.009))[0] == joint_trajectory.SUCCESSFUL
    assert verdict(goal(at_end=[tolerance('a', velocity=-1.0), tolerance('b', velocity=5.0)]), 0,
                   (9.0, 9.0), (9.0, 4.0))[0] == joint_trajectory.SUCCESSFUL


def test_an_error_beyond_the_path_tolerance_ends_it_on_the_way_only():
    of = goal(path=[tolerance('b', 0.1, -1.0), tolerance('a', 0.0, 0.5)])
    assert verdict(of, -1, (5.0, -0.1), (0.5, 7.0)) is None
    assert verdict(of, -1, (5.0, -0.11)) == (
        joint_trajectory.PATH_TOLERANCE_VIOLATED,
        'path tolerance: the angle of b is -0.11 rad off, the bound is 0.1 rad')
    assert 'velocity of a is 0.6 rad/s off' in verdict(of, -1, velocity=(0.6, 0.0))[1]
    assert verdict(of, 0, (5.0, -0.11))[0] == joint_trajectory.SUCCESSFUL


def test_a_goal_tolerance_is_waited_for_as_long_as_it_allows():
    of = goal(at_end=[tolerance('a', 0.01)], allowance=2)
    assert verdict(of, 1, (0.02, 0.0)) is None
    assert verdict(of, 1, (0.01, 3.0))[0] == joint_trajectory.SUCCESSFUL
    assert verdict(of, 3, (0.02, 0.0)) == (
        joint_trajectory.GOAL_TOLERANCE_VIOLATED,
        'goal tolerance: the angle of a is 0.02 rad off, the bound is 0.01 rad')
    assert verdict(goal(at_end=[tolerance('a', 0.01)]), 1000, (0.02, 0.0)) is None  # any time


@pytest.mark.parametrize('wrong, reason', [
    ({'points': 0}, 'no points'), ({'path': [tolerance('c', 0.1)]}, "for 'c', known are"),
    ({'at_end': [tolerance('a', math.nan)]}, 'a tolerance of a is nan')])
def test_a_goal_that_makes_no_sense_is_refused(wrong, reason):
    with pytest.raises(messages.RefusedError, match=reason):
        goal(**wrong)
