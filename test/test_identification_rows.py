# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Which rows of a recording count in a regression, and how much."""

from gms_flex_control.data.recording import Recording
from gms_flex_control.identification.assumed_robot import at_own_rate, rigid_joints
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.robust_regression import regress, robust, weighting_of
from gms_flex_control.identification.segments import half_count, segments_of, while_moved
import numpy as np
import pytest


@pytest.mark.parametrize('columns', [2, 30, 60])
def test_noise_is_that_of_the_rows_however_many_columns_follow_it(columns):
    rng = np.random.default_rng(4)
    scales = [robust(rng.standard_normal((80, columns)), 3.0 * rng.standard_normal(80))[1]
              for _ in range(40)]
    assert np.median(scales) == pytest.approx(3.0, rel=0.15)


def test_a_joint_with_fewer_rows_than_numbers_has_no_say():
    """Its own numbers explain three rows to the last digit; they would outweigh all others."""
    rng, (samples, numbers) = np.random.default_rng(5), (300, 5)
    regressors = rng.standard_normal((samples, 2, numbers))
    truth = np.arange(1.0, 6.0)
    torque = regressors @ truth + 0.1 * rng.standard_normal((samples, 2))
    torque[:, 1] += 10.0  # which the links do not make
    rate = np.ones((samples, 2))
    rate[3:, 1] = 0.0

    def friction(joint, rows):
        return np.ones((len(rate[rows]), 1))
    weighting = weighting_of(regressors, torque - regressors @ truth, rate,
                             lambda joint, rows: np.eye(samples)[rows][:, :3], None)
    assert not weighting[1][1].any()
    weighting[0] = weighting_of(regressors[:, :1], torque[:, :1], rate[:, :1], friction)[0]
    values, _, _ = regress(regressors, torque, np.arange(samples) // 30, friction, weighting)
    np.testing.assert_allclose(values, truth, atol=0.05)


def test_a_joint_that_gives_way_a_little_is_held_also_where_gaps_cut_its_own_motion():
    """It moves by 1 rad in the first recording, of whose pieces none holds more than 0.2."""
    robot, time = rigid_joints(('shoulder', 'elbow')), np.arange(0.0, 30.0, 0.01)
    going = np.stack([time / 30.0, np.zeros(len(time))], axis=1)
    giving = np.stack([0.004 * np.sin(time), 0.5 * np.sin(time)], axis=1)
    kept = time % 6.0 < 5.5
    recordings = [Recording(joints=robot.joints, time=time[rows], source=name, q_link=q[rows],
                            tau_motor=np.outer(np.sin(time[rows]), [1.0, 1.0]))
                  for name, q, rows in (('first', going, kept), ('second', giving, time >= 0.0))]
    segments = [one for recording in recordings
                for one in segments_of(recording, robot, ('motor',) * 2)]
    tested = [one.tested.any(axis=0).tolist() for one in while_moved(segments, recordings)]
    assert tested == [[True, False]] * 5 + [[False, True]]


def slow_source():
    """Return a robot, a Recording at 350 Hz of a drive that is read at 29 Hz, and its period."""
    rng, time, period = np.random.default_rng(6), np.arange(0.0, 60.0, 1e-3), 0.034
    q = 0.3 * np.sin(2.0 * time) + 0.2 * np.sin(3.1 * time) + 0.3 * np.sin(0.5 * time)
    rate = np.gradient(q, time)
    torque = np.gradient(rate, time) + 4.0 * np.tanh(rate / 2e-3) + 1.5 * rate
    read = np.arange(34, len(time), 34)  # the mean torque since the reading before
    mean = np.diff(np.cumsum(torque)[read], prepend=np.sum(torque[:35])) / 34
    mean += 0.2 * rng.standard_normal(len(read))
    angle = q[read] + 2e-4 * rng.standard_normal(len(read))
    logged = np.arange(0.04, 59.9, 1.0 / 350.0)
    last = np.searchsorted(time[read], logged, side='right') - 1
    return rigid_joints(('axis',)), Recording(
        joints=('axis',), time=logged, source='held', q_link=angle[last][:, None],
        tau_motor=mean[last][:, None]), period


def test_readings_that_a_slow_source_holds_are_no_further_samples():
    """Else a step comes where it has long been: Coulomb friction was 6 times what it is."""
    robot, held, period = slow_source()
    with pytest.warns(UserWarning, match='those that are repeated do not count'):
        taken = at_own_rate(held)
    assert taken.period == pytest.approx(period, rel=0.02)
    found = identify([held], robot, options=IdentifyOptions(blocks=(1,)))
    assert not any('repeated; record' in one for one in found.warnings)
    for side in (found.robot.friction.forward, found.robot.friction.backward):
        assert side.coulomb[0] == pytest.approx(4.0, rel=0.05)
        assert side.viscous[0] == pytest.approx(1.5, rel=0.2)


def test_counts_of_an_encoder_are_not_taken_for_a_slow_source():
    """It stays within a count for uneven times, with a torque that changes as seldom."""
    time = np.arange(0.0, 20.0, 0.002)
    q = np.round(0.05 * np.sin(time) / 1e-3) * 1e-3
    recording = Recording(joints=('axis',), time=time, source='counts', q_link=q[:, None],
                          tau_motor=np.round(np.sin(time) / 0.02)[:, None])
    assert at_own_rate(recording) is recording


@pytest.mark.parametrize(('count', 'noise', 'seen'), [
    (3e-4, 0.0, True), (3e-4, 10.0, False), (1e-6, 0.0, False), (1e-6, 0.3, False)])
def test_an_encoder_counts_also_where_a_quick_joint_repeats_no_reading(count, noise, seen):
    """Noise of ten counts hides them, and so does motion by thousands from sample to sample."""
    time = np.arange(0.0, 20.0, 0.004)
    q = 1.6 * np.sin(2.5 * time) + noise * count * np.random.default_rng(7).standard_normal(5000)
    read = count * np.round(q / count)
    assert np.mean(np.diff(read) == 0.0) < 0.02
    recording = Recording(joints=('axis',), time=time, source='quick', q_link=read[:, None],
                          tau_motor=np.zeros((5000, 1)))
    half, = half_count(recording, rigid_joints(('axis',)))
    assert half == pytest.approx(0.5 * count if seen else 0.0, rel=1e-6)
