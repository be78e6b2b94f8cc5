# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The simulated robot against textbook equations integrated by scipy, and its encoders."""

from dataclasses import replace

import core_runs
from core_runs import push_plant, scaled_friction, single_axis
from gms_flex_control.effects import base as sig
from gms_flex_control.friction import steady_friction
from gms_flex_control.params.robot import EncoderParams
from gms_flex_control.simulation import encoder, loop, plant
from gms_flex_control.trajectory.builders import sinusoid
import numpy as np
import pytest
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.fast


@pytest.fixture(scope='module')
def smooth_robot(ideal_robot):
    """Return the default arm upright in gravity, its friction made immeasurably small."""
    return replace(ideal_robot, friction=scaled_friction(ideal_robot.friction, 1e-12),
                   arm=replace(ideal_robot.arm, gravity=2.0))


def textbook(t, x, arm):
    """Return the rates of a two-link arm with flexible joints, by the textbook's formulas."""
    (q1, q2), (v1, v2), motor, dmotor = x.reshape(4, 2)
    m1, m2 = arm.mass
    l1, (c1, c2), (i1, i2) = arm.length[0], arm.com, arm.inertia
    g = -arm.gravity[1]
    a = i1 + m1 * c1 ** 2 + m2 * l1 ** 2 + i2 + m2 * c2 ** 2
    b, d = m2 * l1 * c2, i2 + m2 * c2 ** 2
    mass = np.array([[a + 2 * b * np.cos(q2), d + b * np.cos(q2)], [d + b * np.cos(q2), d]])
    speed = b * np.sin(q2) * np.array([-(2 * v1 * v2 + v2 ** 2), v1 ** 2])
    weight = g * np.array([(m1 * c1 + m2 * l1) * np.cos(q1) + m2 * c2 * np.cos(q1 + q2),
                           m2 * c2 * np.cos(q1 + q2)])
    spring = (arm.stiffness * (motor - x[:2]) + arm.damping * (dmotor - x[2:4]))
    return np.concatenate([x[2:4], np.linalg.solve(mass, spring - speed - weight), dmotor,
                           -spring / arm.motor_inertia])


