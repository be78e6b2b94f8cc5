# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Faults of the data are named as such, before any physics; test_identification_checks has all."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from bench.hidden_robots.truth import simulate_open
from faulty import clipped, FAULTS, healthy, SIDES, taken
from gms_flex_control.data.recording import Recording
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND, UNEXPLAINED
from gms_flex_control.discrepancy.samples import faults_of
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.effects.registry import names
from gms_flex_control.errors import BagError
from gms_flex_control.identification.recording_checks import check
from identified_axis import axis
import numpy as np
import pytest

ALL = FAULTS | SIDES


@pytest.fixture(scope='module')
def case():
    """Return a healthy recording and its robot."""
    return make_case('clean', 3, duration=12.0)


def wrong(name):
    """Return a recording with a fault, and its robot."""
    recording, robot = healthy('unlike')
    return ALL[name][2](recording), robot


def commanded(recording, factor=1.0):
    """Return a recording of which the commands are left, scaled, but no efforts."""
    return replace(recording, command=factor * recording.command,
                   tau_motor=np.full_like(recording.tau_motor, np.nan))


@pytest.mark.parametrize('name', ['milliseconds', 'torques exchanged', 'motor angle reversed',
                                  'torque reversed'])
def test_a_fault_that_forbids_a_fit_ends_the_run_in_its_words(name):
    recording, robot = wrong(name)
    result = find_discrepancy([recording], robot)
    assert result.verdict == BAD_DATA and 'data are at fault' in result.words
    assert result.findings == () and result.unexplained is None and result.gap is None
    fault = next(one for one in check(recording, robot) if one.severity == 'refuse')
    assert fault.text in result.words.replace(' (of its torque commands, which the equations '
                                              'take)', '')


@pytest.mark.parametrize(('change', 'words'), [
    (lambda r: commanded(r, -1.0), 'wrong sign'),
    (lambda r: commanded(r, 1e3), 'times what its torsion'),
    (lambda r: commanded(replace(r, q_motor=-r.q_motor)), 'motor velocity of joint1 is not'),
    (lambda r: replace(r, command=-r.command), 'of its torque commands'),
    (lambda r: replace(r, command=1e3 * r.command), 'of its torque commands'),
    (lambda r: replace(r, command=r.command[:, ::-1]), 'of its torque commands')])
def test_commands_are_looked_over_instead_of_efforts_and_beside_them(case, change, words):
    """The equations take them, so right efforts do not help."""
    result = find_discrepancy([change(case.recording)], case.nominal)
    assert result.verdict == BAD_DATA and words in result.words


def test_a_channel_the_equations_need_is_asked_for(case):
    """Link angles alone can be computed."""
    blind = replace(case.recording, q_link=np.nan * case.recording.q_link,
                    q_motor=np.nan * case.recording.q_motor)
    result = find_discrepancy([blind], case.nominal)
    assert result.verdict == BAD_DATA
    assert 'link angle of joint1 was not recorded' in result.words
    with pytest.raises(BagError, match="the motor angle of 'joint1' is missing"):
        find_discrepancy([replace(case.recording, q_motor=np.nan * case.recording.q_motor)],
                         case.nominal)


def test_torques_that_never_change_were_not_recorded(case):
    zero = np.zeros_like(case.recording.tau_motor)
    found = faults_of([replace(case.recording, tau_motor=zero, command=np.nan * zero)],
                      case.nominal)
    assert [one.severity for one in found] == ['refuse'] and 'ever changes' in found[0].text


def test_a_fault_of_the_recording_held_out_counts_too(case):
    result = find_discrepancy([case.recording], case.nominal, holdout=[
        ALL['milliseconds'][2](case.recording)])
    assert result.verdict == BAD_DATA and 'another unit than seconds' in result.words


@pytest.mark.parametrize('name', ['clipped hard', 'bursts repeated', '10 % dropped'])
def test_a_fault_with_which_one_can_go_on_is_reported(name):
    found = faults_of([wrong(name)[0]], wrong(name)[1])
    assert {(one.kind, one.severity) for one in found} == {(ALL[name][0], 'warn')}


def test_short_recordings_are_long_together(case):
    """And one that moves one way stands beside others that move both ways."""
    time = case.recording.time
    parts = [taken(case.recording, np.flatnonzero((time >= begin) & (time < begin + 3.0)))
             for begin in (0.0, 2.0, 9.0)]
    short, one_way = ({one.kind for one in faults_of([part], case.nominal)} for part in parts[:2])
    assert short == {'too_short'} and one_way == {'too_short', 'one_direction'}
    assert faults_of(parts, case.nominal) == []
    assert {one.kind for one in faults_of(parts[:1], case.nominal, parts[1:])} == {'too_short'}


def test_one_goes_on_with_faults_that_are_reported(case):
    """But a command is all that was asked for, clipped or not, and is not called missing."""
    recording = clipped(case.recording, 0.7)
    limit = np.abs(recording.tau_motor).max(axis=0)
    recording = replace(recording, command=np.clip(recording.command, -limit, limit))
    result = find_discrepancy([recording], case.nominal, SearchOptions(most=0))
    assert result.verdict != BAD_DATA and 'clipped' in result.words
    assert faults_of([commanded(recording)], case.nominal) == []


