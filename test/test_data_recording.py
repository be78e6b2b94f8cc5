# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Even samples stamped late get their times back; filters that recordings are seen through."""

from dataclasses import replace

from gms_flex_control.data import signal_analysis
from gms_flex_control.data.bag import BagWarning
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.recording import on_even_clock, Recording, with_own_stamps
from gms_flex_control.data.signal_analysis import derivatives, low_pass, standing_out
from gms_flex_control.data.writer import write_recording
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.recording_checks import check
import numpy as np
import pytest
from scipy.signal import savgol_filter

PERIOD = 0.004
COUNT = 2.0 * np.pi / 2 ** 19


def angle_at(time):
    """Return a moving joint's angle as an encoder reads it [rad]."""
    angle = 0.7 * np.sin(2.0 * time) + 0.1 * np.sin(11.0 * time)
    return (COUNT * np.round(angle / COUNT))[:, None]


def taken(time, stamps):
    """Return a Recording of samples at times (T,) with other stamps (T,)."""
    return Recording(joints=('a',), time=stamps - stamps[0], source='a bag',
                     q_link=angle_at(time), tau_motor=angle_at(time))


def even(samples=5000):
    return PERIOD * np.arange(samples)


@pytest.mark.parametrize('lateness', [0.02, 0.1, 0.25])
def test_late_stamps_of_even_samples_are_seen_through(lateness):
    """Some samples are lost, and the clock that stamps them is 20 ppm off."""
    rng = np.random.default_rng(1)
    kept = rng.random(5000) > 0.003
    time = even()[kept]
    stamps = time * 1.00002 + PERIOD * np.abs(rng.normal(0.0, lateness, len(time)))
    stamps = np.maximum.accumulate(stamps) + 1e-9 * np.arange(len(time))
    found = on_even_clock(taken(time, stamps)).time
    steps = np.diff(found) / PERIOD
    np.testing.assert_array_equal(np.rint(steps), np.rint(np.diff(time) / PERIOD))
    np.testing.assert_allclose(steps, np.rint(steps), rtol=1e-4)
    again = on_even_clock(replace(taken(time, stamps), time=found))
    assert again.time is found or np.array_equal(again.time, found)


def test_stamps_that_are_true_stay():
    """Even ones to the bit; those of a loop that samples when it comes to it as well."""
    rng = np.random.default_rng(2)
    uneven = np.cumsum(PERIOD * rng.uniform(0.8, 1.4, 5000))
    for time in (even(), even()[rng.random(5000) > 0.01], uneven, even() + 0.3 * PERIOD * (
            rng.random(5000) - 0.5)):
        recording = taken(time, time)
        assert on_even_clock(recording) is recording


def test_a_joint_that_stands_says_nothing_of_its_clock():
    stamps = even() + np.abs(np.random.default_rng(3).normal(0.0, 0.1 * PERIOD, 5000))
    still = replace(taken(even(), stamps), q_link=np.zeros((5000, 1)))
    assert on_even_clock(still) is still


def test_a_pause_stays_as_long_as_it_was():
    time = np.concatenate([even(2000), 5.0 * PERIOD * 1000 + even(2000)])
    stamps = time + np.abs(np.random.default_rng(4).normal(0.0, 0.05 * PERIOD, 4000))
    found = on_even_clock(taken(time, stamps)).time
    np.testing.assert_allclose(found, time, atol=1e-3 * PERIOD)


def lost():
    """Return uneven times before and after some lost samples, and the number before."""
    time = np.cumsum(PERIOD * np.random.default_rng(6).uniform(0.8, 1.4, 5000))
    return np.delete(time, np.arange(2501, 2511)), 2501


@pytest.mark.parametrize('late', [False, True])
def test_a_sample_with_the_stamp_of_another_is_left_out(tmp_path, late):
    """It seems to jump, and to make up for it in the gap beside."""
    time, row = lost()
    stamps, wrong = time.copy(), row - 1 if late else row
    stamps[wrong] = time[row] - PERIOD if late else time[row - 1] + PERIOD
    recording = taken(time, stamps)
    found, (said,) = with_own_stamps(recording)
    np.testing.assert_array_equal(found.time, np.delete(recording.time, wrong))
    first = f'the first at {recording.time[wrong]:.3f} s'
    assert f'1 samples were stamped too early or too late, {first}' in said
    assert 'jump' in {one.kind for one in check(recording, rigid_joints(['a']))}
    assert 'jump' not in {one.kind for one in check(found, rigid_joints(['a']))}
    write_recording(tmp_path / 'bag', recording)
    with pytest.warns(BagWarning, match='1 samples were stamped too early'):
        read = read_recording(tmp_path / 'bag')
    np.testing.assert_allclose(read.time, found.time, atol=1e-9)
    np.savetxt(tmp_path / 'log.csv', np.column_stack([stamps, recording.q_link]), delimiter=',',
               header='t,q', comments='')
    (tmp_path / 'map.yaml').write_text(
        'time: {column: t, unit: s}\njoints:\n  a:\n    link_position: {column: q, unit: rad}\n')
    log = import_csv(tmp_path / 'log.csv', tmp_path / 'map.yaml')
    np.testing.assert_allclose(log.recording.time, found.time, atol=1e-9)
    assert 'stamped too early' in log.remarks[-1]