def test_without_friction_it_moves_as_the_textbook_arm(smooth_robot):
    """The error against a high-order integration is of first order in the substep."""
    truth = solve_ivp(textbook, (0.0, 1.0), [0.3, -0.4, 0.0, 0.0, 0.1, 0.2, 0.0, 0.0],
                      args=(smooth_robot.arm,), rtol=1e-10, atol=1e-12).y[:, -1].reshape(4, 2)
    errors = []
    for substeps in (50, 100):
        state = plant.init(smooth_robot, [0.3, -0.4])
        state.q_motor[:] = [0.1, 0.2]
        run = push_plant(smooth_robot, np.zeros((1000, 2)), 1e-3, substeps=substeps, state=state)
        errors.append(np.abs(run[-1, :4] - truth).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_work_put_in_is_energy_and_friction_heat(ideal_robot):
    """Over 3 s of driven motion: torque work = mechanical energy + work against friction."""
    arm = replace(ideal_robot.arm, damping=[0.0, 0.0])
    robot, period = replace(ideal_robot, arm=arm), 2e-5
    t = np.arange(0.0, 3.0, period)
    command = 0.4 * np.stack([np.sin(2.0 * t), np.sin(3.0 * t)], axis=1)
    run = push_plant(robot, command, period)
    work = np.sum(command * run[:, 3]) * period
    heat = np.sum(run[:, 4] * run[:, 1]) * period
    assert heat > 0.1 * work
    assert core_runs.energy(*run[-1, :4], arm) == pytest.approx(work - heat, abs=2e-3 * work)


def test_a_rigid_joint_is_the_limit_of_a_stiff_one(ideal_robot):
    """Motor and link of 2e5 N m/rad move together as the rigid joint with both inertias."""
    period = 1e-3
    t = np.arange(0.0, 2.0, period)
    command = 0.5 * np.stack([np.sin(3.0 * t), np.cos(2.0 * t)], axis=1)
    stiff = replace(ideal_robot, arm=replace(ideal_robot.arm, stiffness=[2e5, 2e5],
                                             damping=[5.0, 5.0]))
    rigid = replace(ideal_robot, motors=('', ''),
                    arm=replace(ideal_robot.arm, stiffness=[np.inf, np.inf]))
    runs = [push_plant(robot, command, period, substeps=200) for robot in (stiff, rigid)]
    assert np.abs(runs[1][:, 0]).max() > 0.5
    np.testing.assert_allclose(runs[0][:, 0], runs[1][:, 0], atol=1e-3)
    np.testing.assert_array_equal(runs[1][:, 2], runs[1][:, 0])


def test_decoupled_axes_are_as_many_single_axes(ideal_robot):
    arm = replace(ideal_robot.arm, kind='decoupled')
    both = replace(ideal_robot, arm=arm)
    command = 0.4 * np.random.default_rng(1).standard_normal((500, 2)).cumsum(axis=0) / 10.0
    run = push_plant(both, command, 2e-3, substeps=20)
    for j in range(2):
        axis = single_axis(both.friction.of_joints([j]),
                           arm.inertia[j] + arm.mass[j] * arm.com[j] ** 2,
                           stiffness=arm.stiffness[j], motor_inertia=arm.motor_inertia[j])
        alone = push_plant(axis, command[:, [j]], 2e-3, substeps=20)
        np.testing.assert_allclose(alone[:, :, 0], run[:, :, j], rtol=0, atol=1e-13)


def test_a_single_axis_slides_where_torque_and_steady_friction_balance(ideal_robot):
    one = ideal_robot.friction.of_joints([0])
    for sign in (1.0, -1.0):
        run = push_plant(single_axis(one, 0.05), np.full((20000, 1), 0.12 * sign), 1e-3)
        assert steady_friction(run[-1, 1], one) == pytest.approx([0.12 * sign], rel=1e-6)


def test_at_rest_without_torque_nothing_moves(robot):
    state = plant.init(robot, [0.5, -1.0])
    run = push_plant(robot, np.zeros((100, 2)), 2e-3, substeps=20, state=state)
    np.testing.assert_array_equal(run[:, 0], np.broadcast_to([0.5, -1.0], (100, 2)))
    np.testing.assert_array_equal(run[:, 1], np.zeros((100, 2)))


def test_a_step_of_many_substeps_is_as_many_short_steps(ideal_robot):
    """Holding the command, 10 samples of one substep are one sample of 10."""
    command = np.full((40, 2), 0.3)
    coarse = push_plant(ideal_robot, command, 1e-3, substeps=10)
    fine = push_plant(ideal_robot, np.repeat(command, 10, axis=0), 1e-4)
    np.testing.assert_allclose(coarse, fine[9::10], rtol=1e-12, atol=1e-14)


def test_a_run_repeats_bit_by_bit_and_its_seed_is_the_noise(robot, gains):
    noisy = replace(robot, encoder=EncoderParams(counts=20000, noise=1e-4, velocity_cutoff=50))
    runs = [loop.run(noisy, robot, gains, sinusoid([1.0, 1.0], 6.0), duration=0.5,
                     seed=seed) for seed in (3, 3, 4)]
    for name in ('measured', 'true', 'command', 'applied', 'friction', 'friction_hat'):
        np.testing.assert_array_equal(getattr(runs[0], name), getattr(runs[1], name))
    assert np.any(runs[0].measured != runs[2].measured)


def test_the_applied_torque_of_a_sample_is_the_command_of_the_one_before(ideal_robot, gains):
    run = loop.run(ideal_robot, ideal_robot, gains, sinusoid([1.0, 1.0], 6.0), duration=0.5)
    np.testing.assert_allclose(run.applied[1:], run.command[:-1], rtol=1e-13)
    np.testing.assert_array_equal(run.applied[0], [0.0, 0.0])


PERIOD = 2e-3


def measure(angles, params, seed=0, rates=None):
    """Return what two encoders read along ``angles`` (T, 2): (T, 4, 2) as Run.measured."""
    state, constants = encoder.init(2), encoder.constants_of(params)
    rng, signals = np.random.default_rng(seed), np.zeros((2, sig.WIDTH))
    rates = np.zeros_like(angles) if rates is None else rates
    out = []
    for angle, rate in zip(angles, rates, strict=True):
        encoder.draw(state, constants, rng)
        signals[:, [sig.SENSED_LINK, sig.SENSED_LINK_RATE]] = np.stack([angle, rate], axis=1)
        signals[:, [sig.SENSED_MOTOR, sig.SENSED_MOTOR_RATE]] = np.stack(
            [2 * angle, 3 * rate], axis=1)
        encoder.measure(state, signals, PERIOD, constants)
        seen = state.output
        out.append(np.stack([seen.q_link, seen.dq_link, seen.q_motor, seen.dq_motor]))
    return np.array(out)


def test_angles_come_in_whole_counts():
    """20 000 counts a revolution: steps of 0.314 mrad, the nearest one, on both sides."""
    angles = np.random.default_rng(0).uniform(-4.0, 4.0, (200, 2))
    read = measure(angles, EncoderParams(counts=20000))
    counts = read[:, [0, 2]] / (2 * np.pi / 20000)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-8)
    half = np.pi / 20000 * (1 + 1e-9)
    assert np.abs(read[:, 0] - angles).max() <= half
    assert np.abs(read[:, 2] - 2 * angles).max() <= half


