# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Faults of the data are named as such, before any physics."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from gms_flex_control.discrepancy.data_faults import faults_of
from gms_flex_control.discrepancy.result import BAD_DATA, UNEXPLAINED
from gms_flex_control.discrepancy.workflow import find_discrepancy, Options
from gms_flex_control.effects.registry import names
from gms_flex_control.errors import BagError
import numpy as np
import pytest

CHANNELS = ('q_link', 'dq_link', 'q_motor', 'dq_motor', 'tau_motor', 'command', 'friction_hat')


@pytest.fixture(scope='module')
def case():
    """Return a healthy recording and its robot."""
    return make_case('clean', 3, duration=20.0)


def taken(recording, rows, time=None):
    """Return a recording of some samples, at other times if they are given."""
    time = recording.time[rows] if time is None else time
    return replace(recording, time=time - time[0], reference=recording.reference[rows],
                   supply=None, **{name: getattr(recording, name)[rows] for name in CHANNELS})


def swapped_joints(recording):
    """Return a recording whose joints stand under each other's names."""
    return replace(recording, **{name: getattr(recording, name)[:, ::-1] for name in CHANNELS})


def swapped_angles(recording):
    """Return a recording in which the link encoders are exchanged."""
    return replace(recording, q_link=recording.q_link[:, ::-1], dq_link=recording.dq_link[:, ::-1])


def clock_jump(recording):
    """Return a recording whose clock was set ahead by half a second."""
    return taken(recording, slice(None), recording.time + 0.5 * (recording.time > 9.0))


