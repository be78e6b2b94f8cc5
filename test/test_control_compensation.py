# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Compensations against closed forms and the friction they estimate; effects a model names."""

from dataclasses import replace

from core_runs import affected, effect_on, model_with_error, single_axis
from gms_flex_control import friction as gms
from gms_flex_control.control import compensation, observer
from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.control.feedforward import as_parameters
from gms_flex_control.effects.registry import find
from gms_flex_control.friction import steady_friction, stribeck_level
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.gains import COMPENSATIONS, ControllerParams
from gms_flex_control.params.robot import EncoderParams, FrictionParams, StribeckParams
from gms_flex_control.simulation import loop
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.builders import via_points
import numpy as np
import pytest

pytestmark = pytest.mark.fast


@pytest.fixture(scope='module')
def arm(ideal_robot, gains):
    """Return the arm of the paper with ideal encoders, and its gains."""
    return ideal_robot, gains


def run(robot, gains, mode, motion, model=None, **options):
    return loop.run(robot, model or robot, replace(gains, compensation=mode), motion,
                    **{'duration': 20.0} | options)


@pytest.mark.parametrize('velocity', [0.004, 0.05, -0.004, -0.3])
def test_lugre_at_constant_velocity_is_the_stribeck_curve(arm, velocity):
    friction, dt = arm[0].friction, 2e-3
    level = float(stribeck_level(np.full(2, velocity), friction)[1])
    stiffness = float(friction.stiffness[1].sum())
    bristle = 0.0
    for _ in range(3000):
        bristle = compensation.advance_bristle(bristle, velocity * dt, stiffness, level)
    viscous = (friction.forward if velocity > 0 else friction.backward).viscous[1] * velocity
    steady = float(steady_friction(np.full(2, velocity), friction)[1])
    assert stiffness * bristle + viscous == pytest.approx(steady, rel=1e-9)


def test_lugre_begins_as_a_spring_and_rests_where_it_is():
    assert compensation.advance_bristle(0.0, 1e-9, 400.0, 0.1) == pytest.approx(1e-9, rel=1e-5)
    assert compensation.advance_bristle(1e-4, 0.0, 400.0, 0.1) == 1e-4


@pytest.mark.parametrize('mode', ['stribeck', 'lugre', 'gms_paper', 'gms', 'gms_desired'])
def test_models_estimate_sliding_friction_as_eq_6(arm, mode):
    """At 0.2 rad/s, both joints long in sliding, within 1 % of the curve at the true speed."""
    robot, gains = arm
    gains = replace(gains, observer_gain=np.zeros(2), sign_slope=np.full(2, 1e3))
    motion = builders.velocity_levels(np.full(2, 0.2), 8.0)
    found = run(robot, gains, mode, motion, duration=7.0)
    sliding = slice(2500, 3400)
    expected = steady_friction(found.true[sliding, 1], robot.friction)
    np.testing.assert_allclose(found.friction_hat[sliding], expected, rtol=0.01)


@pytest.mark.parametrize('correction', [0.0, 0.8, -3.0])
def test_a_slipping_block_of_the_observer_decays_to_its_corrected_level(arm, correction):
    """
    Eq. (20) at constant velocity, dF/dt = C (alpha r - F / s) - k_e s_1, solved.

    The last correction is more than may be taken away, half of alpha C.
    """
    friction, dt, velocity, smooth = arm[0].friction, 2e-3, np.full(2, 0.05), np.full(2, 0.9)
    blocks = gms.init(friction)
    blocks.sticking[:] = 0
    record = gms.constants_of(friction)
    for _ in range(40):
        observer.advance(blocks, velocity * dt, velocity, smooth, np.full(2, correction),
                         np.zeros(2), dt, record)
    level = stribeck_level(velocity, friction)[:, None]
    attraction, weight = friction.attraction[:, None], friction.weight
    most = 0.5 * weight * attraction
    goal = level * (0.9 * weight - np.clip(correction, -most, most) / attraction)
    expected = goal * (1.0 - np.exp(-attraction * 40 * dt / level))
    np.testing.assert_allclose(blocks.torque, expected, rtol=1e-9)


