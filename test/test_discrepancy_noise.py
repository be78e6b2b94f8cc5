# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Torque noise of drives that nobody recorded: measured, and no effect."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from core_runs import affected, effect_on
from discrepancy_runs import driven_motion, likelihood_of, retuned_of
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.remainder import FreeFunctions
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.result import COMPLETE, FOUND
from gms_flex_control.discrepancy.thresholds import EVIDENCE, PRACTICAL
from gms_flex_control.discrepancy.torque_noise import white_noise
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
import numpy as np
import pytest

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
    free = FreeFunctions(likelihood).ranked(*retuned_of(likelihood))
    assert free[0].evidence < 0.0, free[0][:5]


def test_a_function_of_torsion_is_a_springs_which_acts_on_link_and_motor(robot, gains):
    """So it shows another stiffness, which a function in either equation alone does not."""
    stiff = affected(robot, 'joint2', 'stiffness_error', 0.3)
    likelihood = Likelihood([driven_motion(stiff, gains, seed=1, duration=12.0)], robot)
    believed, columns = retuned_of(likelihood)
    best = FreeFunctions(likelihood).ranked(believed, columns)[0]
    assert (best.joint, best.variable) == ('joint2', 'torsion')
    assert best.evidence > EVIDENCE