def test_an_ideal_encoder_reads_angles_and_rates_as_they_are():
    rng = np.random.default_rng(1)
    angles, rates = rng.standard_normal((20, 2)), rng.standard_normal((20, 2))
    read = measure(angles, EncoderParams(), rates=rates)
    np.testing.assert_array_equal(read, np.stack([angles, rates, 2 * angles, 3 * rates], axis=1))


@pytest.mark.parametrize('cutoff', [10.0, 50.0, 200.0])
def test_the_velocity_of_a_ramp_rises_as_a_first_order_low_pass(cutoff):
    """After k samples of velocity v the estimate is v (1 - exp(-2 pi f k T))."""
    k = np.arange(200)
    angles = np.stack([0.5 * k * PERIOD, -0.3 * k * PERIOD], axis=1)
    read = measure(angles, EncoderParams(velocity_cutoff=cutoff))
    rise = 1.0 - np.exp(-2 * np.pi * cutoff * k * PERIOD)
    np.testing.assert_allclose(read[:, 1], rise[:, None] * [0.5, -0.3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(read[:, 3], rise[:, None] * [1.0, -0.6], rtol=0, atol=1e-12)


def test_the_first_sample_has_no_velocity():
    """Wherever the encoder wakes up, it has not come there from zero."""
    read = measure(np.full((3, 2), 2.5), EncoderParams(velocity_cutoff=50.0))
    np.testing.assert_array_equal(read[:, 1], np.zeros((3, 2)))


def test_noise_has_the_stated_deviation_and_repeats_with_its_seed():
    angles, params = np.zeros((20000, 2)), EncoderParams(noise=1e-3)
    read = measure(angles, params, 7)
    again, other = (measure(angles[:200], params, seed) for seed in (7, 8))
    np.testing.assert_array_equal(read[:200], again)
    assert np.any(again != other)
    channels = np.concatenate([read[:, 0], read[:, 2]], axis=1)
    np.testing.assert_allclose(channels.std(axis=0), 1e-3, rtol=0.03)
    np.testing.assert_allclose(channels.mean(axis=0), 0.0, atol=3e-5)
    np.testing.assert_allclose(np.corrcoef(channels.T), np.eye(4), atol=0.03)


def test_noise_is_counted_too():
    """Noise of half a count leaves zero as often as a normal number lies within one sigma."""
    size = 2 * np.pi / 1000
    read = measure(np.zeros((2000, 2)), EncoderParams(counts=1000, noise=0.5 * size))[:, 0] / size
    np.testing.assert_allclose(read, np.round(read), atol=1e-12)
    assert np.mean(np.round(read) == 0) == pytest.approx(0.6827, abs=0.03)
