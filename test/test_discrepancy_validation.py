# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What data held out say of effects: whether they help, how much, and what is but chance."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

from bench.hidden_robots.cases import make_case
from core_runs import affected, effect_on
from discrepancy_runs import as_believed, driven_motion, likelihood_of, retuned_of
from gms_flex_control.data.signal_analysis import FOLDS
from gms_flex_control.discrepancy import findings, validation, worth
from gms_flex_control.discrepancy.evidence import State
from gms_flex_control.discrepancy.fitting import extended, fit, foreseen
from gms_flex_control.discrepancy.gap import Errors, free_rms, free_runs, HeldOut, torque_rms
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.discrepancy.validation import Gain, gain_of, innovation_cost
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.params.arm import at_last_link, Body, carrying
from gms_flex_control.params.robot import with_effects
from gms_flex_control.simulation import plant
import numpy as np
import pytest


@pytest.fixture(scope='module')
def case():
    """Return a robot whose spring is a quarter off, driven for 20 s."""
    return make_case('single', 4, effect='stiffness_error', duration=20.0)


@pytest.fixture(scope='module')
def likelihood(case):
    """Return its Likelihood, as believed."""
    return likelihood_of(case)


@pytest.fixture(scope='module')
def clean():
    """Return the Likelihood of a robot that is nearly as believed."""
    return likelihood_of(make_case('clean', 5, duration=20.0))


def test_noise_of_encoders_costs_a_model_no_held_out_likelihood():
    rng, rows = np.random.default_rng(3), 200_000
    every, drawn = np.ones(rows, dtype=bool), 0.3 * rng.standard_normal((3, rows))
    one_block = SimpleNamespace(groups=SimpleNamespace(block=np.zeros(rows, dtype=int), blocks=1))
    quiet = rng.standard_normal(rows)
    best, raw, cleared = (float(validation.of_blocks(one_block, every, *given)[0]) for given in (
        (quiet, 1.0), (quiet + drawn[0], 1.0),
        (quiet + drawn[0], 1.0, 0.5 * (drawn[1] - drawn[2]) ** 2)))
    assert abs(cleared - best) < 0.05 * (best - raw)


def gain_with(likelihood, spec):
    """Return the Gain of an effect, fitted from a size, over the model without it."""
    without, own = retuned_of(likelihood, PLAUSIBLE)
    other = fit(likelihood, with_effects(likelihood.robot, spec), without.x, own,
                plausible=PLAUSIBLE)
    return gain_of(likelihood, (other, extended(likelihood, other, own, 0)), (without, own),
                   other.whitened - without.whitened)


def test_the_true_effect_gains_on_every_part_of_the_recording(case, likelihood):
    true, = case.truth.effects
    gain = gain_with(likelihood, replace(true, values=(0.5 * true.values[0],)))
    assert gain.is_real() and gain.nats > 1000.0 and gain.sigmas > 5.0
    assert gain.blocks == likelihood.groups.blocks


def test_prediction_one_sample_ahead_is_no_better_with_less_torque_of_everything(robot, gains):
    """Residual torques are less then; errors of readings are not."""
    likelihood = Likelihood([driven_motion(robot, gains, seed=1, duration=10.0)], robot)
    x = np.array([-0.3 * (one.name in ('inertia', 'motor_inertia', 'stiffness', 'static', 'level',
                                       'viscous')) for one in likelihood.nuisances])
    less = robot
    for joint in robot.joints:
        less = affected(less, joint, 'torque_gain', -0.3)
    own, other = validation.prediction_cost(likelihood, [(robot, 0.0 * x), (less, x)])
    assert own < other


def test_the_cost_of_prediction_is_that_of_least_squares_on_earlier_errors():
    """Gaps in the recording left out, earlier errors of both channels written out."""
    rng, memory = np.random.default_rng(5), validation.memory_of(0.01)
    errors = np.cumsum(rng.standard_normal((600, 2)), axis=0) @ [[1.0, 0.3], [0.0, 1.0]]
    usable = np.ones(600, dtype=bool)
    usable[[0, 1, 200, 377]] = False
    rows = np.array([r for r in range(memory, 600) if usable[r - memory:r + 1].all()])
    before = np.hstack([errors[rows - k] for k in range(1, memory + 1)])
    left = errors[rows] - before @ np.linalg.lstsq(before, errors[rows], rcond=None)[0]
    assert innovation_cost(errors, usable, 0.01) == pytest.approx(
        len(rows) * np.log(np.linalg.det(np.cov(left.T, bias=True)
                                         + np.outer(left.mean(0), left.mean(0)))), rel=1e-6)


