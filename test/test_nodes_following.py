# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What nodes make of references, trajectories and states, without a process."""

import math
from pathlib import Path
from types import SimpleNamespace

from bench.identification_simulated import read_identification_plan
from gms_flex_control.schema.files import load_controller, load_robot
from node_harness import joint_state
import numpy as np
import pytest

following = pytest.importorskip('gms_flex_control.nodes.following')
messages = pytest.importorskip('gms_flex_control.nodes.messages')
trajectory_msgs = pytest.importorskip('trajectory_msgs.msg')
joint_trajectory = pytest.importorskip('gms_flex_control.nodes.joint_trajectory')
reference_motion = pytest.importorskip('gms_flex_control.nodes.reference_motion')
experiment_watch = pytest.importorskip('gms_flex_control.nodes.step_runner')
wire = pytest.importorskip('bench.faults.wire')
Reference, Handover = following.Reference, following.Handover
NS, PERIOD = 10**9, 2_000_000
MOTION = np.array([[0.5, -0.2], [0.4, 0.1], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])


def lost_at(hold=1.0, relax=0.5):
    """Return References whose last motion was for the state at time 0."""
    kept = following.References(0.1, hold, relax)
    kept.keep(0, Reference('motion', MOTION))
    return kept


def test_a_reference_is_carried_on_until_its_timeout_then_braked_held_and_let_go():
    kept, torque, rows, phases = lost_at(), np.array([0.3, -0.1]), [], []
    for stamp in range(0, 2 * NS, PERIOD):
        reference = kept.at(stamp)
        phases.append(kept.phase)
        if reference is None:
            break
        rows.append((stamp / NS, reference))
        if reference.quantity == 'motion':
            kept.answered(torque, PERIOD / NS)
    changes = [phases[0], *(b for a, b in zip(phases, phases[1:], strict=False) if a != b)]
    assert changes == ['following', 'holding', 'relaxing', None]
    motion = np.array([row.value for _, row in rows if row.quantity == 'motion'])
    assert np.abs(np.diff(motion[:, 0], axis=0)).max() <= 1.01 * 0.4 * PERIOD / NS * 2.0
    assert np.abs(motion[-1, 1:]).max() == 0.0  # at rest
    assert np.all(np.abs(motion[-1, 0] - motion[50, 0]) < 0.2)  # near where it was lost
    efforts = [(time, row.value[0]) for time, row in rows if row.quantity == 'effort']
    assert efforts[0][1] == pytest.approx(torque, rel=0.02)
    assert np.all(np.diff([np.abs(value).sum() for _, value in efforts]) < 0.0)
    assert efforts[-1][0] == pytest.approx(0.1 + 1.0 + 0.5, abs=0.01)


def test_a_handover_begins_at_the_robot_and_ends_at_the_reference():
    way = Handover(2.0)
    way.begin(0, np.array([[1.0, 0.0], [0.0, -0.5]]), MOTION)
    first = way.applied(0, MOTION)
    assert first[:2] == pytest.approx(np.array([[1.0, 0.0], [0.0, -0.5]]))
    assert np.abs(first[2:]).max() < 1e-9
    rows = np.array([way.applied(stamp, MOTION) for stamp in range(0, 2 * NS, PERIOD)])
    step = np.abs(np.diff(rows[:, 0], axis=0)).max() / (PERIOD / NS)
    assert step < 1.0 + np.abs(rows[:, 1]).max()  # no jump on the way
    assert way.applied(2 * NS, MOTION) is MOTION and way.left is None


