# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Hidden robots: their integrator against others, and cases drawn from seeds."""

from dataclasses import replace
import json
from types import SimpleNamespace

from bench.__main__ import main
from bench.hidden_robots import cases, motions, outsiders, plants, sizes, truth
from bench.hidden_robots.kernels import friction as hidden_friction
import core_runs
from core_runs import push_plant, single_axis
from gms_flex_control.data.reader import read_recording
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import registry, table
from gms_flex_control.effects.base import Term
from gms_flex_control.errors import ConfigError
from gms_flex_control.friction import gms
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np
import pytest
from scipy.integrate import solve_ivp

TIME = np.arange(500) * 2e-3
COMMAND = np.stack([0.5 * np.sin(1.3 * TIME) + 0.1 * np.sin(7 * TIME), 0.3 * np.sin(2.1 * TIME)],
                   axis=1)


def without_friction(robot, **arm):
    """Return a robot whose friction is too small to matter."""
    friction = robot.friction.each_way(
        lambda side: replace(side, static=[1e-12] * 2, coulomb=[1e-12] * 2, viscous=[0.0] * 2),
        stiffness=np.zeros_like(robot.friction.stiffness))
    return replace(robot, friction=friction, arm=replace(robot.arm, **arm))


def test_without_friction_the_motion_is_that_of_a_solver_of_others(ideal_robot):
    """Mass, Coriolis and gravity by chain.matrices, integrated by scipy."""
    robot = without_friction(ideal_robot, gravity=[1.0, -3.0], offset=[0.2, -0.3],
                             damping=[0.01, 0.02])
    arm, torque = robot.arm, np.array([0.4, -0.3])

    def rate(_, x):
        q, v, q_motor, v_motor = x.reshape(4, 2)
        m = chain.matrices(q, v, np.zeros(2), np.zeros(2), arm)
        spring = arm.stiffness * (q_motor - q) + arm.damping * (v_motor - v)
        a = np.linalg.solve(m.mass, spring - m.coriolis @ v - m.gravity)
        return np.concatenate([v, a, v_motor, (torque - spring) / arm.motor_inertia])

    unloaded = truth.at_rest(robot)
    unloaded.q_motor[:] = 0.0
    states = truth.simulate_open(robot, np.tile(torque, (500, 1)), state=unloaded)
    exact = solve_ivp(rate, (0.0, 1.0), np.zeros(8), rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(states[-1], exact.reshape(4, 2), atol=2e-6)


@pytest.mark.parametrize('kind', ['planar', 'decoupled'])
def test_a_robot_at_rest_is_held_by_its_springs(ideal_robot, kind):
    """Weight by chain.matrices, a motor on which nothing but its spring acts."""
    robot = without_friction(ideal_robot, gravity=[1.0, -3.0], offset=[0.2, -0.3], kind=kind)
    q, zero = np.array([0.3, -0.7]), np.zeros(2)
    start = truth.at_rest(robot, q)
    weight = chain.matrices(q, zero, zero, zero, robot.arm).gravity
    np.testing.assert_allclose(robot.arm.stiffness * (start.q_motor - q), weight, rtol=1e-12)
    states = truth.simulate_open(robot, np.tile(weight, (200, 1)), state=start)
    assert np.abs(states[:, [0, 2]] - states[0, [0, 2]]).max() < 1e-9


def test_without_friction_energy_is_kept(ideal_robot):
    robot = without_friction(ideal_robot)
    state = truth.at_rest(robot)
    state.q_motor[:] = [0.4, -0.3]
    states = truth.simulate_open(robot, np.zeros((2000, 2)), state=state)
    energy = [core_runs.energy(*states[k], robot.arm) for k in (0, 500, 1000, 2000)]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)


def test_the_plant_converges_to_the_hidden_robot(ideal_robot):
    """The plant is of first order: each refinement by four takes about as much off."""
    hidden = truth.simulate_open(ideal_robot, COMMAND, substeps=200)[1:]
    errors = [np.abs(push_plant(ideal_robot, COMMAND, 2e-3, substeps=substeps)[:, :4]
                     - hidden).max() for substeps in (25, 100, 400)]
    assert errors[1] < errors[0] / 2.5 and errors[2] < errors[1] / 2.5
    assert errors[2] < 3e-4
    coarse = truth.simulate_open(ideal_robot, COMMAND)[1:]
    assert np.abs(coarse - hidden).max() < 1e-4


