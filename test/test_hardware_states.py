# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""From readings to joint states and from commands to torque within limits."""

import math
from types import SimpleNamespace

from gms_flex_control.errors import ParameterError
from gms_flex_control.hardware import mapping
from gms_flex_control.hardware.limits import jump, limited, Limits, UNLIMITED, violation
from gms_flex_control.hardware.mapping import Actuation, JointMap, Reading, ReadingError, Timeline
import numpy as np
import pytest

pytestmark = pytest.mark.fast

NAMES = ('elbow', 'wrist')
STILL = np.zeros(2)


def limits(**changed):
    """Return limits of two joints."""
    values = {'torque': [2.0, 1.0], 'torque_rate': [5.0, 10.0], 'velocity': [1.0, 2.0],
              'velocity_margin': [0.5, 0.5], 'lower': [-1.0, -2.0], 'upper': [1.0, 2.0],
              'position_margin': [0.1, 0.1], 'torsion': [0.5, 0.5]}
    return Limits(**(values | changed))


def measured(q=(0.0, 0.0), dq=(0.0, 0.0), q_motor=None, dq_motor=None):
    """Return what a robot measures; the motor side as the link if not given."""
    return SimpleNamespace(q_link=np.array(q), dq_link=np.array(dq),
                           q_motor=np.array(q if q_motor is None else q_motor),
                           dq_motor=np.array(dq if dq_motor is None else dq_motor))


def ramp(command, before, steps, dt=0.002, q=STILL, dq=STILL):
    """Return the torques that a constant command becomes, (steps, 2)."""
    torques, torque = [], np.array(before, dtype=float)
    for _ in range(steps):
        torque = limited(np.array(command, dtype=float), torque, dt, q, dq, limits())
        torques.append(torque)
    return np.array(torques)


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_step_becomes_a_ramp_up_to_the_limit(sign):
    torques = ramp([9.0 * sign, 0.4 * sign], [0.0, 0.0], 300)
    k = np.arange(1, 301)
    np.testing.assert_allclose(torques[:, 0], sign * np.minimum(5.0 * 0.002 * k, 2.0))
    np.testing.assert_allclose(torques[:, 1], sign * np.minimum(10.0 * 0.002 * k, 0.4))


def test_torque_falls_at_once_and_rises_from_zero_on_the_other_side():
    np.testing.assert_array_equal(ramp([0.0, 0.3], [2.0, 1.0], 1), [[0.0, 0.3]])
    np.testing.assert_allclose(ramp([-2.0, -1.0], [2.0, 1.0], 3),
                               [[-0.01, -0.02], [-0.02, -0.04], [-0.03, -0.06]])


def test_no_command_and_no_time_allow_more_than_before():
    rng = np.random.default_rng(0)
    for _ in range(1000):
        before = rng.uniform(-1.0, 1.0, 2) * [2.0, 1.0]
        torque = limited(rng.normal(0.0, 10.0, 2), before, rng.uniform(-1.0, 0.0),
                         rng.normal(0.0, 2.0, 2), rng.normal(0.0, 2.0, 2), limits())
        assert (np.abs(torque) <= np.abs(before)).all() and (torque * before >= 0.0).all()


@pytest.mark.parametrize('q, dq, allowed', [
    ((1.0, 0.0), (0.0, 0.0), {-1}), ((-1.0, 0.0), (0.0, 0.0), {1}),
    ((5.0, 0.0), (-0.5, 0.0), {-1}), ((0.999, 0.0), (0.999, 0.0), {-1, 1}),
    ((0.0, 0.0), (1.0, 0.0), {-1}), ((0.0, 0.0), (-1.2, 0.0), {1}),
    ((1.1, 0.0), (-1.1, 0.0), set())])