def test_a_joint_is_predicted_from_earlier_errors_of_the_joints_that_move_it():
    """Known covariance of what is new: the second channel is 3 times the first's last value."""
    new = np.random.default_rng(6).standard_normal((20000, 2)) * [1.0, 0.1]
    errors = new + np.outer(np.roll(3.0 * new[:, 0], 1), [0.0, 1.0])
    cost = innovation_cost(errors[1:], np.ones(19999, dtype=bool), 0.01)
    assert cost / 19999 == pytest.approx(2.0 * np.log(0.1), abs=0.03)


@pytest.mark.parametrize(('name', 'values'), [
    ('torque_ripple', (1e-4, 17.0, 0.3)), ('friction_asymmetry', (0.01,)),
    ('motor_viscous', (1e-4,)), ('spring_cubic', (0.1,))])
def test_an_effect_that_is_not_there_gains_nothing(clean, name, values):
    """Of a clean robot: whatever it is fitted to in some blocks of time is not in the others."""
    gain = gain_with(clean, effect_on('joint1', name, *values))
    assert not gain.is_real() and gain.nats < 6.0


def test_a_model_gains_nothing_over_itself():
    """Where known parameters are at the end of what is plausible, or beyond, as well."""
    likelihood = likelihood_of(make_case('clean', 4, population='gaussian_beliefs', duration=20.0))
    state = retuned_of(likelihood, PLAUSIBLE)
    gain = gain_of(likelihood, state, state, np.ones(len(likelihood.groups.group)))
    assert abs(gain.nats) < 1.0 and not gain.is_real()


def test_a_fold_is_predicted_by_a_fit_that_saw_nothing_of_it(ideal_robot, gains):
    """
    By the same step, beyond that of all data, as where its residuals and derivatives are nothing.

    Encoders are ideal: what filters err by is all that differs between null simulations.
    """
    likelihood = Likelihood([driven_motion(ideal_robot, gains, duration=8.0)], ideal_robot)
    model, columns = as_believed(likelihood), retuned_of(likelihood)[1]
    whole, _ = foreseen(likelihood, model, columns, columns[:0], (), np.inf)
    for left_out, step in validation.steps(likelihood, model, columns):
        blind = replace(model, whitened=model.whitened * ~left_out)
        alone, _ = foreseen(likelihood, blind, columns * ~left_out, columns[:0], (), np.inf)
        np.testing.assert_allclose(step, alone - whole, rtol=0, atol=1e-4 * np.abs(alone).max())


def test_a_step_that_all_data_promise_alike_is_not_taken(ideal_robot, gains):
    """It is one that the fit has not taken, as nothing gets better where that is not linear."""
    likelihood = Likelihood([driven_motion(ideal_robot, gains, duration=8.0)], ideal_robot)
    model, columns = retuned_of(likelihood)
    best = int(np.argmax(np.sum((columns * likelihood.sd[:, None]) ** 2, axis=1)))
    promised = 0.5 * likelihood.sd[best]
    short = replace(model, whitened=model.whitened - promised * columns[best])
    for (_, step), (_, own) in zip(*(validation.steps(likelihood, one, columns)
                                     for one in (short, model)), strict=True):
        assert abs(step[best] - own[best]) < 0.05 * promised


@pytest.mark.parametrize(('gain', 'expected'), [
    (Gain(50.0, 5.0, 10), True), (Gain(50.0, 1.0, 10), False), (Gain(3.0, 5.0, 10), False),
    (Gain(50.0, 0.5, 2), True), (Gain(-50.0, -5.0, 10), False)])
def test_a_gain_is_real_that_is_large_and_not_of_one_block(gain, expected):
    """Of an effect that acts in few blocks no standard error is known."""
    assert gain.is_real() is expected