@pytest.mark.parametrize('name', sorted(
    name for name in registry.names() if issubclass(registry.find(name), Term)))
def test_every_term_acts_in_the_hidden_robot_as_in_the_plant(ideal_robot, name):
    """What an effect changes in one integrator, it changes in the other as well."""
    stage = registry.find(name).stage
    if stage == stage.SENSOR or name == 'supply_sag':
        pytest.skip('acts on what is measured, or with a voltage')
    if name not in sizes.MAIN:
        pytest.skip('no robot of the bench has it')
    figures = sizes.figures_of(ideal_robot, TURNING, 2e-3)
    rng = np.random.default_rng(3)
    spec = sizes.spec(name, 1, ideal_robot.joints, sizes.MAIN[name](rng, figures[1]))
    robots = ideal_robot, replace(ideal_robot, effects=(spec,))
    command = 1.5 * COMMAND[:250]
    plant = [push_plant(robot, command, 2e-3, substeps=200)[:, :4] for robot in robots]
    hidden = [truth.simulate_open(robot, command)[1:] for robot in robots]
    change = plant[1] - plant[0]
    assert np.abs(hidden[1] - hidden[0] - change).max() < 0.15 * np.abs(change).max() + 1e-4


TURNING = truth.Motion(
    None, np.stack([np.stack([np.sin(TIME), np.cos(TIME), 1.1 * np.sin(TIME),
                              1.1 * np.cos(TIME)], axis=1)] * 2, axis=2), COMMAND, None, None,
    None)


def test_the_friction_is_that_of_the_model_between_reversals(ideal_robot):
    """Its steps and those of friction.gms agree to the order of the step."""
    params = ideal_robot.friction
    constants = gms.constants_of(params)
    state, n = gms.init(params), 2
    torque, sticking = np.zeros((n, 6)), np.ones((n, 6), np.uint8)
    direction, errors = np.ones(n), []
    for k in range(20000):
        v, a = 0.2 * np.sin(5e-5 * k * 6.0), 1.2 * np.cos(5e-5 * k * 6.0)
        for j in range(n):
            hidden_friction.move(j, v, a, 5e-5, torque, sticking, direction, constants)
        step = 5e-5 * (v + 0.5 * 5e-5 * a)
        gms.advance(state, np.full(n, step), np.full(n, step / 5e-5), 5e-5, constants)
        errors.append(np.abs(torque - state.torque).max())
    assert max(errors) < 1e-4


def test_a_base_that_gives_way_is_a_third_mass(ideal_robot):
    """Links and base against the mass matrix of all three, in angles from the base."""
    robot = without_friction(ideal_robot)
    spec = EffectSpec(name='base_flexibility', joint='joint1', values=(5.0, 0.5, 0.05))
    torque, arm, w = np.array([0.5, 0.0]), robot.arm, 2 * np.pi * 5.0

    def rate(_, x):
        q, v, motor, v_motor = x[:8].reshape(4, 2)
        base, v_base = x[8:]
        m = chain.matrices(q, v + [v_base, 0.0], np.zeros(2), np.zeros(2), arm)
        spring = arm.stiffness * (motor - q)
        a_base = -torque[0] / 0.5 - 2 * 0.05 * w * v_base - w * w * base
        a = np.linalg.solve(m.mass, spring - m.coriolis @ (v + [v_base, 0.0]))
        a_motor = (torque - spring) / arm.motor_inertia
        return np.concatenate([v, a - [a_base, 0.0], v_motor, a_motor - [a_base, 0.0],
                               [v_base, a_base]])

    exact = solve_ivp(rate, (0.0, 0.5), np.zeros(10), rtol=1e-10, atol=1e-12).y[:, -1]
    driven = replace(robot, effects=(spec,))
    states = truth.simulate_open(driven, np.tile(torque, (250, 1)))
    seen = states[-1, 0] - [exact[8], 0.0]
    np.testing.assert_allclose(seen, exact[:2], atol=1e-6)
    # and the effect of the catalogue tells the same lean from the torque alone
    entry, memory = table.build((spec,), robot.joints), np.zeros(table.MEMORY_SIZE)
    signals = np.zeros((2, table.WIDTH))
    for _ in range(250):
        signals[:] = 0.0
        signals[0, 9] = torque[0]
        table.run_stage(int(registry.find(spec.name).stage), signals, memory, 2e-3, entry)
    assert -signals[0, 16] == pytest.approx(exact[8], abs=1e-8)