def test_at_a_limit_only_inward_and_braking_torque_is_left(q, dq, allowed):
    """Out of the range and fast inwards: no torque at all."""
    for sign in (1.0, -1.0):
        torque = limited(np.array([sign, sign]), np.array([sign, sign]), 0.002, np.array(q),
                         np.array(dq), limits())
        assert torque[0] == (sign if sign in allowed else 0.0)
        assert torque[1] == sign  # the other joint is not touched


@pytest.mark.parametrize('state, words', [
    (measured(q=(1.11, 0.0)), 'elbow is at 1.11 rad, beyond its range of -1 to 1 by more than'),
    (measured(q=(0.0, -2.2)), 'wrist is at -2.2 rad'),
    (measured(dq=(0.0, 2.6)), 'the link side of wrist moves at 2.6 rad/s, above its limit of 2'),
    (measured(dq_motor=(-1.6, 0.0)), 'the motor side of elbow moves at -1.6'),
    (measured(q_motor=(0.6, 0.0)), 'motor and link of elbow are 0.6 rad apart'),
    (measured(q_motor=(0.0, -0.6)), 'a sign, a gear ratio or an encoder may be wrong'),
    (measured(q=(1.1, 2.1), dq=(-1.5, 2.5), q_motor=(1.5, 1.7)), '')])
def test_what_is_beyond_a_margin_is_said(state, words):
    said = violation(NAMES, state, limits())
    assert words in said and bool(words) == bool(said)


def test_an_angle_that_no_joint_could_reach_in_the_time_is_a_jump():
    """The fastest allowed is 1.5 and 2.5 rad/s; what is shorter than 10 ms counts as 10 ms."""
    before = STILL, STILL
    assert not jump(NAMES, measured([0.0149, 0.0249]), before, 0.002, limits())
    assert not jump(NAMES, measured([0.149, 0.249]), before, 0.1, limits())
    assert jump(NAMES, measured([0.3, 0.0]), before, 0.002, limits()).startswith(
        'elbow jumped from 0 to 0.3 rad within 2 ms')
    assert 'wrist' in jump(NAMES, measured([0.0, -0.26]), before, 0.1, limits())
    assert jump(NAMES, measured(q_motor=[0.0, 50.0]), before, 0.002, limits()).startswith(
        'the motor of wrist jumped from 0 to 50 rad')


@pytest.mark.parametrize('changed, words', [
    ({'torque': [1.0, -1.0]}, 'torque must be at least 0'),
    ({'lower': [1.0, 0.0], 'upper': [-1.0, 1.0]}, 'were they swapped'),
    ({'upper': [np.nan, 1.0]}, 'upper must be finite'),
    ({'torsion': [1.0]}, 'torsion must have shape')])
def test_limits_that_make_no_sense_are_refused(changed, words):
    with pytest.raises(ParameterError, match=words):
        limits(**changed)


def test_a_limit_that_nobody_gave_is_missing():
    assert limits().missing(NAMES) == ''
    assert limits(velocity=[1.0, UNLIMITED]).missing(NAMES) == 'limits.wrist.velocity'
    assert limits(lower=[-UNLIMITED, 0.0]).missing(NAMES) == 'limits.elbow.lower'


MS = 1_000_000
NAN = math.nan


def joint_map(**options):
    """Return joint a: reversed motor behind a gear of 100, in amperes; b: rigid, in newton m."""
    return JointMap(
        ('a', 'b'), [Reading(name='la', offset=0.5), Reading(name='lb', sign=-1.0)],
        [Reading(name='ma', sign=-1.0, ratio=100.0, offset=0.1), None],
        [Actuation(name='ma', sign=-1.0, torque_constant=0.05, gear=100.0),
         Actuation(name='lb')], **options)


def merger(sources=('one',), **options):
    """Return a merger of joint_map."""
    return mapping.StateMerger(joint_map(), sources, **({'cutoff': 50.0, 'skew': 0.01} | options))


def take(merged, names, position, stamp, *, source=0, velocity=(), effort=(), now=None):
    """Hand over a message that comes at its stamp."""
    return merged.take(source, list(names), position, velocity, effort, stamp,
                       stamp if now is None else now)


