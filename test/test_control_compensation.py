# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Friction compensations against closed forms, and against the friction they are to estimate."""

from dataclasses import replace

from core_runs import affected, model_with_error, single_axis
from gms_flex_control import friction as gms
from gms_flex_control.control import compensation, observer
from gms_flex_control.friction import steady_friction, stribeck_level
from gms_flex_control.params.gains import COMPENSATIONS, ControllerParams
from gms_flex_control.params.robot import EncoderParams, FrictionParams, StribeckParams
from gms_flex_control.simulation import loop
from gms_flex_control.trajectory import builders
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