def test_gms_of_the_desired_motion_is_friction_replayed_along_the_reference(arm):
    """It does not know what the robot does, nor its encoders."""
    robot, gains = arm
    coarse = replace(robot, encoder=EncoderParams(counts=500.0, velocity_cutoff=20.0))
    found = run(coarse, gains, 'gms_desired', builders.sinusoid(np.ones(2), 6.0))
    expected = gms.replay(found.reference[:, 0], found.reference[:, 1], 2e-3,
                          gms.constants_of(robot.friction))
    np.testing.assert_allclose(found.friction_hat, expected, atol=1e-12)


def test_the_disturbance_observer_finds_a_torque_that_its_model_lacks():
    nothing = StribeckParams(static=[1e-12], coulomb=[1e-12], velocity=[0.01], viscous=[0.0])
    friction = FrictionParams(forward=nothing, backward=nothing, stiffness=[[0.0]],
                              weight=[[1.0]], attraction=[1.0])
    robot = single_axis(friction, 0.3, stiffness=5.0, motor_inertia=0.01)
    pushed = affected(robot, 'axis', 'constant_link_torque', 0.07)
    one = np.ones(1)
    gains = ControllerParams(
        compensation='none', kd_link=one, lambda_link=3 * one, kd_motor=0.3 * one,
        lambda_motor=30 * one, observer_gain=one, sign_slope=50 * one,
        filter_bandwidth=100 * one, torque_limit=10 * one)
    found = run(pushed, gains, 'disturbance_observer', builders.hold(np.zeros(1)), model=robot,
                duration=6.0)
    assert found.friction_hat[-1, 0] == pytest.approx(-0.07, rel=1e-3)
    assert abs(found.true[-1, 0, 0]) < 1e-4
    left = run(pushed, gains, 'none', builders.hold(np.zeros(1)), model=robot, duration=6.0)
    assert left.true[-1, 0, 0] > 0.07 / 3.0  # over K_D1 Lambda_1


def test_adaptation_learns_friction_that_was_believed_too_small(arm):
    """Friction believed 0.75 of what it is: the error falls period by period, far below gms."""
    robot, gains = arm
    model = model_with_error(robot, friction=0.75)
    motion = builders.sinusoid(np.ones(2), 6.0)
    found = run(robot, gains, 'gms_adaptive', motion, model, duration=30.0)
    fixed = run(robot, gains, 'gms_desired', motion, model, duration=30.0)
    last = slice(12000, None)
    ratio = [np.mean((one.true[last, 0] - one.reference[last, 0]) ** 2, axis=0)
             for one in (found, fixed)]
    assert np.all(ratio[0] < 0.2 * ratio[1])
    learnt = np.sqrt(np.mean((found.friction_hat - found.friction)[last] ** 2, axis=0))
    believed = np.sqrt(np.mean((fixed.friction_hat - fixed.friction)[last] ** 2, axis=0))
    assert np.all(learnt < 0.7 * believed)
    assert 0.0 < compensation.LEAST_FACTOR < 1.0 < compensation.LARGEST_FACTOR


@pytest.mark.parametrize('mode', [mode for mode in COMPENSATIONS if mode != 'none'])
def test_every_compensation_is_better_than_none(arm, mode):
    robot, gains = arm
    motion = builders.sinusoid(np.ones(2), 6.0)
    errors = [np.mean((one.true[:, 0] - one.reference[:, 0]) ** 2, axis=0)
              for one in (run(robot, gains, name, motion) for name in (mode, 'none'))]
    assert np.all(errors[0] < 0.05 * errors[1])


PERIOD = 2e-3
MOTION = via_points([[0.0, 0.0], [0.8, -0.4], [-0.2, 0.5], [0.0, 0.0]], 2.5, 0.2)