def test_a_case_is_its_seed():
    """Every number: drawn twice it is the same, and another seed is another robot."""
    first, again = (cases.make_case('clutter', 4, duration=10.0) for _ in range(2))
    assert first.truth.effects == again.truth.effects
    assert first.truth.clutter == again.truth.clutter
    for name in ('q_link', 'q_motor', 'command'):
        np.testing.assert_array_equal(getattr(first.recording, name),
                                      getattr(again.recording, name))
    other = cases.make_case('clutter', 5, duration=10.0)
    assert not np.allclose(first.nominal.arm.mass, other.nominal.arm.mass)


@pytest.mark.parametrize('kind', cases.KINDS)
def test_a_case_hides_what_its_kind_says(kind):
    case = cases.make_case(kind, 3, duration=10.0)
    found = case.truth
    assert len(found.effects) == {'clean': 0, 'outside': 0, 'double': 2}.get(kind, 1)
    assert len(found.clutter) == (14 if kind == 'clutter' else 0)
    assert (found.outsider is not None) == (kind == 'outside')
    assert found.robot.effects == found.effects + found.clutter
    assert (found.kind, found.seed, found.motion) == (kind, 3, 'rich')
    assert case.nominal.effects == ()
    assert case.recording.time[-1] == pytest.approx(10.0 - 2e-3)
    assert not np.allclose(case.held_out.q_link, case.recording.q_link)
    for name in ('q_link', 'q_motor', 'tau_motor', 'command', 'reference'):
        assert np.isfinite(getattr(case.recording, name)).all()
    np.testing.assert_array_equal(case.recording.tau_motor[1:], case.recording.command[:-1])


def test_what_is_believed_lies_1_to_3_percent_off():
    robot, _ = plants.draw_robot(np.random.default_rng(0), 'soft')
    belief = plants.draw_belief(np.random.default_rng(1), robot)
    pairs = [(base_parameters(belief.arm), base_parameters(robot.arm)),
             (belief.arm.stiffness, robot.arm.stiffness),
             (belief.arm.motor_inertia, robot.arm.motor_inertia),
             (belief.friction.forward.coulomb, robot.friction.forward.coulomb),
             (belief.friction.backward.static, robot.friction.backward.static),
             (belief.friction.forward.viscous, robot.friction.forward.viscous)]
    for believed, true in pairs:
        off = np.abs(believed / true - 1.0)
        assert np.all((off > 0.0099) & (off < 0.0301))


def test_the_weight_of_an_arm_in_a_tilted_plane_is_borne_and_believed_nearly():
    """As far as springs bear it; the rest of the robot is that of a level plane."""
    for seed, plant in enumerate(plants.PLANTS * 4):
        level, _ = plants.draw_robot(np.random.default_rng(seed), plant)
        rng = np.random.default_rng(seed)
        robot, gains = plants.under_gravity(rng, *plants.draw_robot(rng, plant))
        zero = np.zeros(2)
        weight = np.abs([chain.matrices(np.array([q, 0.0]), zero, zero, zero, robot.arm).gravity
                         for q in np.linspace(-np.pi, np.pi, 73)]).max(axis=0)
        assert 0.0 < np.linalg.norm(robot.arm.gravity) <= 9.81
        assert np.all(weight < 0.31 * robot.arm.stiffness)
        assert np.all(gains.torque_limit > 3.0 + weight)
        np.testing.assert_array_equal(robot.arm.stiffness, level.arm.stiffness)
        np.testing.assert_array_equal(robot.friction.stiffness, level.friction.stiffness)
        belief = plants.draw_belief(rng, robot).arm
        off = np.abs(moments(belief) / moments(robot.arm) - 1.0)
        assert np.all((off > 0.0099) & (off < 0.0301))
        off = np.abs(base_parameters(belief) / base_parameters(robot.arm) - 1.0)
        assert np.all((off > 0.0099) & (off < 0.0301))