def by_joints(mapped, *, state=((0.0,) * 3,) * 2, efforts=(NAN,) * 3, otherwise=(0.0,) * 2):
    """Return what `sort` makes of readings of three encoders: sides, torque."""
    sides, torque = np.zeros((4, 2)), np.zeros(2)
    mapping.sort(*map(np.array, (state, efforts, otherwise)), *mapped.arrays[:3], sides, torque)
    return sides, torque


def test_angles_and_rates_follow_sign_gear_and_offset():
    mapped = joint_map()
    assert mapped.names == ('la', 'lb', 'ma')
    angle = np.array([1.0, 1.0, 30.0]) * mapped.slope + mapped.offset
    np.testing.assert_allclose(angle, [1.5, -1.0, -0.3 + 0.1])
    np.testing.assert_allclose(np.array([1.0, 1.0, 30.0]) * mapped.slope, [1.0, -1.0, -0.3])
    sides, _ = by_joints(mapped, state=[angle, 2.0 * angle])
    np.testing.assert_allclose(sides[:2], [[1.5, -1.0], [3.0, -2.0]])
    np.testing.assert_allclose(sides[2:], [[-0.2, -1.0], [-0.4, -2.0]])  # rigid: one encoder


def test_efforts_go_out_in_the_robots_order_and_come_back():
    mapped = joint_map(order=('b', 'a'))
    np.testing.assert_allclose(mapped.efforts(np.array([5.0, 0.25])), [0.25, -1.0])
    assert mapped.command_names == ('lb', 'ma')
    _, back = by_joints(mapped, efforts=[NAN, 0.25, -1.0])
    np.testing.assert_allclose(back, [5.0, 0.25])
    _, back = by_joints(mapped, otherwise=[7.0, 8.0])
    np.testing.assert_allclose(back, [7.0, 8.0])
    assert '-' not in str(mapped.efforts(np.zeros(2)))  # no negative zero on the wire


@pytest.mark.parametrize('make, words', [
    (lambda: Reading(name='x', sign=0.5), 'x: sign must be 1 or -1, got 0.5'),
    (lambda: joint_map(order=('a', 'a')), 'must name each of'),
    (lambda: JointMap(('a',), [Reading(name='x')], [Reading(name='x')], [Actuation(name='x')]),
     "both called 'x'"),
    (lambda: JointMap(('a', 'b'), [Reading(name='la'), Reading(name='lb')], [None, None],
                      [Actuation(name='m'), Actuation(name='m')]),
     "two actuators are both called 'm'")])
def test_a_mapping_that_makes_no_sense_is_refused(make, words):
    with pytest.raises(ParameterError, match=words):
        make()


def test_one_source_in_any_order_with_others_among_them():
    merged = merger()
    assert take(merged, ['tool', 'ma', 'lb', 'la'], [NAN, 30.0, 1.0, 1.0], 5 * MS,
                velocity=[NAN, 10.0, 2.0, 3.0], effort=[NAN, 0.5, NAN, NAN])
    np.testing.assert_allclose(merged.state[0], [1.5, -1.0, -0.2])
    np.testing.assert_allclose(merged.state[1], [3.0, -2.0, -0.1])
    np.testing.assert_array_equal(merged.effort, [NAN, NAN, 0.5])
    assert merged.time == 5 * MS