@pytest.mark.parametrize(('slip', 'back'), [
    (0.1, False), (-0.1, False), (2.0 * np.pi, False), (0.3, True), (-0.3, True)])
@pytest.mark.parametrize('before', [0, 1])
def test_a_jump_of_the_angle_beside_a_gap_stays(slip, before, back):
    """An encoder that slips is off by that after the gap as well, or was before."""
    time, row = lost()
    off, at = slip * (np.arange(len(time)) >= row - before), np.arange(len(time))
    off = np.where(back & (at > row - before), 0.0, off)
    recording = taken(time, time)
    recording = replace(recording, q_link=recording.q_link + off[:, None])
    assert with_own_stamps(recording) == (recording, [])


def test_a_bag_is_read_so(tmp_path):
    stamps = even() + np.abs(np.random.default_rng(5).normal(0.0, 0.1 * PERIOD, 5000))
    write_recording(tmp_path / 'bag', taken(even(), stamps))
    steps = np.diff(read_recording(tmp_path / 'bag', ['a']).time)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-6)


@pytest.mark.parametrize('window', range(2, 16))
def test_a_low_pass_has_no_phase(window):
    """What it makes of a pulse is symmetric about it, and a line stays where it is."""
    pulse = np.zeros(101)
    pulse[50] = 1.0
    seen = low_pass(pulse, window)
    np.testing.assert_allclose(seen, seen[::-1], atol=1e-15)
    assert seen.sum() == pytest.approx(1.0)
    line = np.linspace(-1.0, 3.0, 101)
    np.testing.assert_allclose(low_pass(line, window)[30:-30], line[30:-30], atol=1e-13)


def test_a_low_pass_has_lost_three_decibels_at_its_bandwidth():
    time = np.arange(4000) * 1e-3
    wave = np.sin(2.0 * np.pi * signal_analysis.low_pass_bandwidth(20, 1e-3) * time)
    ratio = np.std(low_pass(wave, 20)[500:-500]) / np.std(wave[500:-500])
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.02)


@pytest.mark.parametrize(('samples', 'window'), [(500, 17), (500, 1), (12, 17), (2, 5)])
def test_derivatives_are_those_of_scipy_up_to_both_ends(samples, window):
    period = 2e-3
    walk = np.random.default_rng(samples + window).standard_normal((samples, 2)).cumsum(axis=0)
    length = min(window, 2 * ((samples - 1) // 2) + 1)
    for order, found in enumerate(derivatives(walk, period, window)):
        expected = savgol_filter(walk, length, min(3, length - 1), order, period, axis=0)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    assert np.array_equal(*derivatives(walk, period, window, (2,)), found)


def motion(rng, seconds=80.0):
    """Return angle and rate (S,) of a motion to and fro."""
    time = np.arange(0.0, seconds, PERIOD)
    angle = 0.3 * np.sin(2 * np.pi * 0.05 * time) + 0.1 * np.sin(
        2 * np.pi * 0.17 * time + rng.uniform(0.0, 2 * np.pi))
    return angle, np.gradient(angle, PERIOD)


@pytest.mark.parametrize('order', [60.0, 200.0, 628.3])
def test_waves_below_the_noise_are_found(order):
    rng = np.random.default_rng(round(order))
    angle, rate = motion(rng)
    torque = 0.2 * np.sin(order * angle + 1.0) + rng.standard_normal(len(angle))
    torque += np.sign(rate) * 3.0  # what friction leaves
    found = standing_out([angle], [torque], [rate], 48.0)
    assert found[0] == pytest.approx(order, abs=0.25 * 2.0 * np.pi / np.ptp(angle))


@pytest.mark.parametrize('seed', range(8))
def test_noise_is_no_wave(seed):
    rng = np.random.default_rng(seed)
    angle, rate = motion(rng)
    assert standing_out([angle], [rng.standard_normal(len(angle))], [rate], 48.0) == ()