def moments(arm):
    """Return the mass moments of two links, each with what it carries, from g of a pose."""
    zero = np.zeros(2)
    level = -arm.offset  # across gravity
    both = chain.matrices(level, zero, zero, zero, arm).gravity
    return np.array([both[0] - both[1], both[1]])


def base_parameters(arm):
    """Return the three constants of M of two links, from M itself at two poses."""
    def mass(q2):
        zero = np.zeros(2)
        return chain.matrices(np.array([0.0, q2]), zero, zero, zero, arm).mass
    straight, square = mass(0.0), mass(np.pi / 2)
    coupled = straight[0, 1] - square[0, 1]
    return np.array([square[0, 0] - square[1, 1], coupled, square[1, 1]])


@pytest.mark.parametrize('motion', motions.MOTIONS)
@pytest.mark.parametrize('plant', plants.PLANTS)
def test_a_reference_is_smooth_and_begins_at_rest(motion, plant):
    """Its derivatives are those of its angles; it reverses and goes fast and slow."""
    time = np.arange(30000) * 2e-3
    reference = motions.draw_reference(np.random.default_rng(1), motion, plant, time)
    np.testing.assert_allclose(reference[0], 0.0, atol=1e-12)
    for k in range(3):
        slope = np.gradient(reference[:, k], 2e-3, axis=0)
        np.testing.assert_allclose(slope[1:-1], reference[1:-1, k + 1], atol=2e-3)
    reversals = np.sum(np.diff(np.sign(reference[:, 1]), axis=0) != 0, axis=0)
    assert reversals.min() >= 10


def test_small_effects_are_small():
    """Each takes 1 to 3 % of the friction, or less: rms of what it changes in the torque."""
    case = cases.make_case('clutter', 2, duration=20.0)
    static = case.truth.robot.friction.forward.static
    amplitudes = {'motor_coulomb': 'coulomb', 'actuator_deadzone': 'deadzone',
                  'spring_hysteresis': 'force', 'motor_torque_bias': 'bias',
                  'constant_link_torque': 'bias'}
    seen = 0
    for spec in case.truth.clutter:
        if spec.name in amplitudes:
            names = [parameter.name for parameter in registry.find(spec.name).parameters]
            size = abs(spec.values[names.index(amplitudes[spec.name])])
            j = case.truth.robot.joints.index(spec.joint)
            assert 0.0099 < size / static[j] < 0.0301
            seen += 1
    assert seen > 0


def test_every_outsider_disturbs():
    """And only as much as friction does."""
    robot, gains = plants.draw_robot(np.random.default_rng(0), 'stiff')
    time = np.arange(3000) * 2e-3
    reference = motions.draw_reference(np.random.default_rng(0), 'sinusoid', 'stiff', time)
    quiet = truth.simulate(robot, robot, gains, reference)
    figures = sizes.figures_of(robot, quiet, 2e-3)
    for name in outsiders.NAMES:
        disturbance = outsiders.draw_disturbance(np.random.default_rng(2), name, 0, figures[0],
                                                 len(time), 2e-3)
        loud = truth.simulate(robot, robot, gains, reference, disturbance=disturbance)
        change = sizes.rms(loud.command - quiet.command)
        assert 1e-4 < change.max() < 1.0, name
        assert sizes.rms(loud.true[:, 0] - reference[:, 0]).max() < 0.2, name


def test_joints_that_do_not_interact(ideal_robot):
    """One flexible axis: the plant says the same."""
    friction = ideal_robot.friction.of_joints([0])
    axis = single_axis(friction, 0.05, stiffness=2.0, motor_inertia=0.005)
    hidden = truth.simulate_open(axis, COMMAND[:, :1])[1:]
    plant = push_plant(axis, COMMAND[:, :1], 2e-3, substeps=400)[:, :4]
    assert np.abs(hidden - plant).max() < 1e-3