def test_two_sources_become_one_state_at_the_time_of_the_newer():
    """At constant speed the older reading moved along is exact."""
    merged = merger(('links', 'motors'))
    speeds, q = np.array([0.7, -0.4, 2.0]), []
    for k in range(20):
        t = 2 * k * MS
        links = 1e-9 * t * speeds[:2]
        take(merged, ['la', 'lb'], list(links), t + 1, source=0, velocity=list(speeds[:2]))
        later = t + 1 + MS // 2
        assert take(merged, ['ma'], [1e-9 * later * speeds[2]], later, source=1,
                    velocity=[speeds[2]])
        q.append(merged.state[0].copy())
        assert merged.time == later
    for k, state in enumerate(q):
        at = 1e-9 * (2 * k * MS + MS // 2)
        np.testing.assert_allclose(
            state, at * speeds * joint_map().slope + joint_map().offset, atol=1e-8)


def test_the_slower_source_sets_the_pace_and_too_much_skew_makes_no_state():
    merged = merger(('fast', 'slow'))
    states = 0
    for k in range(1, 41):
        states += take(merged, ['la', 'lb'], [0.0, 0.0], k * 2 * MS, source=0)
        if k % 4 == 0:
            states += take(merged, ['ma'], [0.0], k * 2 * MS + 1, source=1)
    assert states == 10
    late = merger(('fast', 'slow'), skew=0.001)
    take(late, ['la', 'lb'], [0.0, 0.0], 2 * MS, source=0)
    assert not take(late, ['ma'], [0.0], 4 * MS, source=1)
    assert late.absent() == []
    older_last = merger(('a', 'b'))
    take(older_last, ['la', 'lb'], [0.0, 0.0], 20 * MS, source=0)
    assert not take(older_last, ['ma'], [0.0], MS, source=1, now=20 * MS + 1)
    assert take(late, ['la', 'lb'], [0.0, 0.0], 5 * MS - 1, source=0)


@pytest.mark.parametrize('names, position, velocity, words', [
    (['la', 'lb', 'ma', 'la'], [0.0] * 4, (), "names 'la' more than once"),
    (['la', 'lb', 'ma'], [0.0] * 2, (), '3 names and 2 positions'),
    (['la', 'lb', 'ma'], [], (), '3 names and 0 positions'),
    (['la', 'lb', 'ma'], [0.0] * 3, [0.0], '3 names and 1 velocities'),
    (['la', 'lb', 'ma'], [0.0, NAN, 0.0], (), "position nan and velocity nan for 'lb'"),
    (['la', 'lb', 'ma'], [0.0, 0.0, math.inf], (), "inf and velocity nan for 'ma'"),
    (['la', 'lb', 'ma'], [1e308, 0.0, 0.0], (), "position 1e\\+308 and velocity nan for 'la'"),
    (['la', 'lb', 'ma'], [0.0] * 3, [0.0, math.inf, 0.0], "velocity inf for 'lb'"),
    (['x', 'y'], [0.0] * 2, (), 'has none of la, lb, ma'),
    ([], [], (), 'it has nothing'),
    (['la', 'lb', 'ma'] + ['x'] * 10**6, [0.0] * 3, (), '1000003 names, more than any robot')])
def test_messages_that_make_no_sense_are_refused_whole(names, position, velocity, words):
    merged = merger()
    take(merged, ['la', 'lb', 'ma'], [0.1, 0.2, 0.3], MS)
    before = merged.state[0].copy()
    with pytest.raises(ReadingError, match=words):
        take(merged, names, position, 3 * MS, velocity=velocity)
    np.testing.assert_array_equal(merged.state[0], before)
    assert take(merged, ['la', 'lb', 'ma'], [0.1, 0.2, 0.3], 5 * MS)


def test_a_refused_message_lays_no_claim_to_its_names():
    merged = merger(('wrong', 'right'))
    with pytest.raises(ReadingError, match='position nan'):
        take(merged, ['la', 'lb', 'ma'], [NAN, 0.0, 0.0], MS, source=0)
    assert take(merged, ['la', 'lb', 'ma'], [0.0] * 3, 2 * MS, source=1)


def test_a_name_from_two_sources_is_refused_and_a_missing_one_is_named():
    merged = merger(('one', 'two'))
    take(merged, ['la', 'lb'], [0.0, 0.0], MS, source=0)
    with pytest.raises(ReadingError, match="'la' comes from one and from two"):
        take(merged, ['la', 'ma'], [0.0, 0.0], MS, source=1)
    assert merged.absent() == ['ma']


def test_a_velocity_that_is_not_sent_is_the_low_passed_difference():
    """After k samples of a ramp it is v (1 - exp(-2 pi f k dt)), of a sent one itself."""
    merged, v, dt = merger(cutoff=20.0), 0.3, 0.002
    for k in range(200):
        assert take(merged, ['la', 'lb', 'ma'], [v * k * dt, 0.0, -100 * v * k * dt],
                    (k + 1) * 2 * MS, velocity=[NAN, 5.0, NAN])
        expected = v * (1.0 - math.exp(-2.0 * math.pi * 20.0 * k * dt))
        np.testing.assert_allclose(merged.state[1], [expected, -5.0, expected], atol=1e-12)
    assert merged.estimated == 400
    take(merged, ['la', 'lb', 'ma'], [9.0, 0.0, 9.0], 2000 * MS)  # after a gap it begins anew
    np.testing.assert_array_equal(merged.state[1], 0.0)


def test_stamps_of_the_own_clock_are_kept_to_the_nanosecond():
    timeline = Timeline()
    stamps = [10**18 + k * 2 * MS for k in range(100)]
    assert [timeline.read(stamp, stamp + 300_000) for stamp in stamps] == stamps
    assert timeline.jumps == 0


@pytest.mark.parametrize('jump', [1000 * 10**9, -1000 * 10**9, 10**17])
def test_a_clock_that_jumps_makes_time_neither_jump_nor_run_backwards(jump):
    timeline, times = Timeline(), []
    for k in range(100):
        now = 10**18 + k * 2 * MS
        times.append(timeline.read(now + (jump if k >= 50 else 0), now))
    assert None not in times and set(np.diff(times)) == {2 * MS}
    assert timeline.jumps == 1


@pytest.mark.parametrize('stall', [21, 25, 30, 60, 90])
@pytest.mark.parametrize('other', [0, 5 * 10**9])
def test_samples_that_had_to_wait_keep_their_times(stall, other):
    """The process stands still: what came meanwhile is read at once afterwards."""
    timeline, times = Timeline(), []
    for k in range(100):
        sent = 10**18 + k * 4 * MS
        waits = max(0, 10**18 + (200 + stall) * MS - sent) if sent >= 10**18 + 200 * MS else 0
        times.append(timeline.read(sent - other, sent + waits + k * 1000))
    assert timeline.jumps == 0
    assert None not in times and np.abs(np.diff(times) - 4 * MS).max() < 0.2 * MS


def test_a_clock_that_stays_behind_is_another_one():
    timeline, times = Timeline(), []
    for k in range(200):
        now = 10**18 + k * 4 * MS
        times.append(timeline.read(now - (24 * MS if k >= 50 else 0), now))
    assert timeline.jumps == 1
    assert abs(times[-1] - now) < MS


def test_another_clock_keeps_its_steps_and_is_followed_when_it_drifts():
    """A clock that starts at 5 s and runs 100 ppm slow for half an hour."""
    timeline, rng, times = Timeline(), np.random.default_rng(1), []
    for k in range(90_000):
        now = 10**18 + k * 20 * MS + int(rng.integers(0, MS))
        times.append(timeline.read(5 * 10**9 + round(k * 20 * MS * (1 - 1e-4)), now))
    steps = np.diff(times)
    assert timeline.jumps == 0
    assert np.abs(steps - 20 * MS * (1 - 1e-4)).max() < 20 * MS * 2e-3
    assert abs(times[-1] - now) < 10 * MS


def test_the_same_stamp_again_is_no_new_state_and_none_at_all_is_the_arrival():
    timeline = Timeline()
    assert timeline.read(10**9, 10**9) == 10**9
    assert timeline.read(10**9, 10**9 + MS) is None  # frozen
    assert timeline.read(10**9 - MS, 10**9 + MS) is None  # overtaken
    unstamped = Timeline()
    assert [unstamped.read(0, now) for now in (5, 7, 7, 9)] == [5, 7, None, 9]