def spec(name, joint='joint2', **values):
    """Return an EffectSpec."""
    return effect_on(joint, name, *find(name).values(values, name))


@pytest.mark.parametrize('effects', [(), (
    spec('load_friction', ratio=0.3, reach=1e-3),
    spec('torque_ripple', amplitude=0.01, order=12.0, phase=0.3))])
def test_stepped_as_by_nodes_it_is_the_compiled_loop_bit_by_bit(effects, robot, gains):
    noisy = replace(robot, encoder=replace(robot.encoder, noise=1e-4))
    model = replace(noisy, effects=effects)
    run = loop.run(noisy, model, gains, MOTION, duration=2.0, seed=4)
    plant = SteppedPlant(noisy, period=PERIOD, substeps=20, seed=4)
    controller = SteppedController(gains, model)
    plant.measure()
    for k, reference in enumerate(run.reference):
        for i, name in enumerate(('q_link', 'dq_link', 'q_motor', 'dq_motor')):
            getattr(controller.measured, name)[:] = getattr(plant.measured, name)
            assert np.array_equal(getattr(plant.measured, name), run.measured[k, i]), (k, name)
        command = controller.tick(reference, PERIOD if k else 0.0)
        assert np.array_equal(command, run.command[k]), k
        assert np.array_equal(controller.state.friction_hat, run.friction_hat[k]), k
        plant.advance(command)


def answers(effects, robot, gains, ticks=40):
    """Return commands and friction estimates along a made-up measurement, with model effects."""
    found = []
    for model in (robot, replace(robot, effects=effects)):
        controller, rows = SteppedController(gains, model), []
        for k in range(ticks):
            t = k * PERIOD
            controller.measured.q_link[:] = 0.1 * t, 0.2 + 0.5 * t
            controller.measured.dq_link[:] = 0.1, 0.5
            controller.measured.q_motor[:] = 0.02 + 0.1 * t, 0.15 + 0.5 * t
            controller.measured.dq_motor[:] = 0.1, 0.5
            reference = np.zeros((5, 2))
            reference[0], reference[1] = controller.measured.q_link, (0.1, 0.5)
            controller.tick(reference, PERIOD if k else 0.0)
            rows.append([controller.state.command.copy(), controller.state.friction_hat.copy()])
        found.append(np.moveaxis(np.array(rows), 1, 0))
    return found


def test_a_ripple_of_the_motor_is_taken_off_its_command(robot, gains):
    ripple = spec('torque_ripple', amplitude=0.01, order=12.0, phase=0.3)
    (plain, _), (command, _) = answers((ripple,), robot, gains)
    motor = 0.15 + 0.5 * PERIOD * np.arange(len(command))
    assert command[:, 1] - plain[:, 1] == pytest.approx(-0.01 * np.sin(12.0 * motor + 0.3))
    assert np.array_equal(command[:, 0], plain[:, 0])


def test_a_constant_torque_on_the_link_is_met_through_the_spring(robot, gains):
    (plain, before), (command, after) = answers(
        (spec('constant_link_torque', bias=0.02),), robot, gains)
    expected = -0.02 * gains.kd_motor[1] * gains.lambda_motor[1] / robot.arm.stiffness[1]
    assert command[:, 1] - plain[:, 1] == pytest.approx(expected)
    assert after[:, 1] - before[:, 1] == pytest.approx(-0.02)


def test_the_friction_estimate_follows_the_position(robot, gains):
    effect = spec('position_friction', ratio=0.2, order=3.0, phase=0.4)
    (_, before), (_, after) = answers((effect,), robot, gains)
    q = 0.2 + 0.5 * PERIOD * np.arange(len(before))
    assert np.ptp(before[:, 1]) > 0.01
    assert after[:, 1] == pytest.approx((1.0 + 0.2 * np.cos(3.0 * q + 0.4)) * before[:, 1])