@pytest.mark.parametrize('true, least, most', [(1.0, 0.95, 1.0), (0.0, 0.0, 1.0 / 40.0)])
def test_what_acts_unevenly_is_as_real_as_what_acts_evenly(true, least, most):
    """Blocks in closed form: of x of unit variance about ``true`` times a size, that of a fit."""
    size = np.array([3.0, 3.0, 10.0, 3.0, 4.0, 3.0, 4.0, 4.0, 4.0, 3.0])
    x = np.random.default_rng(0).standard_normal((2000, len(size))) + true * size
    for fitted in ([size] if true else [size, 0.1 * size]):
        gains = x * fitted - 0.5 * fitted ** 2  # log likelihood ratio of means fitted and 0
        assert least <= np.mean([validation.gain_over(one).is_real() for one in gains]) <= most


def test_a_perfect_model_is_at_its_floor(case):
    """Torque and free runs of the true robot, against those of its null simulations."""
    likelihood = Likelihood([motion_of(case.recording, case.truth.robot)], case.truth.robot)
    model, columns = retuned_of(likelihood, 0.0)
    gap = HeldOut(likelihood).gap(*(2 * [State(model, columns, columns[:0], 0.0)]))
    np.testing.assert_allclose(torque_rms(likelihood, model), gap.floor, rtol=0.3)
    np.testing.assert_allclose(free_rms(likelihood, model), gap.free_floor, rtol=0.5)
    np.testing.assert_allclose(gap.before, gap.floor, rtol=0.3)


def test_a_model_whose_error_is_no_number_is_never_better(likelihood, monkeypatch):
    errors = {'good': np.ones(2), 'bad': np.array([np.nan, 0.1])}
    held_out, none = HeldOut(likelihood), np.full(2, np.nan)  # without free runs
    monkeypatch.setattr(held_out, 'errors',
                        lambda name: Errors(errors[name], errors[name], none, 0.0))
    assert held_out.worsens('bad', 'good') and not held_out.worsens('good', 'bad')
    assert not held_out.worsens('good', 'good')


def test_a_wrong_model_is_far_above_its_floor(case, likelihood):
    believed, j = as_believed(likelihood), case.nominal.joints.index(case.truth.effects[0].joint)
    true = likelihood.fitted(replace(case.nominal, effects=case.truth.effects), believed.x)
    assert torque_rms(likelihood, believed)[j] > 10.0 * torque_rms(likelihood, true)[j]
    assert free_rms(likelihood, believed)[j] > 10.0 * free_rms(likelihood, true)[j]


def test_free_runs_carry_the_load_of_their_recording(ideal_robot, gains):
    """As those of an arm whose last link is so much heavier."""
    load = Body(mass=0.4, com=np.array([0.05, 0.0, 0.0]), inertia=1e-3 * np.eye(3))
    heavy = replace(ideal_robot, arm=carrying(ideal_robot.arm, load))
    motion = driven_motion(heavy, gains, duration=10.0)
    expected = free_runs(motion, plant.constants_of(heavy))[1]
    loaded = replace(motion, samples=replace(
        motion.samples, load=at_last_link(load, ideal_robot.arm)))
    found = free_runs(loaded, plant.constants_of(ideal_robot))[1]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    left_behind = free_runs(motion, plant.constants_of(ideal_robot))[1]
    assert np.sqrt(np.mean(left_behind ** 2)) > 10.0 * np.sqrt(np.mean(found ** 2))


@pytest.mark.parametrize('name, values', [('input_delay', (0.01,)), ('actuator_lag', (0.01,))])
def test_a_free_run_remembers_what_went_before_it(name, values, ideal_robot, gains):
    """Torques on their way as a run begins are those asked for before, whichever run is first."""
    late = affected(ideal_robot, ideal_robot.joints[0], name, *values)
    motion, starts = driven_motion(late, gains, duration=6.0), np.array([1000, 2100])
    errors = [np.sqrt(np.mean(np.square(free_runs(motion, plant.constants_of(robot), starts)[1:]),
                              axis=(0, 2, 3))) for robot in (ideal_robot, late)]
    assert np.all(errors[1] < 0.1 * errors[0])


def test_free_runs_do_not_cross_holes():
    """A line through half a second that nobody saw is no motion."""
    case = make_case('clean', 3, duration=20.0)
    recording = case.recording
    hole = (recording.time > 6.6) & (recording.time < 7.1)
    with_hole = replace(recording, **{
        name: np.where(hole[:, None], np.nan, getattr(recording, name))
        for name in ('q_link', 'q_motor', 'dq_link', 'dq_motor')})
    errors = []
    for one in (recording, with_hole):
        likelihood = Likelihood([motion_of(one, case.nominal)], case.nominal)
        errors.append(free_rms(likelihood, as_believed(likelihood)))
    assert np.all(errors[1] < 1.5 * errors[0])
    nothing, motion = copy(likelihood), likelihood.motions[0]
    nothing.motions = (replace(motion, known=np.zeros_like(motion.known)),)
    assert np.all(np.isnan(free_rms(nothing, as_believed(likelihood))))