def test_joints_are_known_by_name_whatever_their_order(case):
    """From Python nobody has put them in the robot's order before."""
    recording = case.recording
    turned = recording.of_joints(recording.joints[::-1])
    assert turned.joints == ('joint2', 'joint1')
    found = [find_discrepancy([one], case.nominal, SearchOptions(most=0))
             for one in (recording, turned)]
    assert found[0].words == found[1].words
    assert found[0].verdict != BAD_DATA and found[0].data.faults == ()
    alone = find_discrepancy([recording.of_joints(['joint2'])], case.nominal)
    assert alone.verdict == BAD_DATA and "no joint 'joint1'" in alone.words
    with pytest.raises(BagError, match="no joint 'joint1'"):
        find_discrepancy([recording.of_joints(['joint2'])], case.nominal,
                         SearchOptions(force=True))


@pytest.mark.parametrize(('change', 'word'), [
    (lambda r: replace(r, time=np.concatenate([[0.0], 8.5e8 + r.time[1:]])), 'missing in'),
    (lambda r: taken(r, np.arange(3)), '3 samples')])
def test_faults_of_time_are_reported_where_links_are_not_seen(case, change, word):
    """Nothing is computed along such a time, though link angles would have to be."""
    blind = replace(case.recording, q_link=np.nan * case.recording.q_link,
                    dq_link=np.nan * case.recording.dq_link)
    result = find_discrepancy([change(blind)], case.nominal)
    assert result.verdict == BAD_DATA and word in result.words


def test_with_no_effect_to_look_for_it_is_said_that_something_is_left():
    case = make_case('single', 0, plant='soft', duration=20.0)
    result = find_discrepancy([case.recording], case.nominal, SearchOptions(without=names()))
    assert result.verdict == UNEXPLAINED and result.searched.tried == ()


@pytest.mark.parametrize('samples', [1, -5])
def test_torque_that_was_recorded_late_or_early_is_named(case, samples):
    """By samples of 2 ms, of all joints alike; late encoders explain less of it."""
    def later(torque):
        return torque[np.clip(np.arange(len(torque)) - samples, 0, len(torque) - 1)]

    shifted = replace(case.recording, command=later(case.recording.command),
                      tau_motor=later(case.recording.tau_motor))
    result = find_discrepancy([shifted], case.nominal, SearchOptions(most=1))
    first = result.findings[0]
    assert (first.effect, first.joint) == ('recording_delay', 'arm'), result.words
    assert first.values[0].value == pytest.approx(-2e-3 * samples, rel=0.1)
    if abs(samples) > 1:  # one matters little: written if noise does not hide that
        assert [spec.name for spec in result.robot.effects] == ['recording_delay']
        assert np.all(result.gap.free_after < 0.6 * result.gap.free_before)


def axis_result(channel, recorded):
    """Return what is said of a rigid axis whose torque was recorded as a function of the true."""
    robot, time = axis(rigid=True), 2e-3 * np.arange(10_001)
    command = sum(size * np.sin(2.0 * np.pi * hertz * time[:-1])
                  for size, hertz in ((0.3, 0.7), (0.3, 1.9), (0.15, 4.3)))
    angle = simulate_open(robot, command[:, None])[:, 0]
    noise = 1e-6 * np.random.default_rng(4).standard_normal(angle.shape)
    return find_discrepancy([Recording(
        joints=robot.joints, time=time, q_link=angle + noise, source='an axis',
        **{channel: recorded(command)[:, None]})], robot, SearchOptions(most=1))


@pytest.mark.parametrize(('channel', 'lost'), [('tau_motor', 2), ('command', 1)])
def test_torque_of_a_single_axis_that_was_recorded_late_is_named(channel, lost):
    """
    Measured or commanded, no drive is early: nothing else may stand for it.

    A sample late: measured is that of the sample that ended, commanded that which begins.
    """
    result = axis_result(channel, lambda command: np.append(
        np.zeros(lost), command[:len(command) + 1 - lost]))
    first = result.findings[0]
    assert (first.effect, first.joint) == ('recording_delay', 'arm'), result.words
    assert first.values[0].value == pytest.approx(-2e-3, rel=0.05)


@pytest.mark.parametrize('samples', [1, 2])
def test_a_drive_that_reports_the_torque_which_begins_lacks_nothing(samples):
    """One that is stamped earlier still does."""
    result = axis_result('tau_motor', lambda command: np.append(
        command[samples - 1:], np.zeros(samples)))
    first, = result.minor if samples == 1 else result.findings
    assert (first.effect, first.joint) == ('recording_delay', 'arm'), result.words
    assert first.values[0].value == pytest.approx(2e-3 * samples, rel=0.05)
    assert result.verdict == (COMPLETE if samples == 1 else FOUND)


def test_who_insists_is_answered(case):
    """With ``force`` the faults are listed and the run goes on."""
    result = find_discrepancy([ALL['slipped'][2](case.recording)], case.nominal,
                              SearchOptions(force=True, most=1))
    assert result.verdict != BAD_DATA and result.data.faults and result.gap is not None