def half_lost(recording):
    """Return a recording with half of its samples missing, in bursts."""
    return taken(recording, np.flatnonzero(np.arange(len(recording.time)) // 50 % 2 == 0))


def scaled(name, factor):
    """Return a function that scales a channel, in all its parts."""
    return lambda recording: replace(recording, **{name: factor * getattr(recording, name)})


def without_rates(change):
    """Return a function that changes a recording and drops the rates of motors."""
    def changed(recording):
        recording = change(recording)
        return replace(recording, dq_motor=np.full_like(recording.dq_motor, np.nan))
    return changed


def torque(factor):
    """Return a function that scales torque, as asked for and as given."""
    return lambda recording: replace(recording, command=factor * recording.command,
                                     tau_motor=factor * recording.tau_motor)


def commanded(change):
    """Return a function that changes a recording and drops the efforts: commands are left."""
    def changed(recording):
        recording = change(recording)
        return replace(recording, tau_motor=np.full_like(recording.tau_motor, np.nan))
    return changed


def slipped(recording):
    """Return a recording in which an encoder slips."""
    late = (recording.time > 8.0)[:, None]
    return replace(recording, q_link=recording.q_link + 0.05 * late)


def clipped(recording):
    """Return a recording whose torque was cut off at less than it often was."""
    limit = np.quantile(np.abs(recording.tau_motor), 0.7, axis=0)
    return replace(recording, tau_motor=np.clip(recording.tau_motor, -limit, limit),
                   command=np.clip(recording.command, -limit, limit))


def repeated(recording):
    """Return a recording in which bursts of samples repeat the one before."""
    rows = np.arange(len(recording.time))
    held = np.where(rows % 400 < 20, rows - rows % 400, rows)
    return taken(recording, held, recording.time)


def exchanged_sides(recording):
    """Return a recording whose motors and links stand under each other's names."""
    return replace(recording, q_link=recording.q_motor, dq_link=recording.dq_motor,
                   q_motor=recording.q_link, dq_motor=recording.dq_link)


def at_rest(recording):
    """Return a recording of a robot that holds its angles, in which there is nothing to see."""
    rng = np.random.default_rng(0)
    noise = 1e-5 * rng.standard_normal((2, *recording.q_link.shape))
    none = np.zeros_like(recording.q_link)
    return replace(recording, q_link=recording.q_link[:1] + noise[0], dq_link=none,
                   q_motor=recording.q_motor[:1] + noise[1], dq_motor=none)


def some_lost(recording):
    """Return a recording with a tenth of its samples missing, one at a time."""
    return taken(recording, np.flatnonzero(np.arange(len(recording.time)) % 10 != 4))


def one_way(recording):
    """Return a recording whose first joint goes backwards no more than it must."""
    forward = np.cumsum(np.maximum(np.diff(recording.q_link[:, 0], prepend=0.0), 0.0))
    q_link, q_motor = recording.q_link.copy(), recording.q_motor.copy()
    q_motor[:, 0] += forward - q_link[:, 0]
    q_link[:, 0] = forward
    return replace(recording, q_link=q_link, q_motor=q_motor,
                   dq_link=np.full_like(q_link, np.nan), dq_motor=np.full_like(q_link, np.nan))


REFUSED = {
    'sides exchanged': exchanged_sides, 'no excitation': at_rest,
    'link rate in degrees per second': scaled('dq_link', 57.3),
    'joints swapped': swapped_joints, 'link encoders swapped': swapped_angles,
    'clock jump': clock_jump, 'milliseconds': lambda r: replace(r, time=1e3 * r.time),
    'half lost': half_lost, 'no angle': lambda r: replace(
        r, q_link=np.nan * r.q_link, q_motor=np.nan * r.q_motor),
    'motor reversed': without_rates(scaled('q_motor', -1.0)),
    'motor in gear units': without_rates(scaled('q_motor', 50.0)),
    'torque reversed': torque(-1.0), 'torque in mN m': torque(1e3), 'slipped': slipped,
    'commands reversed': commanded(torque(-1.0)), 'commands in mN m': commanded(torque(1e3)),
    'motor reversed, commands': commanded(scaled('q_motor', -1.0)),
    'too short': lambda r: taken(r, np.arange(500))}
WORDS = {
    'sides exchanged': 'motor and link of joint1 seem exchanged',
    'no excitation': 'joint1 never moves', 'clock jump': 'the clock jumps ahead',
    'link rate in degrees per second': 'but 57.3 times it', 'half lost': 'are missing in',
    'milliseconds': 'another unit than seconds', 'motor in gear units': '50.32 times as far',
    'torque reversed': 'wrong sign', 'slipped': 'jumps',
    'joints swapped': 'names of joint1 and joint2 seem exchanged',
    'link encoders swapped': 'angles of one side of joint1 and joint2 seem exchanged',
    'no angle': 'link angle of joint1 was not recorded', 'motor reversed': '-1.006 times as far',
    'motor reversed, commands': 'motor velocity of joint1 is not', 'too short': 'are too short',
    'torque in mN m': 'times what its torsion', 'commands in mN m': 'times what its torsion',
    'commands reversed': 'wrong sign'}
TOLD = {'torque clipped': (clipped, 'clipped'), 'samples repeated': (repeated, 'repeat'),
        'a tenth lost': (some_lost, 'missing'), 'one way': (one_way, 'forward only')}


@pytest.mark.parametrize('name', REFUSED)
def test_a_fault_of_the_data_ends_the_run_with_its_name(case, name):
    result = find_discrepancy([REFUSED[name](case.recording)], case.nominal)
    assert result.verdict == BAD_DATA
    assert result.findings == () and result.unexplained is None and result.gap is None
    assert result.faults and result.faults[0] in result.words
    assert WORDS[name] in result.words
    assert 'was not recorded' not in result.words or name == 'no angle'
    assert 'data are at fault' in result.words


def test_a_channel_the_equations_need_is_asked_for(case):
    with pytest.raises(BagError, match="the motor angle of 'joint1' is missing"):
        find_discrepancy([scaled('q_motor', np.nan)(case.recording)], case.nominal)


def test_a_fault_of_the_recording_held_out_counts_too(case):
    result = find_discrepancy([case.recording], case.nominal,
                              holdout=[clock_jump(case.recording)])
    assert result.verdict == BAD_DATA and 'clock' in result.words


@pytest.mark.parametrize('name', TOLD)
def test_a_fault_with_which_one_can_go_on_is_told(case, name):
    change, word = TOLD[name]
    found = faults_of([change(case.recording)], case.nominal)
    assert any(word in finding.text for finding in found), found
    assert all(finding.severity == 'warn' for finding in found)


def test_one_goes_on_with_faults_that_are_told(case):
    result = find_discrepancy([clipped(case.recording)], case.nominal, Options(most=0))
    assert result.verdict != BAD_DATA and 'clipped' in result.words


def test_a_command_is_all_that_was_asked_for_clipped_or_not(case):
    """Where no effort was recorded it is the torque, and is not called missing either."""
    result = find_discrepancy([commanded(clipped)(case.recording)], case.nominal, Options(most=0))
    assert result.faults == () and result.verdict != BAD_DATA


@pytest.mark.parametrize('change', [
    lambda torque: -torque, lambda torque: 1e3 * torque, lambda torque: torque[:, ::-1]])
def test_commands_are_looked_over_beside_efforts(case, change):
    """The equations take them, so right efforts do not help."""
    wrong = replace(case.recording, command=change(case.recording.command))
    result = find_discrepancy([wrong], case.nominal)
    assert result.verdict == BAD_DATA and 'of its torque commands' in result.words


def test_joints_are_known_by_name_whatever_their_order(case):
    """From Python nobody has put them in the robot's order before."""
    recording = case.recording
    turned = recording.of_joints(recording.joints[::-1])
    assert turned.joints == ('joint2', 'joint1')
    told = [find_discrepancy([one], case.nominal, Options(most=0)) for one in (recording, turned)]
    assert told[0].words == told[1].words and told[0].verdict != BAD_DATA
    alone = find_discrepancy([recording.of_joints(['joint2'])], case.nominal)
    assert alone.verdict == BAD_DATA and "no joint 'joint1'" in alone.words
    with pytest.raises(BagError, match="no joint 'joint1'"):
        find_discrepancy([recording.of_joints(['joint2'])], case.nominal, Options(force=True))


@pytest.mark.parametrize(('change', 'word'), [
    (lambda r: replace(r, time=np.concatenate([[0.0], 8.5e8 + r.time[1:]])), 'missing in'),
    (lambda r: taken(r, np.arange(3)), '3 samples')])
def test_faults_of_time_are_told_where_links_are_not_seen(case, change, word):
    """Nothing is computed along such a time, though link angles would have to be."""
    blind = replace(case.recording, q_link=np.nan * case.recording.q_link,
                    dq_link=np.nan * case.recording.dq_link)
    result = find_discrepancy([change(blind)], case.nominal)
    assert result.verdict == BAD_DATA and word in result.words


def test_with_no_effect_to_look_for_it_is_said_that_something_is_left():
    case = make_case('single', 0, plant='soft', duration=20.0)
    result = find_discrepancy([case.recording], case.nominal, Options(without=names()))
    assert result.verdict == UNEXPLAINED and result.tried == ()


@pytest.mark.parametrize('late', [1])
def test_torque_that_was_recorded_late_is_named(case, late):
    """By whole samples of 2 ms, of all joints alike; late encoders explain less of it."""
    def later(torque):
        return np.concatenate([np.repeat(torque[:1], late, axis=0), torque[:-late]])
    shifted = replace(case.recording, command=later(case.recording.command),
                      tau_motor=later(case.recording.tau_motor))
    result = find_discrepancy([shifted], case.nominal)
    first = result.findings[0]
    assert (first.effect, first.joint) == ('recording_delay', 'arm'), result.words
    assert first.values[0].value == pytest.approx(-2e-3 * late, rel=0.1)


def test_who_insists_is_answered(case):
    """With ``force`` the faults are listed and the run goes on."""
    result = find_discrepancy([slipped(case.recording)], case.nominal, Options(force=True, most=1))
    assert result.verdict != BAD_DATA and result.faults and result.gap is not None


def test_a_healthy_recording_has_no_fault(case):
    result = find_discrepancy([case.recording], case.nominal, Options(most=0))
    assert result.faults == () and result.verdict != BAD_DATA
