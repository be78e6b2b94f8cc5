# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Residuals whitened, and torque noise of drives that nobody recorded: measured, no effect."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from core_runs import affected, effect_on
from discrepancy_runs import driven_motion, likelihood_of, retuned_of
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.remainder import FreeFunctions
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.result import COMPLETE, FOUND
from gms_flex_control.discrepancy.thresholds import EVIDENCE, PLAUSIBLE, PRACTICAL
from gms_flex_control.discrepancy.torque_noise import white_noise
from gms_flex_control.discrepancy.whitening import Octaves, Whitening
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d


@pytest.fixture(scope='module')
def octaves():
    return Octaves(320, 4)


def test_numbers_are_a_turned_view_of_the_samples(octaves):
    """The transform of the unit matrix is orthonormal: all is kept, nothing reported twice."""
    matrix = octaves(np.fft.fft(np.eye(320), axis=0))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(320), atol=1e-12)
    assert [len(part) for part in octaves.parts] == [160, 80, 40, 20, 20]


def test_rows_of_even_noise_are_white_and_of_unit_variance():
    """Coloured noise that two equations share: rows of a run that was not measured are plain."""
    rng, period = np.random.default_rng(0), 4e-3
    white = rng.standard_normal((7, 10000, 2)) @ [[1.0, 0.8], [0.0, 0.5]]
    noise = white - 0.9 * np.roll(white, 1, axis=1)
    noise[..., 1] = uniform_filter1d(noise[..., 1], 5, axis=1)
    whitening = Whitening(noise[:6], period, np.zeros(2), np.ones(noise.shape[1], dtype=bool))
    rows = whitening.whiten(noise[6])
    rows = rows[np.any(rows, axis=1)]
    assert np.all(np.abs(rows.var(axis=0) - 1.0) < 0.15)
    allowed = 4.0 / np.sqrt(len(rows)) + 0.03
    for lag in (1, 2, 3, 10):
        assert np.all(np.abs(np.mean(rows[lag:] * rows[:-lag], axis=0)) < allowed)
    assert abs(np.mean(rows[:, 0] * rows[:, 1])) < allowed
    assert np.mean(np.abs(rows) > 1.96) == pytest.approx(0.05, abs=0.02)


def test_rows_of_torques_in_one_equation_are_those_of_residuals_without_any_other():
    """Two equations share their noise, a third is always zero: it stays so."""
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((6, 4000, 2)) @ [[1.0, 0.0, 0.8], [0.0, 0.0, 0.5]]
    whitening = Whitening(noise, 4e-3, np.full(3, 0.1), np.ones(4000, dtype=bool))
    torques = rng.standard_normal((4000, 5))
    for channel in range(3):
        residuals = np.zeros((5, 4000, 3))
        residuals[:, :, channel] = torques.T
        rows = whitening.whiten_each(torques, channel)
        assert np.any(rows) == (channel != 1) and not np.any(rows[:, 1])
        np.testing.assert_allclose(rows, np.stack([
            whitening.whiten(one) for one in residuals], axis=-1), rtol=0, atol=1e-12)


def test_where_an_equation_says_nothing_its_residual_counts_nothing():
    """A torque of a thousand times the noise while a link stands changes no row elsewhere."""
    noise = np.random.default_rng(2).standard_normal((7, 10000, 1))
    known = np.ones(10000, dtype=bool)
    known[4000:6000] = False
    whitening = Whitening(noise[:6], 4e-3, np.zeros(1), known)
    stuck = noise[6].copy()
    stuck[4000:6000] += 1000.0
    rows = whitening.whiten(stuck)
    np.testing.assert_allclose(rows, whitening.whiten(noise[6]), rtol=1e-9, atol=1e-9)
    inside = (whitening.row_time > 16.01) & (whitening.row_time < 23.99)
    reported = rows[~inside & np.any(rows, axis=1)]
    assert not np.any(rows[inside]) and reported.var() == pytest.approx(1.0, abs=0.2)


def test_slow_noise_of_rests_does_not_hide_what_is_slow_in_motion():
    """Torque as large as white noise, which at rest wanders slowly by twenty times as much."""
    rng, period = np.random.default_rng(5), 4e-3
    noise = rng.standard_normal((7, 15000, 1))
    slow = uniform_filter1d(rng.standard_normal(noise.shape), 250, axis=1)
    resting = (np.arange(15000) % 3000 < 900)[:, None]
    noise += 20.0 * slow / slow.std() * uniform_filter1d(resting.astype(float), 100, axis=0)
    whitening = Whitening(noise[:6], period, np.zeros(1), np.ones(noise.shape[1], dtype=bool))
    torque = np.sign(np.sin(2.0 * np.pi * 0.2 * period * np.arange(15000)))[:, None]
    assert np.sum(whitening.whiten(torque) ** 2) > 0.1 * np.sum(torque[~resting] ** 2)
    rows = whitening.whiten(noise[6])
    assert rows[np.any(rows, axis=1)].var() == pytest.approx(1.0, abs=0.25)


def test_a_floor_makes_all_below_it_small():
    """Noise a tenth of the floor counts a hundredth; noise far above is hardly changed."""
    noise = np.random.default_rng(1).standard_normal((7, 10000, 1))
    share = 20.0 / 125.0  # of the power of white noise that lies below 20 Hz
    for floor, level in ((10.0, 0.01), (0.1, 1.0)):
        whitening = Whitening(noise[:6], 4e-3, np.array([floor * np.sqrt(share)]),
                              np.ones(noise.shape[1], dtype=bool))
        whitening.scale[:] = 1.0
        assert whitening.whiten(noise[6]).var() == pytest.approx(level, rel=0.1)