@pytest.mark.parametrize('durations', [(2.2,), (6.0, 6.0, 6.0)])
def test_all_of_every_recording_is_left_out_once_and_never_all_at_a_time(durations):
    cases = [make_case('clean', 3, duration=duration) for duration in durations]
    motions = [motion_of(case.recording, case.nominal) for case in cases]
    likelihood = Likelihood(motions, cases[0].nominal)
    folds = [likelihood.groups.block % FOLDS == k
             for k in range(min(FOLDS, likelihood.groups.blocks))]
    assert len(folds) > 1 and np.all(np.sum(folds, axis=0) == 1)
    for fold in folds:
        assert 0 < fold.sum() <= 0.6 * len(fold)
    assert all(len(np.unique(block)) > 1 for block in likelihood.groups.block_at)


def test_a_stop_that_is_met_in_few_blocks_is_found():
    """It acts in some blocks only, each of which is left out once."""
    case = make_case('single', 32, effect='end_stop', duration=20.0)
    stop, = case.truth.effects
    result = find_discrepancy([case.recording], case.nominal)
    assert [one.effect for one in result.findings] == ['end_stop'], result.words
    joint = case.nominal.joints.index(stop.joint)
    assert result.gap.after[joint] < 0.5 * result.gap.retuned[joint]
    assert result.findings[0].held_out.blocks < result.behind.likelihood.groups.blocks


def test_a_stop_acts_in_few_blocks_and_a_spring_in_all(case, likelihood):
    highest = max(motion.states[:, 0, 0].max() for motion in likelihood.motions)
    (soft,), joint = case.truth.effects, case.nominal.joints[0]
    stop = effect_on(joint, 'end_stop', 0.98 * highest, 5.0)
    model = likelihood.fitted(with_effects(case.nominal, soft, stop), np.zeros(
        len(likelihood.nuisances)))
    assert worth.acts_widely(likelihood, model, 0)
    assert not worth.acts_widely(likelihood, model, 1)


@pytest.mark.parametrize(('order', 'is_alike'), [(8.0, True), (8.05, True), (14.0, False)])
def test_a_wave_of_another_order_acts_otherwise(case, likelihood, order, is_alike):
    ripple = effect_on(case.nominal.joints[0], 'torque_ripple', 0.05, order, 0.3)
    model = likelihood.fitted(with_effects(case.nominal, ripple), np.zeros(
        len(likelihood.nuisances)))
    values = [SimpleNamespace(value=value) for value in (0.05, 8.0, 0.3)]
    assert worth.acts_like(likelihood, model, 0, values) == is_alike


@pytest.mark.parametrize(('end', 'kept'), [(3.0, 'both'), (0.5, 'end')])
def test_an_effect_is_dropped_only_where_all_that_falls_with_it_is_no_loss(end, kept,
                                                                           monkeypatch):
    """Without the first the energy is half, until the second, which has stood beside it, falls."""
    energies = {'both': 1.0, 'without first': 0.5, 'without second': 2.0, 'end': end}
    effects = (SimpleNamespace(name='input_delay'), SimpleNamespace(name='torque_ripple'))

    def found(name):
        robot = SimpleNamespace(robot=SimpleNamespace(effects=effects))
        return SimpleNamespace(best=SimpleNamespace(name=name, model=robot), tried=())
    worths = [SimpleNamespace(index=k, rest=SimpleNamespace(name=f'without {word}'))
              for k, word in enumerate(('first', 'second'))]
    monkeypatch.setattr(findings.worth, 'dropped', lambda likelihood, found, index: index)
    monkeypatch.setattr(findings.worth, 'pruned', lambda likelihood, index: (found('end'), []))
    monkeypatch.setattr(findings.fitting, 'plausible_limit', lambda likelihood, model: None)
    monkeypatch.setattr(findings, 'limited', lambda likelihood, state, limit: state)
    left, _ = findings.predictive(None, found('both'), worths, SimpleNamespace(
        energy=lambda state: energies[state.name]))
    assert left.best.name == kept
