# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The equations behind the search for what is missing, against closed forms and other solvers."""

from dataclasses import replace

from core_runs import single_axis
from gms_flex_control.discrepancy import equations, signature
from gms_flex_control.discrepancy.bounded import solve
from gms_flex_control.discrepancy.compatible import may_join
from gms_flex_control.discrepancy.fit import Fitted
from gms_flex_control.discrepancy.guesses import all_guesses, allowed, bounds_of, is_at_limit
from gms_flex_control.discrepancy.judge import is_sure, Judged, stands_alone
from gms_flex_control.discrepancy.known import DOUBT, knobs_of, tuned
from gms_flex_control.discrepancy.library import Library
from gms_flex_control.discrepancy.path import make_path, path_of, standing
from gms_flex_control.discrepancy.problem import Problem, REPLICATES, with_effect
from gms_flex_control.discrepancy.residuals import fresh_state, unexplained
from gms_flex_control.discrepancy.retrace import retrace
from gms_flex_control.discrepancy.retuned import with_knobs
from gms_flex_control.discrepancy.search import LEAST_GAIN
from gms_flex_control.discrepancy.units import torque_scale
from gms_flex_control.discrepancy.whitening import Whitening
from gms_flex_control.discrepancy.words import evidence_of
from gms_flex_control.dynamics import chain
from gms_flex_control.effects.guess import linear
from gms_flex_control.effects.registry import find
from gms_flex_control.hidden import motions, truth
from gms_flex_control.hidden.cases import make_case
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.friction import FrictionParams, StribeckParams
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.simulation import plant
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.optimize import lsq_linear

NONE = StribeckParams(static=[1e-14], coulomb=[1e-14], velocity=[1.0], viscous=[0.0])
FRICTIONLESS = FrictionParams(forward=NONE, backward=NONE, stiffness=[[1e-14]], weight=[[1.0]],
                              attraction=[1.0])


def driven_path(robot, gains, seed=0, duration=20.0):
    """Return the Path of a rich motion of a robot, by the integrator of hidden robots."""
    time = np.arange(round(duration / 2e-3)) * 2e-3
    reference = motions.draw_reference(np.random.default_rng(7), 'rich', 'soft', time)
    run = truth.simulate(robot, replace(robot, effects=()), gains, reference, seed=seed)
    return make_path(robot.joints, time, 2e-3, np.ascontiguousarray(run.measured[:, [0, 2]]),
                     run.command, np.zeros(len(time)), True, 'a hidden robot')


@pytest.mark.parametrize(('period', 'factor'), [(4e-3, 1), (2e-3, 2), (1e-3, 4)])
def test_a_held_torque_and_the_second_difference_of_the_angle_agree_exactly(period, factor):
    """Under torques held over samples a free axis moves on parabolas; nothing is left of them."""
    rng, inertia = np.random.default_rng(0), 0.02
    command = rng.standard_normal((2000, 1))
    rate = np.concatenate([[0.0], np.cumsum(command[:-1, 0])]) * period / inertia
    step = rate * period + 0.5 * command[:, 0] * period ** 2 / inertia
    angle = np.concatenate([[0.0], np.cumsum(step[:-1])])
    readings = np.repeat(angle[:, None, None], 2, axis=1)
    robot = single_axis(FRICTIONLESS, inertia)
    path = make_path(robot.joints, np.arange(2000) * period, period, readings, command,
                     np.zeros(2000), True, 'parabola')
    assert path.factor == factor
    left = unexplained(path, plant.constants_of(robot))[4:-4]
    np.testing.assert_allclose(left, 0.0, atol=1e-13 * np.ptp(angle) * inertia / period ** 2)
    assert np.abs(path.drive[4:-4]).max() > 0.5
    heavier = unexplained(path, plant.constants_of(single_axis(FRICTIONLESS, 1.5 * inertia)))
    np.testing.assert_allclose(heavier[4:-4, 0], 0.5 * path.drive[4:-4, 0], atol=1e-6)


