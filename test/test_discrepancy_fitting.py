# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Least squares within bounds; what a fit moves is what is written, and has its prior."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from core_runs import effect_on
from discrepancy_runs import likelihood_of
from gms_flex_control.discrepancy.dictionary import allowed
from gms_flex_control.discrepancy.fitting import is_at_limit, refitted, solve
from gms_flex_control.discrepancy.nuisance import nuisances_of, tuned, with_nuisances
from gms_flex_control.effects.base import linear
from gms_flex_control.effects.registry import bounds_of
from gms_flex_control.params.robot import with_effects
from gms_flex_control.simulation import plant
import numpy as np
import pytest
from scipy.optimize import lsq_linear


def test_bounded_least_squares_agrees_with_scipy():
    """Random problems, most with bounds that hold; also columns of very different size."""
    rng = np.random.default_rng(4)
    met = 0
    for _ in range(40):
        size = int(rng.integers(1, 12))
        a = rng.standard_normal((30, size)) * 10.0 ** rng.uniform(-2, 2, size)
        b = rng.standard_normal(30)
        free = np.linalg.lstsq(a, b, rcond=None)[0]
        width = np.abs(free) * rng.uniform(0.3, 3.0, size) + 1e-6
        low, high = -width * rng.uniform(0.0, 1.0, size), width
        x = solve(a.T @ a, a.T @ b, low, high)
        exact = lsq_linear(a, b, (low, high), method='bvls', tol=1e-14).x
        assert np.all((x >= low) & (x <= high))
        np.testing.assert_allclose(x, exact, atol=1e-4 * np.abs(exact).max(), rtol=1e-3)
        assert np.sum((a @ x - b) ** 2) <= np.sum((a @ exact - b) ** 2) + 1e-8
        met += int(np.any((exact <= low) | (exact >= high)))
    assert met > 20


def test_bounded_least_squares_lives_with_columns_that_are_alike():
    """The same column twice: the cost is that of one with the sum of both ranges."""
    rng = np.random.default_rng(5)
    a, b = rng.standard_normal((20, 1)), rng.standard_normal(20) * 5.0
    twice, bound = np.tile(a, 2), np.array([0.1, 0.1])
    x = solve(twice.T @ twice, twice.T @ b, -bound, bound)
    once = np.clip(a[:, 0] @ b / (a[:, 0] @ a[:, 0]), -0.2, 0.2)
    assert np.sum(x) == pytest.approx(once, abs=1e-9)


def test_a_payload_and_the_inertias_it_resembles_do_not_pull_against_each_other():
    """Fits that begin with a third of the true mass and with twice as much end at one."""
    case = make_case('single', 27, effect='tip_payload', duration=20.0)
    likelihood, (true,), ends = likelihood_of(case), case.truth.effects, []
    for factor in (1.0 / 3.0, 2.0):
        model = likelihood.fitted(with_effects(case.nominal, replace(
            true, values=(factor * true.values[0],))), np.zeros(len(likelihood.sd)))
        for _ in range(3):
            model, _ = refitted(likelihood, model.robot, model.x, likelihood.jacobian(model))
        ends.append(model)
    masses = [model.robot.effects[0].values[0] for model in ends]
    assert masses[1] == pytest.approx(masses[0], rel=0.05)
    assert masses[0] == pytest.approx(true.values[0], rel=0.2)
    assert ends[1].cost == pytest.approx(ends[0].cost, abs=2.0)


@pytest.mark.parametrize('factor', [0.5, 3.0])
def test_friction_by_load_turns_over_the_reach_that_is_there(factor):
    """A wrong reach leaves more than other friction does, which is then named beside it."""
    case = make_case('single', 1, population='encoders_fine', effect='load_friction',
                     duration=20.0)
    likelihood, (true,) = likelihood_of(case), case.truth.effects
    model = likelihood.fitted(with_effects(case.nominal, replace(
        true, values=(0.8 * true.values[0], factor * true.values[1]))),
        np.zeros(len(likelihood.sd)))
    for _ in range(2):
        model, _ = refitted(likelihood, model.robot, model.x, likelihood.jacobian(model))
    assert model.robot.effects[0].values == pytest.approx(true.values, rel=0.2)


def test_friction_that_pushes_is_not_looked_for(robot):
    """All viscous friction may be gone; what is said to be more is no slope but something else."""
    viscous = robot.friction.forward.viscous[0]
    lower, upper = bounds_of(effect_on('joint1', 'viscous_error', 0.0), robot)
    assert lower == [-max(viscous, robot.friction.backward.viscous[0])] and upper == [np.inf]
    size = 0.01
    guess = allowed(linear(size)[0], lower, upper)
    assert guess.values([-1e3])[0] == lower[0] == pytest.approx(guess.lowest * size)
    at = [effect_on('joint1', 'viscous_error', share * lower[0]) for share in (1.0, 0.9, -2.0)]
    assert [is_at_limit(spec, robot) for spec in at] == [False, False, False]