def test_a_longer_chain_is_refused():
    three = SimpleNamespace(arm=SimpleNamespace(kind='planar'), n_joints=3, effects=())
    with pytest.raises(ConfigError, match='one or two joints, got 3'):
        truth.constants_of(three)


def test_an_unknown_kind_is_refused_with_the_nearest():
    with pytest.raises(ConfigError, match="kind 'singel' is unknown; did you mean 'single'?"):
        cases.make_case('singel', 0)
    with pytest.raises(ConfigError, match="effect 'backlsh' is unknown; did you mean"):
        cases.make_case('single', 0, effect='backlsh')


def test_hide_writes_what_a_user_has_and_the_truth(tmp_path, capsys):
    """Bag, believed robot and gains read back; an existing case is kept."""
    args = ['hide', '--out', str(tmp_path), '--kind', 'double', '--seeds', '2', '--duration', '8']
    assert main(args) == 0
    folder = tmp_path / 'double_2'
    case = cases.make_case('double', 2, duration=8.0)
    recording = read_recording(folder / 'bag')
    np.testing.assert_allclose(recording.q_link, case.recording.q_link, atol=1e-12)
    np.testing.assert_allclose(recording.tau_motor, case.recording.tau_motor, atol=1e-12)
    robot = load_robot(folder / 'robot.yaml')
    np.testing.assert_array_equal(robot.arm.stiffness, case.nominal.arm.stiffness)
    gains = load_controller(folder / 'controller.yaml', robot)
    np.testing.assert_array_equal(gains.kd_motor, case.gains.kd_motor)
    told = json.loads((folder / 'truth.json').read_text())
    assert [one['effect'] for one in told['effects']] == [
        spec.name for spec in case.truth.effects]
    assert main(args) == 0
    assert 'kept as it is' in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ['double_2']


def test_hide_writes_arms_that_carry_their_weight(tmp_path):
    """Robot files know gravity along -y alone; the arm hangs from any direction all the same."""
    args = ['hide', '--out', str(tmp_path), '--kind', 'clean', '--population', 'gravity',
            '--duration', '8']
    assert main(args) == 0
    robot = load_robot(tmp_path / 'clean_0_gravity' / 'robot.yaml')
    believed = cases.make_case('clean', 0, duration=8.0, population='gravity').nominal
    assert robot.arm.gravity[1] < 0.0 and robot.arm.offset[0] != 0.0
    zero = np.zeros(2)
    for q in np.random.default_rng(5).uniform(-2.0, 2.0, (5, 2)):
        weights = [chain.matrices(q, zero, zero, zero, one.arm).gravity
                   for one in (robot, believed)]
        np.testing.assert_allclose(weights[0], weights[1], rtol=1e-12)


@pytest.mark.parametrize('duration', ['0', '-3', 'nan', 'inf'])
@pytest.mark.parametrize('verb', ['hide', 'score'])
def test_a_duration_that_is_none_is_refused(tmp_path, capsys, verb, duration):
    args = [verb, '--out', str(tmp_path), '--kind', 'clean', f'--duration={duration}']
    assert main(args) == 2
    assert f'--duration {float(duration):g}: give 2 to 3600 s' in capsys.readouterr().err


@pytest.mark.parametrize('seeds', ['x', '3:3', '-1', '1:'])
def test_seeds_that_are_none_are_refused(tmp_path, capsys, seeds):
    assert main(['hide', '--out', str(tmp_path), f'--seeds={seeds}']) == 2
    assert 'must be a number or A:B' in capsys.readouterr().err


def test_the_supply_is_recorded_where_it_matters():
    """With other effects it is there in half of the cases, so that it tells nothing."""
    case = cases.make_case('single', 0, effect='supply_sag', duration=10.0)
    volts = case.recording.supply
    assert np.isfinite(volts).all() and volts.max() < 24.1 and np.ptp(volts) > 0.5
    recorded = [np.isfinite(cases.make_case('clean', seed, duration=8.0).recording.supply).all()
                for seed in range(6)]
    assert 0 < sum(recorded) < 6
