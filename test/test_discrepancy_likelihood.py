# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How likely recordings are: closed forms of the misfit, and what encoder noise adds to it."""

from dataclasses import replace
from types import SimpleNamespace

from bench.hidden_robots.cases import make_case
from core_runs import affected, effect_on
from discrepancy_runs import as_believed, driven_motion, likelihood_of
from gms_flex_control.discrepancy.fitting import fit, normal_equations
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.null_simulation import is_followed, null_readings
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.params.robot import with_effects
from gms_flex_control.simulation import plant
import numpy as np
import pytest


@pytest.fixture(scope='module')
def likelihood(robot, gains):
    """Return the Likelihood of a clean run through encoders."""
    return Likelihood([driven_motion(robot, gains, seed=1)], robot)


@pytest.fixture(scope='module')
def coarse(robot, gains):
    """Return the Likelihood of a robot as believed, read through 8192 counts."""
    read = replace(robot, encoder=replace(robot.encoder, counts=8192.0))
    return Likelihood([driven_motion(read, gains)], robot)


GROUPS = np.repeat(np.arange(3), [50, 80, 100])


def grouped():
    """Return what the misfit needs of a Likelihood: three groups of rows."""
    given = SimpleNamespace(groups=SimpleNamespace(
        group=GROUPS, count=np.bincount(GROUPS).astype(float)))
    given.noise_levels = lambda sums: Likelihood.noise_levels(given, sums)
    return given


def test_the_misfit_is_twice_the_log_likelihood_of_normal_rows():
    """
    Of rows with a standard deviation s: sum(y^2 / s^2 + log s^2), s^2 = mean(y^2) or 1 if less.

    Less is none: nothing is quieter than null simulations.
    """
    rng, given = np.random.default_rng(0), grouped()
    rows = rng.standard_normal(len(GROUPS)) * np.array([0.5, 2.0, 7.0])[GROUPS]
    sums = np.bincount(GROUPS, rows ** 2)
    expected = sum(np.sum(rows[GROUPS == g] ** 2 / s2 + np.log(s2)) for g, s2 in enumerate(
        np.maximum(sums / given.groups.count, 1.0)))
    assert Likelihood.misfit(given, sums) == pytest.approx(expected, rel=1e-12)
    several = Likelihood.misfit(given, np.stack([sums, 2.0 * sums]))
    assert several[0] == pytest.approx(expected) and several[1] > several[0]


@pytest.mark.parametrize('levels', [(0.3, 0.9, 0.99), (1.5, 0.5, 30.0), (1e-3, 1e3, 2.0)])
def test_weights_are_the_derivative_of_the_misfit_by_squares(levels):
    given = grouped()
    sums = np.array(levels) * given.groups.count
    weights = Likelihood.weights(given, sums)
    for g in range(3):
        step = 1e-5 * given.groups.count * max(levels[g], 0.1) * (np.arange(3) == g)
        slope = (Likelihood.misfit(given, sums + step) - Likelihood.misfit(given, sums - step)
                 ) / (2.0 * step[g])
        np.testing.assert_allclose(weights[g == GROUPS], slope, rtol=1e-5)


def test_fresh_clean_runs_have_unit_variance(likelihood, robot):
    """Of another seed than those the measure was taken from; so is the recording itself."""
    zero = np.zeros(len(likelihood.nuisances))
    constants, whitening = likelihood.constants(robot, zero), likelihood.whitenings[0]
    fresh = null_readings(likelihood.motions[0], constants)(np.random.default_rng([0, 99]))
    level = np.mean(likelihood.clean ** 2)  # the floor is white noise that is not in them
    for motion in (fresh, likelihood.motions[0]):
        rows = whitening.whiten(unexplained(motion, constants))
        rows = rows[np.any(rows, axis=1)]
        assert 0.6 < rows.var() / level < 1.6
    assert 0.2 < level < 1.3


def test_priors_pull_known_parameters_by_their_standard_deviation(likelihood):
    """A move by two standard deviations costs four, beside what the rows say of it."""
    model = as_believed(likelihood)
    for i in (0, 3):
        x = 2.0 * likelihood.sd * (np.arange(len(likelihood.sd)) == i)
        sums = likelihood.sums(model.whitened, model.robot, x)
        assert sums.cost - likelihood.misfit(sums.groups) == pytest.approx(4.0)
    wide = likelihood_of(make_case('clean', 3, duration=3.0), 3.0)
    usual = likelihood_of(make_case('clean', 3, duration=3.0))
    np.testing.assert_allclose(wide.sd, 3.0 * usual.sd)


def test_slopes_are_the_derivative_of_the_cost():
    """Finite differences of the cost against rows, weights, and what encoder noise adds."""
    likelihood = likelihood_of(make_case('clean', 3, population='encoders_fine', duration=6.0))
    x = 0.5 * likelihood.sd * np.random.default_rng(2).uniform(-1.0, 1.0, len(likelihood.sd))
    model = likelihood.fitted(likelihood.robot, x)
    columns = likelihood.jacobian(model)
    (slopes, *_), = normal_equations(likelihood, model, columns, (), [slice(None)])
    slopes -= x / likelihood.sd ** 2
    reported = []
    for i in range(len(x)):
        step = 0.02 * likelihood.sd[i] * (np.arange(len(x)) == i)
        ends = [likelihood.fitted(model.robot, x + sign * step).cost for sign in (1.0, -1.0)]
        reported.append((ends[1] - ends[0]) / (4.0 * step[i]))  # downhill, of half the cost
    reported, size = np.array(reported) * likelihood.sd, slopes * likelihood.sd
    np.testing.assert_allclose(size, reported, atol=0.05 * np.abs(reported).max() + 0.05)