SHARE = np.minimum(np.arange(200) / 20, 1.0)
EVENLY = range(0, NS, NS // 200)
STALLING = [0, NS // 12, NS // 6, NS // 6 + NS // 500]


@pytest.mark.parametrize(('given', 'moments', 'shares'), [
    ({}, EVENLY, SHARE), ({'torque': np.array([0.4, 0.4])}, EVENLY, SHARE + 0.4 * (1.0 - SHARE)),
    ({}, STALLING, [0.0, 0.1, 0.2, 0.22])])
def test_torque_fades_in_from_the_one_that_is_given_and_jumps_after_no_stall(
        given, moments, shares):
    way, torque = Handover(2.0), np.ones((len(moments), 2))
    way.begin(NS, MOTION[:2], MOTION, **given)
    for since, row in zip(moments, torque, strict=True):
        way.fade(NS + since, row)
    assert torque[:, 0] == pytest.approx(shares)


@pytest.mark.parametrize('bad', [float('nan'), float('inf'), -float('inf'), 1e308, -1e308])
def test_every_bad_number_is_refused_with_joint_and_index(bad):
    reader = messages.JointStateReader(wire.JOINTS, wire.NAMES[2:])
    for k, name in enumerate(wire.NAMES):
        numbers = [0.1 if j != k else bad for j in range(4)]
        for field, values in (('position', (numbers, None)), ('velocity', ([0.0] * 4, numbers))):
            with pytest.raises(messages.RefusedError, match=f'{field} .*{name}.*{field}.{k}.'):
                reader.read(wire.joint_state(0, values[0], velocity=values[1]), None)
    for k in range(2):
        command = wire.array_message([bad if j == k else 0.0 for j in range(2)])
        with pytest.raises(messages.RefusedError, match=rf'joint {k + 1} .*data.{k}.'):
            messages.read_command(command, 2)
    for k in range(10):
        reference = wire.array_message([bad if j == k else 0.0 for j in range(10)])
        row = ('q', 'dq', 'ddq', 'd3q', 'd4q')[k // 2]
        said = rf'has {row} .*joint {k % 2 + 1}.*\[{k}\]'
        with pytest.raises(messages.RefusedError, match=said):
            messages.read_reference(reference, 2)


@pytest.mark.parametrize(('names', 'position', 'velocity', 'reason'), [
    (wire.NAMES[:3], [0.1] * 3, None, "lack 'joint2_motor'"),
    ([*wire.NAMES, 'joint1'], [0.1] * 5, None, "name 'joint1' more than once"),
    (wire.NAMES, [0.1] * 3, None, 'have 4 names and 3 positions'),
    (wire.NAMES, [0.1] * 4, [0.0], '1 velocities')])
def test_the_reason_of_a_refused_state_names_the_culprit(names, position, velocity, reason):
    reader = messages.JointStateReader(wire.JOINTS, wire.NAMES[2:])
    with pytest.raises(messages.RefusedError, match=reason):
        reader.read(wire.joint_state(0, position, names=names, velocity=velocity), None)


def test_a_million_names_make_a_short_sentence():
    with pytest.raises(messages.RefusedError) as refused:
        messages.order_of(['joint1'], [f'x{k}' for k in range(10**6)])
    assert len(str(refused.value)) < 300 and 'and 999992 more' in str(refused.value)


def test_effort_that_is_not_measured_may_be_nan():
    reader = messages.JointStateReader(wire.JOINTS, wire.NAMES[2:])
    state = wire.joint_state(0, (0.1, 0.2, 0.3, 0.4))
    state.effort = [float('nan')] * 4
    taken = SimpleNamespace(q_link=np.zeros(2), dq_link=np.zeros(2), q_motor=np.zeros(2),
                            dq_motor=np.zeros(2))
    reader.read(state, taken)
    assert list(taken.q_motor) == [0.3, 0.4]


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


CONFIG = Path(__file__).parents[1] / 'config'
DEMO = CONFIG.parent / 'bench' / 'demos' / 'identification.yaml'
ROBOT = load_robot(CONFIG / 'robot.yaml')
PLAN = read_identification_plan([DEMO], ROBOT, load_controller(
    CONFIG / 'controller.yaml', ROBOT))


@pytest.fixture
def watch():
    return experiment_watch.Watch(PLAN)


def moved(watch, speed, *, samples=100, q=0.0, begin=0):
    """Feed states of joint1 moving at ``speed`` [rad/s]."""
    for k in range(samples):
        angle = q + speed * k * PERIOD * 1e-9
        watch.take(joint_state(begin + k * PERIOD, (angle, 0.0, angle, 0.0)))


def test_it_knows_time_rate_place_and_travel(watch):
    moved(watch, 0.5)
    assert watch.stamp == 99 * PERIOD and watch.samples == 100
    assert watch.period == pytest.approx(2e-3)
    watch.mark()
    moved(watch, -0.5, q=watch.q_link[0], begin=watch.stamp + PERIOD)
    assert watch.travel(0) == pytest.approx(0.5 * 99 * 2e-3)
    assert watch.travel(1) == 0.0 and watch.fault is None


@pytest.mark.parametrize(('speed', 'q', 'sentence'), [
    (1.6, 0.0, 'joint1 moves at 1.6 rad/s, the limit is 1.2 rad/s: zero torque'),
    (0.1, -1.25, 'joint1 is at -1.25 rad, outside its range -1.2 to 1.2 rad: zero torque')])
def test_a_limit_passed_is_a_fault_while_it_is_on_guard(watch, speed, q, sentence):
    moved(watch, speed, q=q)
    assert watch.fault is None
    watch.guarded = True
    moved(watch, speed, q=q, begin=watch.stamp + PERIOD)
    assert watch.fault == sentence


def test_encoder_counts_and_the_limit_itself_are_no_fault(watch):
    watch.guarded = True
    moved(watch, 1.2)
    for k in range(200):  # a count forth and back at each sample is 0.16 rad/s
        watch.take(joint_state(watch.stamp + PERIOD, (0.24 + 3.14e-4 * (k % 2), 0, 0, 0)))
    assert watch.fault is None


def test_a_state_sent_again_counts_once_and_a_bad_one_not_at_all(watch):
    moved(watch, 0.0, samples=3)
    watch.take(joint_state(watch.stamp))
    assert watch.samples == 3
    for bad in (joint_state(9 * PERIOD, (float('nan'), 0, 0, 0)),
                joint_state(9 * PERIOD, (0.0,), names=['joint1']),
                joint_state(9 * PERIOD, (0.0,))):
        with pytest.raises(messages.RefusedError):
            watch.take(bad)
    assert watch.samples == 3