@pytest.mark.parametrize('n', [1, 2, 3])
def test_the_rigid_body_along_a_path_is_that_of_inverse_dynamics(n):
    """Gravity, offsets and a rigid joint included."""
    rng = np.random.default_rng(n)
    mass, length, com, inertia = rng.uniform(0.2, 1.0, (4, n))
    arm = ArmParams(kind='planar', mass=mass, length=length, com=com, inertia=inertia,
                    motor_inertia=np.full(n, 0.1), stiffness=np.where(np.arange(n) == 0, np.inf,
                                                                      5.0),
                    damping=np.zeros(n), gravity=[1.0, -9.0], offset=rng.standard_normal(n))
    links, work = chain.constants_of(arm), plant.workspace(n).chain
    for q, dq, ddq in rng.standard_normal((5, 3, n)):
        bias, inertial = np.empty((2, n))
        equations.rigid_body(q, dq, ddq, links, work, bias, inertial)
        np.testing.assert_allclose(bias + inertial, chain.inverse_dynamics(q, dq, ddq, arm),
                                   rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(bias, chain.inverse_dynamics(q, dq, 0.0 * q, arm),
                                   rtol=1e-12, atol=1e-12)


def test_the_true_model_leaves_nothing_of_a_hidden_robot_but_its_encoders(ideal_robot, gains):
    """The finer integrator of hidden robots, ideal encoders: under 1 % of friction is left."""
    path = driven_path(ideal_robot, gains)
    left = unexplained(path, plant.constants_of(ideal_robot))[50:-50]
    static = np.tile(ideal_robot.friction.forward.static, 2)
    assert np.all(np.sqrt(np.mean(left ** 2, axis=0)) < 0.01 * static)
    wrong = replace(ideal_robot, effects=(EffectSpec(
        name='constant_link_torque', joint='joint2', values=(0.01,)),))
    more = unexplained(path, plant.constants_of(wrong))[50:-50]
    np.testing.assert_allclose(more - left, np.tile([0.0, -0.01, 0.0, 0.0], (len(left), 1)),
                               atol=1e-12)


def test_a_retraced_motion_belongs_to_its_model_whatever_the_recording_held(ideal_robot, gains):
    """
    The recording holds backlash and a tenth of friction as bias; the retraced one neither.

    Its motors stay within 20 mrad of the recording. Up to some 10 Hz, what the model leaves of
    it is a tenth of what it left before; above there is the encoders' noise.
    """
    effects = (EffectSpec(name='backlash', joint='joint1', values=(0.005,)),
               EffectSpec(name='motor_torque_bias', joint='joint2', values=(0.01,)))
    path = driven_path(replace(ideal_robot, effects=effects), gains)
    constants = plant.constants_of(ideal_robot)
    again = retrace(path, constants, np.random.default_rng(0))
    before, after = (np.sqrt(np.mean(uniform_filter1d(
        unexplained(one, constants)[50:-50], 10, axis=0) ** 2, axis=0)) for one in (path, again))
    assert before[0] > 3e-3 and before[3] > 9e-3
    assert np.all(after < 0.1 * before.max())
    assert np.abs(again.readings - path.readings)[:, 1].max() < 0.02
    assert np.ptp(path.readings[:, 1], axis=0).min() > 0.4


@pytest.mark.parametrize('inertia', [0.11, 0.01, 0.0])
def test_a_rigid_axis_is_held_on_its_path_wherever_its_inertia_stands(inertia):
    """Of link or rotor; friction is believed a fifth too small."""
    friction = StribeckParams(coulomb=[0.1], static=[0.1], velocity=[0.1], viscous=[0.0])
    friction = FrictionParams(forward=friction, backward=friction, stiffness=[[50.0]],
                              weight=[[1.0]], attraction=[50.0])
    robot = single_axis(friction, inertia, motor_inertia=0.11 - inertia)
    time = np.arange(2500) * 2e-3
    angle = 0.3 * np.sin(np.pi * time)
    command = 0.125 * np.sign(np.cos(np.pi * time)) - 0.11 * np.pi ** 2 * angle
    path = make_path(robot.joints, time, 2e-3, np.repeat(angle[:, None, None], 2, axis=1),
                     command[:, None], np.zeros(len(time)), True, 'sine')
    again = retrace(path, plant.constants_of(robot), np.random.default_rng(0))
    assert np.abs(again.readings - path.readings).max() < 1e-3


def test_a_rotor_couples_through_a_rigid_joint_in_the_plant_as_in_the_fit(ideal_robot, gains):
    arm = replace(ideal_robot.arm, stiffness=[ideal_robot.arm.stiffness[0], np.inf])
    robot = replace(ideal_robot, arm=arm, motors=(ideal_robot.motors[0], ''), effects=(EffectSpec(
        name='motor_inertia_coupling', joint='joint2', values=(0.005,)),))
    constants = plant.constants_of(robot)
    again = retrace(driven_path(ideal_robot, gains), constants, np.random.default_rng(0))
    with_it, without = (np.sqrt(np.mean(uniform_filter1d(
        unexplained(again, one)[50:-50, 0], 10) ** 2)) for one in (
            constants, plant.constants_of(replace(robot, effects=()))))
    assert with_it < 0.2 * without


def test_the_base_bends_under_the_torque_that_is_given(ideal_robot, gains):
    """Not under that which was asked for, where the model knows the difference."""
    both = tuple(EffectSpec(name=name, joint=joint, values=values) for name, joint, values in (
        ('base_flexibility', 'joint1', (6.0, 1.0, 0.05)), ('torque_gain', 'joint1', (0.25,))))
    left = []
    for effects in (both[:1], both):
        robot = replace(ideal_robot, effects=effects)
        path, constants = driven_path(robot, gains), plant.constants_of(robot)
        for one in (path, retrace(path, constants, np.random.default_rng(0))):
            left.append(np.sqrt(np.mean(uniform_filter1d(
                unexplained(one, constants)[50:-50, 0], 10) ** 2)))
    assert max(left) < 1.5 * left[0]


@pytest.mark.parametrize(('seed', 'gravity'), [(7, True), (10, True), (10, False)])
def test_a_retraced_motion_stands_where_the_recording_stood(seed, gravity):
    """
    Under a weight that makes it fall otherwise, and where a soft spring would let it creep.

    The residual of the recording is then what that of such a run is: as large, level for level.
    """
    case = make_case('clean', seed, gravity=gravity, duration=40.0)
    path, robot = path_of(case.recording, case.truth.robot), case.truth.robot
    again = retrace(path, plant.constants_of(case.nominal), np.random.default_rng(0))
    assert np.abs(again.motion - path.motion)[:, [0, 3]].max() < 0.02
    assert path.standing[path.time > 1.0].mean() > 0.01
    standing = path.standing & again.standing
    assert standing.sum() > 0.5 * path.standing.sum()
    alike = [Problem([path], robot, 0.005, seed) for seed in range(3)]
    level = np.mean([np.mean(one.rows(robot, np.zeros(len(one.knobs)))[one.fitted] ** 2)
                     for one in alike])
    assert level == pytest.approx(np.mean([one.level for one in alike]), rel=0.1)


@pytest.fixture(scope='module')
def problem(robot, gains):
    """Return the Problem of a clean run through encoders."""
    return Problem([driven_path(robot, gains, seed=1)], robot, 0.005)


def test_rows_of_even_noise_are_white_and_of_unit_variance():
    """Coloured noise that two equations share: rows of a run that was not measured are plain."""
    rng, period = np.random.default_rng(0), 4e-3
    white = rng.standard_normal((7, 10000, 2)) @ [[1.0, 0.8], [0.0, 0.5]]
    noise = white - 0.9 * np.roll(white, 1, axis=1)
    noise[..., 1] = uniform_filter1d(noise[..., 1], 5, axis=1)
    whitening = Whitening(noise[:6], period, np.zeros(2), np.ones(noise.shape[1:], dtype=bool))
    rows = whitening.rows_of(noise[6])
    rows = rows[np.any(rows, axis=1)]
    assert np.all(np.abs(rows.var(axis=0) - 1.0) < 0.15)
    allowed = 4.0 / np.sqrt(len(rows)) + 0.03
    for lag in (1, 2, 3, 10):
        assert np.all(np.abs(np.mean(rows[lag:] * rows[:-lag], axis=0)) < allowed)
    assert abs(np.mean(rows[:, 0] * rows[:, 1])) < allowed
    assert np.mean(np.abs(rows) > 1.96) == pytest.approx(0.05, abs=0.02)


def test_where_an_equation_tells_nothing_its_residual_counts_nothing():
    """A torque of a thousand times the noise while a link stands changes no row elsewhere."""
    noise = np.random.default_rng(2).standard_normal((7, 10000, 1))
    seen = np.ones((10000, 1), dtype=bool)
    seen[4000:6000] = False
    whitening = Whitening(noise[:6], 4e-3, np.zeros(1), seen)
    stuck = noise[6].copy()
    stuck[4000:6000] += 1000.0
    rows = whitening.rows_of(stuck)
    np.testing.assert_allclose(rows, whitening.rows_of(noise[6]), rtol=1e-9, atol=1e-9)
    inside = (whitening.row_time > 16.01) & (whitening.row_time < 23.99)
    told = rows[~inside & np.any(rows, axis=1)]
    assert not np.any(rows[inside]) and told.var() == pytest.approx(1.0, abs=0.2)


def test_slow_noise_of_rests_does_not_hide_what_is_slow_in_motion():
    """
    Torque as large as white noise, which at rest wanders slowly by twenty times as much.

    In motion alone its rows would have the squares of its samples; weighed by what noise is on
    average, a thousandth of them.
    """
    rng, period = np.random.default_rng(5), 4e-3
    noise = rng.standard_normal((7, 15000, 1))
    slow = uniform_filter1d(rng.standard_normal(noise.shape), 250, axis=1)
    resting = (np.arange(15000) % 3000 < 900)[:, None]
    noise += 20.0 * slow / slow.std() * uniform_filter1d(resting.astype(float), 100, axis=0)
    whitening = Whitening(noise[:6], period, np.zeros(1), np.ones(noise.shape[1:], dtype=bool))
    torque = np.sign(np.sin(2.0 * np.pi * 0.2 * period * np.arange(15000)))[:, None]
    assert np.sum(whitening.rows_of(torque) ** 2) > 0.1 * np.sum(torque[~resting] ** 2)
    rows = whitening.rows_of(noise[6])
    assert rows[np.any(rows, axis=1)].var() == pytest.approx(1.0, abs=0.25)


def test_a_link_stands_that_its_encoder_does_not_see_move():
    """Readings that go to and fro between two counts for longer than 0.2 s, and only these."""
    count, period = 1e-3, 2e-3
    time = np.arange(3000) * period
    angle = 1.0004 + 0.5 * (np.minimum(time - 2.0, 0.0) + np.maximum(time - 4.0, 0.0))
    angle += 0.3 * count * np.sin(40.0 * time)
    read = np.round(angle / count) * count
    still = standing(read[:, None], np.array([0.3 * count]), period)[:, 0]
    assert np.all(still[(time > 2.11) & (time < 3.89)])
    assert not np.any(still[(time < 1.99) | (time > 4.01)])


@pytest.mark.parametrize('lengths', [(6.0, 6.0, 6.0), (6.0,), (5.0, 5.0)])
def test_short_recordings_have_blocks_held_out_too(robot, gains, lengths):
    """Blocks are counted over all recordings, of which each may be too short for a fourth one."""
    problem = Problem([driven_path(robot, gains, seed=k, duration=length)
                       for k, length in enumerate(lengths)], robot, 0.005)
    assert problem.held_out.any() and problem.fitted.sum() > problem.held_out.sum()
    assert not np.any(problem.held_out & problem.fitted)


@pytest.mark.parametrize(('size', 'said'), [(0.0123, '12.3 mN m'), (4.2, '4.2 N m'),
                                            (4630.0, '4.63 kN m'), (np.nan, '- mN m')])
def test_torques_are_told_in_units_that_suit(size, said):
    scale = torque_scale([size, 0.001])
    assert f'{scale.told(size)} {scale.unit}' == said


def test_a_floor_makes_all_below_it_small():
    """Noise a tenth of the floor counts a hundredth; noise far above is hardly changed."""
    noise = np.random.default_rng(1).standard_normal((7, 10000, 1))
    share = 20.0 / 125.0  # of the power of white noise that lies below 20 Hz
    for floor, level in ((10.0, 0.01), (0.1, 1.0)):
        whitening = Whitening(noise[:6], 4e-3, np.array([floor * np.sqrt(share)]),
                              np.ones(noise.shape[1:], dtype=bool))
        whitening.scale[:] = 1.0
        assert whitening.rows_of(noise[6]).var() == pytest.approx(level, rel=0.1)


def test_fresh_clean_runs_have_unit_variance(problem, robot):
    """
    Of another seed than those the measure was taken from; so is the recording itself.

    Where every torque matters, however small: what does not counts as noise.
    """
    problem = Problem(problem.paths, robot, 1e-9)
    constants, whitening = plant.constants_of(robot), problem.whitenings[0]
    fresh = retrace(problem.paths[0], constants, np.random.default_rng([0, 99]))
    for path in (fresh, problem.paths[0]):
        rows = whitening.rows_of(unexplained(path, constants))
        rows = rows[np.any(rows, axis=1)]
        assert np.all((rows.var(axis=0) > 0.6) & (rows.var(axis=0) < 1.6))
        between = np.abs(np.corrcoef(rows.T) - np.eye(rows.shape[1]))
        assert between.max() < 0.35
    assert 0.6 < problem.level < 1.6  # it is of fresh runs as well
    measured_by = problem.clean[-REPLICATES:, problem.fitted]
    assert np.mean(measured_by ** 2) < problem.level


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


def flat(record):
    """Return all numbers of a record by name."""
    numbers = {}
    for part in ('chain', 'friction'):
        entry = getattr(record, part)
        for name in entry.dtype.names:
            numbers[f'{part}.{name}'] = np.array(getattr(entry, name))
    return numbers


@pytest.mark.parametrize('arm', [{}, {'damping': [0.01, 0.02]}, {'gravity': [0.0, -9.0]},
                                 {'kind': 'decoupled', 'gravity': [0.0, -9.0]},
                                 {'kind': 'decoupled', 'stiffness': [np.inf, 5.0]},
                                 {'stiffness': [np.inf, np.inf], 'motor_inertia': [0.01, 0.3]}])
def test_a_robot_of_knobs_is_the_record_of_knobs(ideal_robot, arm):
    """And knobs at zero are the robot as it was."""
    changed = replace(ideal_robot.arm, **arm)
    motors = [motor * (not rigid) for motor, rigid in zip(ideal_robot.motors, changed.rigid,
                                                          strict=True)]
    robot = replace(ideal_robot, arm=changed, motors=tuple(motors))
    base = plant.constants_of(robot)
    knobs = knobs_of(base, DOUBT)
    bound = np.array([knob.doubt for knob in knobs])
    for share in (np.zeros(len(knobs)), np.random.default_rng(0).uniform(-0.4, 0.4, len(knobs))):
        asked = flat(tuned(base, knobs, share * bound))
        made = flat(plant.constants_of(with_knobs(robot, knobs, share * bound)))
        used = [name for name in asked if arm.get('gravity') or name != 'chain.moment']
        for name in used:
            np.testing.assert_allclose(made[name], asked[name], rtol=1e-12, atol=1e-15,
                                       err_msg=name)
    for knob in knobs:
        one = tuned(base, [knob], [0.01])
        changed = [name for name, value in flat(one).items()
                   if not np.array_equal(value, flat(base)[name])]
        assert changed and {name.split('.')[1] for name in changed} == {
            field for _, field, _ in knob.fields}


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
@pytest.mark.parametrize('mass', [[1.5, 1.0], [0.3, 2.0]])
@pytest.mark.parametrize('effect', [('tip_payload', '', (0.4,)),
                                    ('tip_payload', '', (1.5,)),
                                    ('link_inertia_error', 'joint1', (0.9,)),
                                    ('link_inertia_error', 'joint1', (3.0,)),
                                    ('link_inertia_error', 'joint2', (-0.5,))])
def test_knobs_scale_what_a_link_carries_with_what_effects_add(ideal_robot, effect, kind, mass):
    """The fit moves the inertia of link and payload; so does the robot that is written."""
    name, joint, values = effect
    arm = replace(ideal_robot.arm, kind=kind, mass=mass, gravity=[0.0, -9.0])
    robot = replace(ideal_robot, arm=arm, effects=(
        EffectSpec(name=name, joint=joint, values=values),))
    base = plant.constants_of(robot)
    knobs = knobs_of(base, DOUBT)
    for seed in range(5):
        x = np.random.default_rng(seed).uniform(-0.04, 0.04, len(knobs))
        asked, made = flat(tuned(base, knobs, x)), flat(
            plant.constants_of(with_knobs(robot, knobs, x)))
        for field in ('chain.coupling', 'chain.moment'):
            np.testing.assert_allclose(made[field], asked[field], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('tilt', [0.0, 0.1])
def test_a_point_mass_and_a_known_tilt_are_written_as_they_are_fitted(ideal_robot, tilt):
    """Moments up and inertia down would ask for an inertia below zero about the centre of mass."""
    known = (EffectSpec(name='gravity_tilt', joint='arm', values=(tilt, -1.5)),) if tilt else ()
    robot = replace(ideal_robot, effects=known, arm=replace(
        ideal_robot.arm, inertia=[0.0, 0.0], gravity=[0.0, -9.0 * (not tilt)]))
    base = plant.constants_of(robot)
    knobs = knobs_of(base, DOUBT)
    x = np.array([{'gravity': 0.03, 'inertia': -0.02}.get(knob.name, 0.0) for knob in knobs])
    asked, made = flat(tuned(base, knobs, x)), flat(
        plant.constants_of(with_knobs(robot, knobs, x)))
    for field in ('chain.coupling', 'chain.moment'):
        np.testing.assert_allclose(made[field], asked[field], rtol=1e-9, atol=1e-15)


def test_an_effect_that_changes_nothing_that_is_fitted_is_none():
    """As one that acts in blocks alone that are held out; what rounding leaves is no loss."""
    idle = Judged(0, 0.0, 1e-9, 0.1, None, None)
    assert not stands_alone(idle) and not is_sure(idle) and idle.alone == idle.weight == 0.0
    assert '0 % of which' in evidence_of(None, idle, ())


def test_every_guess_is_an_effect_the_model_allows(problem):
    """
    Its probes and what they stand for are values within the bounds of its parameters.

    However large the coefficients are: a ratio of -1.2 of an inertia is no robot.
    """
    guesses = all_guesses(problem)
    places = {(name, joint) for name, joint, _ in guesses}
    assert ('gravity_tilt', 'arm') in places and ('backlash', 'joint2') in places
    assert 'backlash' not in {name for name, _, _ in all_guesses(problem, ('backlash',))}
    for name, joint, guess in guesses:
        kind = find(name)
        ends = [np.clip(np.full(len(guess.probes), c), guess.lowest, guess.highest)
                for c in (-40.0, 0.7, 40.0)]
        for values in (*guess.probes, *map(guess.values, ends)):
            given = dict(zip([p.name for p in kind.parameters], values, strict=True))
            assert kind.values(given, f'{joint}.{name}') == tuple(map(float, values))


def test_what_a_guess_stands_for_is_the_sum_of_its_probes(problem):
    """Columns times coefficients against the rows of the effect itself, for linear ones."""
    rows = problem.rows(problem.robot, np.zeros(len(problem.knobs)))

    def made(name, joint, values):
        spec = EffectSpec(name=name, joint=joint, values=tuple(map(float, values)))
        return problem.rows(replace(problem.robot, effects=(spec,)),
                            np.zeros(len(problem.knobs))) - rows
    linear = ('torque_ripple', 'position_friction', 'gravity_tilt', 'spring_cubic', 'torque_gain',
              'kinematic_error', 'friction_drift', 'viscous_error', 'motor_inertia_coupling')
    tried = set()
    for name, joint, guess in all_guesses(problem):
        if name not in linear or (name, joint) in tried:
            continue
        tried.add((name, joint))
        coefficients = np.array([0.6, -0.8])[:len(guess.probes)]
        whole = made(name, joint, guess.values(coefficients))
        parts = sum(c * made(name, joint, probe)
                    for c, probe in zip(coefficients, guess.probes, strict=True))
        scale = np.sqrt(np.mean(whole ** 2))
        assert np.sqrt(np.mean((whole - parts) ** 2)) < 0.01 * scale or scale == 0.0, name
    assert len(tried) == 2 * len(linear) - 1


def test_a_rigid_axis_has_guesses_of_what_can_be_there():
    """None of a spring or of a motor side, none of the whole arm."""
    class Given:
        robot = single_axis(replace(FRICTIONLESS), 0.02)
        time = np.arange(200) * 4e-3
        paths = (make_path(robot.joints, time, 4e-3, np.repeat(
            np.sin(time)[:, None, None], 2, axis=1), np.cos(time)[:, None], np.zeros(200), True,
            'sine'),)
        unseen = frozenset()
    found = {name for name, _, _ in all_guesses(Given)}
    assert {'torque_gain', 'friction_asymmetry', 'end_stop', 'torque_ripple',
            'load_friction', 'actuator_deadzone'} <= found
    assert not found & {'backlash', 'spring_cubic', 'stiffness_error', 'gravity_tilt',
                        'tip_payload', 'supply_sag', 'motor_inertia_error'}
    Given.paths = (replace(Given.paths[0], commanded=False),)
    measured = {name for name, _, _ in all_guesses(Given)}
    assert found - measured == {'actuator_deadzone', 'actuator_saturation'}
    robot = single_axis(FRICTIONLESS, 0.0, motor_inertia=0.02)
    Given.robot = robot  # all of its inertia stands at the motor
    assert {name for name, _, _ in all_guesses(Given)} - measured == {'motor_inertia_error'}
    knobs = knobs_of(plant.constants_of(robot), DOUBT)
    assert {knob.name for knob in knobs} >= {'motor_inertia', 'level'}
    assert 'static' not in {knob.name for knob in knobs}  # it would fall below Coulomb friction


def test_effects_that_scale_a_joint_together_do_not_join(ideal_robot):
    """But beside one whose size is known, another has a size of its own."""
    specs = [EffectSpec(name=name, joint='joint1', values=(0.1,))
             for name in ('torque_gain', 'stiffness_error', 'input_delay', 'actuator_lag')]
    gain, spring, delay, lag = specs
    robot = replace(ideal_robot, effects=(gain, delay))
    assert [may_join(spec, robot, 0) for spec in specs] == [False] * 4
    assert [may_join(spec, robot, 2) for spec in specs] == [False, True, False, True]
    other = replace(spring, joint='joint2')
    assert may_join(replace(spring, name='motor_inertia_error'), robot, 0)  # K tells them apart
    assert may_join(other, robot, 0) and not may_join(other, replace(robot, effects=(other,)), 1)


def test_friction_that_pushes_is_not_looked_for(robot):
    """All viscous friction may be gone; what is said to be more is no slope but something else."""
    kind, viscous = find('viscous_error'), robot.friction.forward.viscous[0]
    lower, upper = bounds_of(kind, 'joint1', robot)
    assert lower == [-max(viscous, robot.friction.backward.viscous[0])] and upper == [np.inf]
    size = 0.01
    guess = allowed(linear(size)[0], lower, upper)
    assert guess.values([-1e3])[0] == lower[0] == pytest.approx(guess.lowest * size)
    at = [EffectSpec(name='viscous_error', joint='joint1', values=(share * lower[0],))
          for share in (1.0, 0.9, -2.0)]
    assert [is_at_limit(spec, robot) for spec in at] == [True, False, False]


def test_a_value_where_the_catalogue_ends_is_none():
    """A delay of 50 ms is the longest that is looked for; a share of 1 is all there is."""
    for name, values, expected in (
            ('input_delay', (0.05,), True), ('input_delay', (0.049,), False),
            ('encoder_skew', (-0.05,), True), ('encoder_skew', (0.0,), False),
            ('presliding_error', (0.1, 1.0), False), ('backlash', (0.0,), False)):
        spec = EffectSpec(name=name, joint='joint1', values=values)
        assert is_at_limit(spec, None) == expected


def test_a_supply_that_is_known_is_looked_for():
    """Two sags about voltages 1 V apart add up to one of another ratio and nominal voltage."""
    class Volts:
        supply = 24.0
    guess, = find('supply_sag').guesses(Volts)
    c, volts = np.array([0.3, 0.4]), np.array([20.0, 23.0, 25.5])
    ratio, nominal = guess.values(c)
    parts = sum(k * r * (volts - v) for k, (r, v) in zip(c, guess.probes, strict=True))
    np.testing.assert_allclose(ratio * (volts - nominal), parts, rtol=1e-12)


def test_a_state_before_a_motion_sticks_and_is_unloaded(ideal_robot):
    state = fresh_state(plant.constants_of(ideal_robot))
    assert np.all(state.friction.sticking == 1) and not np.any(state.friction.torque)


def test_a_noise_of_counts_alone_is_no_effect(problem):
    """Re-tuning known parameters of a clean run gains less than the search would look at."""
    x, rows, _ = problem.retuned(problem.robot, np.zeros(len(problem.knobs)))
    assert problem.cost(rows, problem.robot, x) < 1.3 * problem.level * problem.fitted.sum()
    assert np.all(np.abs(x) <= problem.bound_of(problem.robot))


@pytest.mark.parametrize(('name', 'knob'), [
    ('motor_inertia_error', 'motor_inertia'), ('stiffness_error', 'stiffness')])
def test_the_same_robot_costs_the_same_however_it_is_said(robot, gains, name, knob):
    """An error of a parameter that its knob makes good leaves robot and cost as they are."""
    coarse = replace(robot, encoder=replace(robot.encoder, counts=8192.0))
    problem = Problem([driven_path(coarse, gains)], robot, 0.01)
    ratio, index = -0.04, [one.name for one in problem.knobs].index(knob)
    x = np.zeros(len(problem.knobs))
    plain = problem.cost(problem.rows(robot, x), robot, x)
    spec = EffectSpec(name=name, joint=robot.joints[problem.knobs[index].joint], values=(ratio,))
    problem.noise.learn(replace(spec, values=(0.1,)))
    same = with_effect(robot, spec)
    x[index] = 1.0 / (1.0 + ratio) - 1.0
    rows = problem.rows(same, x)
    rows[-len(x):] = 0.0  # what known parameters are moved by is told beside
    np.testing.assert_allclose(rows, problem.rows(robot, 0.0 * x), atol=1e-6)
    noise = abs(2.0 * problem.noise.slopes(robot)[index] * x[index])
    assert noise > 1.0
    assert problem.cost(rows, same, x) == pytest.approx(plain, abs=0.1 * noise)


@pytest.mark.parametrize('seed', range(3))
def test_where_nothing_is_missing_no_hypothesis_gains_half_of_what_is_asked(problem, seed):
    """Known parameters re-tuned or not, noise in torques and columns alike."""
    run = retrace(problem.paths[0], problem.constants(problem.robot, np.zeros(len(
        problem.knobs))), np.random.default_rng([7, seed]))
    other = Problem([run], problem.robot, 0.005, seed)
    x, rows, knobs = other.retuned(other.robot, np.zeros(len(other.knobs)))
    model = Fitted(other.robot, x, rows, other.cost(rows, other.robot, x))
    library = Library(other, model, knobs)
    ranked = library.ranked(model, knobs)
    # however many sizes of some effect are alike
    assert len({(one.spec.name, one.spec.joint) for one in ranked}) == len(ranked) > 6
    assert all(library.beyond_chance(one) <= one.gain for one in ranked)
    assert max(library.beyond_chance(one) for one in ranked) < 0.5 * LEAST_GAIN


def test_what_filters_leave_at_reversals_is_no_stribeck_curve():
    """They leave the same of clean runs, whose mean is taken off."""
    case = make_case('clean', 7)
    problem = Problem([path_of(case.recording, case.nominal)], case.nominal, 0.005)
    x, rows, knobs = problem.retuned(problem.robot, np.zeros(len(problem.knobs)))
    library = Library(problem, Fitted(problem.robot, x, rows, 0.0), knobs)
    gains = []
    for left in (rows, rows + problem.usual):
        model = Fitted(problem.robot, x, left, problem.cost(left, problem.robot, x))
        gains.append(max((one.gain for one in library.ranked(model, knobs)
                          if (one.spec.name, one.spec.joint) == ('stribeck_error', 'joint1')),
                         default=0.0))
    assert gains[0] < 10.0 and gains[1] > 25.0


def test_known_parameters_stay_where_data_do_not_tell(problem):
    """The cost of a move by its whole doubt is four, two standard deviations squared."""
    x = np.zeros(len(problem.knobs))
    rows = problem.rows(problem.robot, x)
    x[2] = problem.knobs[2].doubt
    moved = problem.rows(problem.robot, x)
    count = len(x)
    assert not np.any(rows[-count:])
    assert np.sum(moved[-count:] ** 2) == pytest.approx(4.0)
    assert problem.fitted[-count:].all() and not problem.held_out[-count:].any()


def test_what_is_left_is_described_where_most_is_left(robot, gains):
    """The second of two recordings holds a torque on a motor that the first does not."""
    biased = EffectSpec(name='motor_torque_bias', joint='joint2', values=(0.02,))
    paths = [driven_path(replace(robot, effects=effects), gains, seed, duration=6.0)
             for seed, effects in enumerate([(), (biased,)])]
    for order in (paths, paths[::-1]):
        problem = Problem(order, robot, 0.005)
        model = Fitted.of(problem, robot, np.zeros(len(problem.knobs)))
        found = signature.signature_of(problem, model, 1.0)
        assert (found.equation, found.joint, found.variable) == ('motor', 'joint2', 'constant')