def test_the_friction_estimate_follows_the_load(robot, gains):
    """The torsion is 0.05 rad of 1.5 N m/rad; the reach is crossed by the second sample."""
    effect = spec('load_friction', ratio=0.3, reach=0.25 * PERIOD)
    (_, before), (_, after) = answers((effect,), robot, gains)
    assert after[1:, 1] == pytest.approx(before[1:, 1] + 0.3 * 0.05 * 1.5)


def test_of_a_rigid_joint_the_load_is_the_command_less_what_the_rotor_asks_for(robot, gains):
    """At a desired acceleration of 4 rad/s^2 the rotor takes 0.02 N m of it."""
    none, one = np.zeros(2), np.ones(2)
    rigid = replace(robot, motors=('', ''), arm=ArmParams(
        kind='decoupled', mass=none, length=none, com=none, inertia=0.05 * one,
        motor_inertia=0.005 * one, stiffness=np.inf * one, damping=none))
    found = []
    for effects in ((), (spec('load_friction', ratio=0.3, reach=5e-4),)):
        controller = SteppedController(gains, replace(rigid, effects=effects))
        for k in range(10):
            controller.measured.q_link[:] = controller.measured.q_motor[:] = 1e-3 * k
            controller.measured.dq_link[:] = controller.measured.dq_motor[:] = 0.5
            controller.tick(np.outer([1e-3 * k, 0.5, 4.0, 0.0, 0.0], one), PERIOD if k else 0.0)
        found.append((controller.state.command[1], controller.state.friction_hat[1]))
    (command, before), (_, after) = found
    assert abs(command) > 0.1
    assert after == pytest.approx(before + 0.3 * abs(command - 0.02))


def test_effects_that_are_parameters_become_parameters(robot):
    model = as_parameters(replace(robot, effects=(
        spec('friction_asymmetry', ratio=0.1), spec('viscous_error', slope=0.02),
        spec('viscous_asymmetry', slope=0.001),
        spec('gravity_tilt', 'arm', tilt=0.01, direction=0.0), spec('backlash', half_gap=0.01),
        spec('torque_ripple', amplitude=0.01, order=6.0, phase=0.0))))
    assert [one.name for one in model.effects] == ['torque_ripple']
    forward, backward = model.friction.forward, model.friction.backward
    assert forward.coulomb[1] == pytest.approx(1.1 * robot.friction.forward.coulomb[1])
    assert backward.static[1] == pytest.approx(0.9 * robot.friction.backward.static[1])
    assert forward.viscous[1] == pytest.approx(1.1 * robot.friction.forward.viscous[1] + 0.021)
    assert backward.viscous[1] == pytest.approx(0.9 * robot.friction.backward.viscous[1] + 0.019)
    assert forward.coulomb[0] == robot.friction.forward.coulomb[0]
    assert model.arm.gravity[0] == pytest.approx(9.80665 * np.sin(0.01))


@pytest.mark.parametrize(('effect', 'joint', 'at_most'), [
    (spec('gravity_tilt', 'arm', tilt=0.015, direction=0.1), 0, 0.3),
    (spec('friction_asymmetry', ratio=0.2), 1, 0.7),
    (spec('position_friction', ratio=0.35, order=2.0, phase=0.5), 1, 0.8),
    (spec('friction_hysteresis', force=0.1, reach=0.02), 1, 0.7),
    (spec('low_speed_friction', ratio=0.8, velocity=0.2), 1, 0.8),
    (spec('shear_thinning', torque=0.15, velocity=0.2, speed=1.0), 1, 0.8),
    (spec('viscous_asymmetry', slope=0.1), 1, 0.7),
    (spec('viscous_error', slope=0.15), 1, 0.7)])
def test_the_links_follow_better_once_the_effect_is_known(effect, joint, at_most, robot, gains):
    true = replace(robot, effects=(effect,))
    runs = [loop.run(true, model, gains, MOTION, duration=8.3) for model in (robot, true)]
    before, after = (np.linalg.norm(run.true[:, 0] - run.reference[:, 0], axis=0) for run in runs)
    assert after[joint] < at_most * before[joint]