@pytest.mark.parametrize(('name', 'nuisance'), [
    ('motor_inertia_error', 'motor_inertia'), ('stiffness_error', 'stiffness')])
def test_the_same_robot_costs_the_same_however_it_is_said(robot, coarse, name, nuisance):
    """An error of a parameter that its nuisance makes good leaves robot and cost as they are."""
    likelihood, ratio = coarse, -0.04
    index = [one.name for one in likelihood.nuisances].index(nuisance)
    x = np.zeros(len(likelihood.nuisances))
    plain = likelihood.fitted(robot, x)
    spec = effect_on(robot.joints[likelihood.nuisances[index].joint], name, ratio)
    likelihood.encoder_noise.learn(likelihood, replace(spec, values=(0.1,)), [(0, (0.1,))])
    same = with_effects(robot, spec)
    x[index] = 1.0 / (1.0 + ratio) - 1.0
    other = likelihood.fitted(same, x)
    np.testing.assert_allclose(other.whitened, plain.whitened, atol=1e-6)
    misfits = [likelihood.misfit(one.sums.groups) for one in (plain, other)]
    weight = likelihood.weights(plain.sums.groups)  # what noise adds by it, not made good
    noise = abs(2.0 * likelihood.noise_slopes(plain, weight)[index] * x[index])
    assert noise > 1.0
    assert misfits[1] == pytest.approx(misfits[0], abs=0.1 * noise)


def test_noise_is_foreseen_of_a_robot_without_what_null_simulations_have(robot, coarse):
    """A ratio of a ratio is no sum: an effect that is there is moved, not put in twice."""
    spec = effect_on(robot.joints[0], 'link_inertia_error', 0.4)
    x = np.zeros(len(coarse.nuisances))
    heavy = coarse.simulated_as(coarse.fitted(with_effects(robot, spec), x))
    heavy.encoder_noise.learn(heavy, replace(spec, values=(0.1,)), [(0, (0.1,))])
    foreseen, exact = heavy.encoder_noise.along(robot, x), np.subtract(*heavy.of_pair(robot, x))
    assert np.std(foreseen - exact) < 0.01 * np.std(exact - heavy.encoder_noise.own)


def test_a_payload_and_the_inertia_of_links_add_up_in_rows_and_noise(robot, coarse):
    """Three numbers determine what both links weigh, whatever payload and beliefs add up to."""
    likelihood, spec = coarse, effect_on('arm', 'tip_payload', 0.1)
    likelihood.encoder_noise.learn(likelihood, spec, [(0, (0.1,))])
    heavy = with_effects(robot, replace(spec, values=(0.3,)))
    bodies, carried = (plant.constants_of(one).chain.coupling for one in (robot, heavy))
    added = carried / bodies - 1.0
    x = np.array([{('inertia', 0): added[0, 0], ('inertia', 1): added[1, 1],
                   ('inertia', -1): added[0, 1]}.get((one.name, one.joint), 0.0)
                  for one in likelihood.nuisances])
    half = likelihood.fitted(with_effects(robot, replace(spec, values=(0.15,))), 0.5 * x)
    for model in (likelihood.fitted(robot, x), likelihood.fitted(heavy, 0.0 * x)):
        np.testing.assert_allclose(model.whitened, half.whitened, atol=1e-6)
        np.testing.assert_allclose(model.sums.groups, half.sums.groups, rtol=1e-6)


def test_a_fit_ends_with_what_encoder_noise_truly_adds(robot, gains):
    """Blocks that give way are not linear in how soft they are; the cost is that of evidence."""
    coarse = replace(robot, encoder=replace(robot.encoder, counts=8192.0))
    soft = effect_on(robot.joints[1], 'presliding_error', -0.5)
    likelihood = Likelihood([driven_motion(with_effects(coarse, soft), gains)], robot)
    probe = (-0.1,)
    likelihood.encoder_noise.learn(likelihood, replace(soft, values=probe), [(0, probe)])
    x = np.zeros(len(likelihood.nuisances))
    begin = likelihood.fitted(with_effects(robot, replace(soft, values=(-0.7,))), x)
    columns = likelihood.jacobian(likelihood.fitted(robot, x))
    found = fit(likelihood, begin.robot, x, columns)
    exact = likelihood.exact(begin)
    assert abs(exact.cost - begin.cost) > 10.0
    assert found.cost == likelihood.exact(found).cost < exact.cost
    near = replace(soft, values=(found.robot.effects[0].values[0] + 1e-6,))
    other = likelihood.fitted(with_effects(robot, near), found.x)
    assert other.cost == pytest.approx(found.cost, abs=1.0)


def test_what_sticks_is_measured_by_the_noise_of_what_sticks():
    """A motor that holds by dry friction creeps unseen: the true model misses torque there."""
    case = make_case('single', 45, duration=20.0)
    likelihood = likelihood_of(case)
    true = as_believed(likelihood, case.truth.robot)
    settled = likelihood.simulated_as(true)
    again = settled.fitted(true.robot, true.x)
    levels = [np.mean(model.whitened ** 2) / np.mean(one.clean ** 2)
              for one, model in ((likelihood, true), (settled, again))]
    assert levels[0] > 5.0 and levels[1] < 1.5


def test_a_simulation_that_goes_its_own_way_is_no_null_simulation(likelihood, robot):
    """A drive that lags far behind the hold on the motion swings about it, ever wider."""
    late = affected(robot, 'joint1', 'actuator_lag', 0.05)
    assert is_followed(likelihood, as_believed(likelihood))
    assert not is_followed(likelihood, as_believed(likelihood, late))