def test_a_value_where_the_catalogue_ends_is_none(robot):
    """A delay of 50 ms is the longest that is looked for; a share of 1 is all there is."""
    for name, values, expected in (
            ('input_delay', (0.05,), True), ('input_delay', (0.049,), False),
            ('encoder_skew', (-0.05,), True), ('encoder_skew', (0.0,), False),
            ('load_friction', (1.0, 1e-3), False), ('backlash', (0.0,), False)):
        spec = effect_on('joint1', name, *values)
        assert is_at_limit(spec, robot) == expected


def flat(record):
    """Return all numbers of a record by name."""
    numbers = {}
    for part in ('chain', 'friction'):
        entry = getattr(record, part)
        for name in entry.dtype.names:
            numbers[f'{part}.{name}'] = np.array(getattr(entry, name))
    return numbers


def assert_written_as_fitted(robot, nuisances, x):
    """Raise unless a robot that is written has the inertia and moments that were fitted."""
    own = plant.constants_of(replace(robot, effects=()))
    asked = flat(tuned(plant.constants_of(robot), nuisances, x, own))
    made = flat(plant.constants_of(with_nuisances(robot, nuisances, x)))
    for field in ('chain.coupling', 'chain.moment'):
        np.testing.assert_allclose(made[field], asked[field], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('arm', [{}, {'damping': [0.01, 0.02]}, {'gravity': [0.0, -9.0]},
                                 {'kind': 'decoupled', 'gravity': [0.0, -9.0]},
                                 {'kind': 'decoupled', 'stiffness': [np.inf, 5.0]},
                                 {'stiffness': [np.inf, np.inf], 'motor_inertia': [0.01, 0.3]}])
def test_a_robot_with_nuisances_is_the_record_with_nuisances(ideal_robot, arm):
    """And nuisances at zero are the robot as it was."""
    changed = replace(ideal_robot.arm, **arm)
    motors = [motor * (not rigid) for motor, rigid in zip(ideal_robot.motors, changed.rigid,
                                                          strict=True)]
    robot = replace(ideal_robot, arm=changed, motors=tuple(motors))
    base = plant.constants_of(robot)
    nuisances = nuisances_of(robot)
    sd, rng = np.array([nuisance.sd for nuisance in nuisances]), np.random.default_rng(0)
    for x in (np.zeros(len(sd)), sd * rng.uniform(-1.0, 1.0, len(sd))):
        asked = flat(tuned(base, nuisances, x))
        made = flat(plant.constants_of(with_nuisances(robot, nuisances, x)))
        used = [name for name in asked if arm.get('gravity') or name != 'chain.moment']
        for name in used:
            np.testing.assert_allclose(made[name], asked[name], rtol=1e-12, atol=1e-15,
                                       err_msg=name)
    for nuisance in nuisances:
        one = tuned(base, [nuisance], [0.01])
        changed = [name for name, value in flat(one).items()
                   if not np.array_equal(value, flat(base)[name])]
        assert changed and {name.split('.')[1] for name in changed} == {
            field for _, field, _ in nuisance.fields}


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
@pytest.mark.parametrize('mass', [[1.5, 1.0], [0.3, 2.0]])
@pytest.mark.parametrize('effect', [('tip_payload', '', (0.4,)),
                                    ('tip_payload', '', (1.5,)),
                                    ('link_inertia_error', 'joint1', (0.9,)),
                                    ('link_inertia_error', 'joint1', (3.0,)),
                                    ('link_inertia_error', 'joint2', (-0.5,))])
def test_nuisances_scale_a_link_beside_what_effects_add(ideal_robot, effect, kind, mass):
    """The fit moves the inertia of the link, not of its payload; so does the robot written."""
    name, joint, values = effect
    arm = replace(ideal_robot.arm, kind=kind, mass=mass, gravity=[0.0, -9.0])
    robot = replace(ideal_robot, arm=arm, effects=(effect_on(joint, name, *values),))
    nuisances = nuisances_of(robot)
    for seed in range(5):
        x = np.random.default_rng(seed).uniform(-0.04, 0.04, len(nuisances))
        assert_written_as_fitted(robot, nuisances, x)


@pytest.mark.parametrize('tilt', [0.0, 0.1])
def test_a_point_mass_and_a_known_tilt_are_written_as_they_are_fitted(ideal_robot, tilt):
    """Moments up and inertia down would ask for an inertia below zero about the centre of mass."""
    known = (effect_on('arm', 'gravity_tilt', tilt, -1.5),) if tilt else ()
    robot = replace(ideal_robot, effects=known, arm=replace(
        ideal_robot.arm, inertia=[0.0, 0.0], gravity=[0.0, -9.0 * (not tilt)]))
    nuisances = nuisances_of(robot)
    x = np.array([{'gravity': 0.03, 'inertia': -0.02}.get(nuisance.name, 0.0)
                  for nuisance in nuisances])
    assert_written_as_fitted(robot, nuisances, x)
