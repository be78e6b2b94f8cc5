# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Which rows of a recording count, where a fit begins and when it is better than a simple one."""

from core_runs import single_axis
from discrepancy_runs import FRICTIONLESS
from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.assumed_robot import at_own_rate, rigid_joints
from gms_flex_control.identification.believed_arm import Believed
from gms_flex_control.identification.friction_map import start_of
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.least_squares import TorqueError
from gms_flex_control.identification.objective import everything, Objective
from gms_flex_control.identification.outcome import FrictionMap
from gms_flex_control.identification.prediction_error import simple_free
from gms_flex_control.identification.problem import Problem
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


SPEED = np.geomspace(0.02, 1.0, 40)
RATE = np.concatenate([-SPEED, SPEED])


def begun(torque):
    """Return the Start of friction over RATE, 2 rad of travel and an encoder of 0.1 mrad."""
    return start_of(FrictionMap(RATE, torque, np.ones(len(RATE), dtype=bool)), 2.0, 1e-4,
                    'elbow', 'bag')


def test_a_fit_begins_with_coulomb_and_viscous_friction():
    start = begun(2.0 * np.sign(RATE) + 3.0 * RATE)
    for way in start.straight:
        np.testing.assert_allclose([way.coulomb, way.viscous], [2.0, 3.0], rtol=1e-3)


def test_a_constant_torque_above_friction_hides_no_friction():
    """Half of what both ways differ by is friction, half of their sum another torque."""
    with pytest.warns(UserWarning, match='elbow drives its backward motion as often as it brakes'):
        start = begun(2.0 * np.sign(RATE) + 5.0)
    assert start.backward.coulomb == pytest.approx(2.0)


@pytest.mark.parametrize('torque', [-2.0 * np.sign(RATE), -2.0 * np.sign(RATE) + 1.0])
def test_friction_that_drives_both_ways_together_is_refused(torque):
    with pytest.raises(IdentificationError, match='of elbow would drive its .* check the sign'):
        begun(torque)


INERTIA, COULOMB, VISCOUS = 0.05, 0.3, 0.02
NOISE = 0.07  # of the torque's readings, a quarter of friction [N m]
FALLS_BY, OVER = 0.15, 3.0  # friction from rest to high speed [N m], within so much [rad/s]


def recorded(drop, noise, seed, seconds=24.0, period=2e-3):
    """Return a Recording of an axis whose friction falls by ``drop``, torques read with noise."""
    rng, time = np.random.default_rng(seed), np.arange(round(seconds / period)) * period
    turn = 2.0 * np.pi * np.array([0.31, 0.83, 1.7])[:, None]
    size, phase = np.array([1.2, 0.5, 0.15])[:, None], rng.uniform(0.0, 6.0, 3)[:, None]
    angle = np.sum(size * np.sin(turn * time + phase), axis=0)
    rate = np.sum(size * turn * np.cos(turn * time + phase), axis=0)
    friction = np.sign(rate) * (COULOMB + drop * np.exp(-np.abs(rate) / OVER)) + VISCOUS * rate
    torque = INERTIA * np.gradient(rate, period) + friction
    torque = np.concatenate([torque[:1], 0.5 * (torque[1:] + torque[:-1])])  # of the sample ended
    torque += noise * rng.standard_normal(len(time))
    return Recording(joints=('axis',), time=time, source='turned', q_link=angle[:, None],
                     tau_motor=torque[:, None])


def test_a_correction_of_the_arm_explains_the_torque_of_what_was_believed_wrongly():
    """The axis turns by 0.05 kg m^2, 0.04 are believed: the rest is the one further torque."""
    robot = single_axis(FRICTIONLESS, 0.8 * INERTIA)
    bundle = Problem([(recorded(0.0, 0.0, 0), ())], (), robot,
                     beside=Believed(robot.arm, *np.zeros((2, 1)))).bundle
    bundle = bundle._replace(extras=(lambda segment: -segment.acceleration,))
    left = {}
    for correction in (0.0, 0.2 * INERTIA):
        coordinates, free = simple_free(np.array([COULOMB, COULOMB, VISCOUS, VISCOUS, correction]),
                                        1e-6)
        theta = coordinates.parameters(free)
        error = TorqueError(Objective(bundle, 0, [theta]), everything, 1e-9)
        left[correction] = np.sqrt(np.mean(error(theta)[500:] ** 2))
    assert left[0.2 * INERTIA] < 0.1 * left[0.0]


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('drop, is_simple', [(FALLS_BY, False), (0.0, True)])
def test_friction_that_falls_is_found_where_it_explains_little_but_always(drop, is_simple, seed):
    robot = single_axis(FRICTIONLESS, INERTIA)
    found = identify([recorded(drop, NOISE, seed)], robot, options=IdentifyOptions(blocks=(1,)))
    sentences = ' '.join(found.joints[0].warnings)
    assert ('do not identify GMS friction' in sentences) is is_simple, sentences


def test_friction_that_falls_is_found_though_few_moments_show_it():
    """The axis is slow in 1.5 of 24 s: what is missed less is missed less there."""
    robot, rng, period = single_axis(FRICTIONLESS, INERTIA), np.random.default_rng(5), 2e-3
    time = np.arange(12_000) * period
    slow = np.convolve(np.abs(time - 15.0) < 0.75, np.ones(250) / 250, mode='same')
    rate = (1.0 - 0.97 * slow) * (4.0 * np.sin(2.0 * time) + 2.0 * np.sin(5.3 * time))
    angle = np.cumsum(rate) * period
    falling = np.sign(rate) * (COULOMB + FALLS_BY * np.exp(-(rate / 0.3) ** 2))
    torque = INERTIA * np.gradient(rate, period) + falling + VISCOUS * rate
    torque = np.concatenate([torque[:1], 0.5 * (torque[1:] + torque[:-1])])
    found = identify([Recording(
        joints=('axis',), time=time, source='turned', q_link=angle[:, None],
        tau_motor=(torque + 0.01 * rng.standard_normal(len(time)))[:, None])], robot,
        options=IdentifyOptions(blocks=(1,)))
    friction = found.robot.friction.forward
    assert friction.static[0] - friction.coulomb[0] == pytest.approx(FALLS_BY, rel=0.2)
    assert 'do not identify GMS friction' not in ' '.join(found.joints[0].warnings)