SHORT = 14.0  # [s]


def test_of_drives_without_noise_next_to_none_is_reported():
    """Less than half a percent of F_s, which is a twelfth of what noisy drives have."""
    case = make_case('clean', 4, duration=SHORT)
    likelihood = likelihood_of(case)
    reported = white_noise(likelihood, retuned_of(likelihood)[0])[0]
    assert np.all(reported[2:] < 0.005 * case.nominal.friction.forward.static)


@pytest.mark.parametrize(('seed', 'population'), [(0, 'noise_3'), (4, 'noise_6')])
def test_white_torque_noise_is_measured_once(seed, population):
    """To a quarter of its size; with it null simulations are as loud as the recording."""
    case = make_case('clean', seed, population=population, duration=SHORT)
    likelihood = likelihood_of(case)
    reported = white_noise(likelihood, retuned_of(likelihood)[0])
    np.testing.assert_allclose(reported[0, 2:], case.truth.torque_noise, rtol=0.25)
    noisy = likelihood.with_noise(reported)
    model, _ = retuned_of(noisy)
    assert np.mean(model.whitened ** 2) == pytest.approx(np.mean(noisy.clean ** 2), rel=0.3)
    reported = white_noise(noisy, model)[0, 2:]
    np.testing.assert_allclose(reported, case.truth.torque_noise, rtol=0.25)


def test_a_robot_with_noisy_drives_lacks_nothing():
    case = make_case('clean', 4, population='noise_6', duration=SHORT)
    result = find_discrepancy([case.recording], case.nominal, SearchOptions(most=2))
    assert (result.verdict, result.named) == (COMPLETE, ()), result.words
    reported = {one.joint: one for one in result.data.noise if one.equation == 'motor'}
    assert set(reported) == set(case.nominal.joints)
    assert 'Torque noise of the recording' in result.words
    assert {one.colour for one in reported.values()} == {'white'}
    np.testing.assert_allclose([reported[joint].per_sample for joint in case.nominal.joints],
                               case.truth.torque_noise, rtol=0.25)


def test_an_effect_is_named_beside_noise():
    case = make_case('single', 3, effect='backlash', population='noise_6', duration=SHORT)
    result = find_discrepancy([case.recording], case.nominal, SearchOptions(most=2))
    true, = case.truth.effects
    first = result.named[0]
    assert first.key == true.key
    assert first.values[0].value == pytest.approx(true.values[0], rel=0.15)
    # what it explains of data held out [N m], joint by joint, against what matters in practice
    explained = np.sqrt(np.maximum(result.gap.retuned ** 2 - result.gap.after ** 2, 0.0))
    friction = case.nominal.friction.forward.coulomb
    assert result.verdict == FOUND or np.all(explained < PRACTICAL * friction), result.words


def test_two_gains_that_make_torques_small_gain_nothing():
    """Half the torque constant, and inertia with it, would halve whatever noise leaves."""
    case = make_case('clean', 2, population='noise_6', duration=SHORT)
    likelihood = likelihood_of(case)
    zero, n = np.zeros(len(likelihood.nuisances)), likelihood.robot.n_joints
    weak = replace(likelihood.robot, effects=tuple(effect_on(joint, 'torque_gain', -0.5)
                                                   for joint in likelihood.robot.joints))
    left = unexplained(likelihood.motions[0], likelihood.constants(weak, zero))
    left[:, n:] /= 0.5  # of the motors, which the drives turn
    np.testing.assert_allclose(likelihood.fitted(weak, zero).whitened,
                               likelihood.whitener.whiten([left]) - likelihood.usual, atol=1e-9)


def test_what_coarse_encoders_misread_is_no_function_of_rate_or_torsion():
    """A misread rate is in friction, and so in what is left: at 4096 counts like a rate's work."""
    case = make_case('clean', 1333, population='encoders_coarse', duration=SHORT)
    likelihood = likelihood_of(case)
    functions = FreeFunctions(likelihood)
    free = [one for one in functions.ranked(*retuned_of(likelihood))
            if one.variable in ('link rate', 'torsion')]
    plausible = functions.ranked(*retuned_of(likelihood, PLAUSIBLE))  # nor anything else
    for best in (free[0], plausible[0]):
        assert best.evidence < 0.0, best[:5]


def test_friction_that_changes_with_the_angle_is_a_function_of_it_times_friction(robot, gains):
    """Torque that has one size at all speeds, and none at rest, is another."""
    hidden = affected(robot, 'joint2', 'position_friction', 0.35, 3.0, 0.0)
    likelihood = Likelihood([driven_motion(hidden, gains, seed=1, duration=24.0)], robot)
    free = FreeFunctions(likelihood).ranked(*retuned_of(likelihood, PLAUSIBLE))
    found = {one.variable: one.evidence for one in free if (one.joint, one.equation) == (
        'joint2', 'link')}
    assert found['link angle times friction'] > EVIDENCE
    assert found['link angle'] < 0.0


def test_a_function_of_torsion_is_a_springs_which_acts_on_link_and_motor(robot, gains):
    """So it shows another stiffness, which a function in either equation alone does not."""
    stiff = affected(robot, 'joint2', 'stiffness_error', 0.3)
    likelihood = Likelihood([driven_motion(stiff, gains, seed=1, duration=12.0)], robot)
    believed, columns = retuned_of(likelihood)
    best = FreeFunctions(likelihood).ranked(believed, columns)[0]
    assert (best.joint, best.variable) == ('joint2', 'torsion')
    assert best.evidence > EVIDENCE
