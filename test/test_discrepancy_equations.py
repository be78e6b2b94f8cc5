# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The equations along a measured motion, against closed forms and another integrator."""

from dataclasses import replace

from core_runs import affected, effect_on
from discrepancy_runs import driven_motion, motion_along, null_run, rms_left
from gms_flex_control.discrepancy.motion import make_motion
from gms_flex_control.discrepancy.residuals import cleared, drive_torque, unexplained
from gms_flex_control.dynamics import chain
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.simulation import plant
import numpy as np
import pytest


def test_the_rigid_body_along_a_path_is_that_of_inverse_dynamics():
    """Gravity, offsets and a rigid joint included."""
    n, rng = 2, np.random.default_rng(2)
    mass, length, com, inertia = rng.uniform(0.2, 1.0, (4, n))
    arm = ArmParams(kind='planar', mass=mass, length=length, com=com, inertia=inertia,
                    motor_inertia=np.full(n, 0.1), stiffness=np.where(np.arange(n) == 0, np.inf,
                                                                      5.0),
                    damping=np.zeros(n), gravity=[1.0, -9.0], offset=rng.standard_normal(n))
    links, work = chain.constants_of(arm), plant.workspace(n).chain
    for q, dq, ddq in rng.standard_normal((5, 3, n)):
        bias, inertial = np.empty((2, n))
        chain.rigid_body(q, dq, ddq, links, work, bias, inertial)
        np.testing.assert_allclose(bias + inertial, chain.inverse_dynamics(q, dq, ddq, arm),
                                   rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(bias, chain.inverse_dynamics(q, dq, 0.0 * q, arm),
                                   rtol=1e-12, atol=1e-12)


def test_the_true_model_leaves_nothing_of_a_hidden_robot_but_its_encoders(ideal_robot, gains):
    """The finer integrator of hidden robots, ideal encoders: under 1 % of friction is left."""
    motion = driven_motion(ideal_robot, gains)
    left = unexplained(motion, plant.constants_of(ideal_robot))[50:-50]
    static = np.tile(ideal_robot.friction.forward.static, 2)
    assert np.all(np.sqrt(np.mean(left ** 2, axis=0)) < 0.01 * static)
    wrong = affected(ideal_robot, 'joint2', 'constant_link_torque', 0.01)
    more = unexplained(motion, plant.constants_of(wrong))[50:-50]
    np.testing.assert_allclose(more - left, np.tile([0.0, -0.01, 0.0, 0.0], (len(left), 1)),
                               atol=1e-12)


def test_friction_by_load_follows_from_the_motion_not_from_the_torque_it_explains(
        ideal_robot, gains):
    """A spring of twice the torque is no heavier load: less inertia would explain all of it."""
    motion = driven_motion(ideal_robot, gains, duration=4.0)
    load = effect_on('joint1', 'load_friction', 0.3, 1e-3)
    stiffer = replace(ideal_robot, arm=replace(
        ideal_robot.arm, stiffness=2.0 * ideal_robot.arm.stiffness))
    one, other = (
        unexplained(motion, plant.constants_of(replace(robot, effects=(load,))))
        - unexplained(motion, plant.constants_of(robot)) for robot in (ideal_robot, stiffer))
    assert np.abs(one[:, 0]).max() > 0.01
    np.testing.assert_allclose(other, one, atol=1e-9)


@pytest.mark.parametrize(('name', 'values'), [
    ('actuator_lag', (0.02,)), ('base_flexibility', (8.0, 0.01, 0.1)), ('', ())])
def test_what_is_kept_along_a_motion_is_that_of_its_own_torque(ideal_robot, gains, name, values):
    """Drives and encoders that depend on torque: as along a motion of which nothing is kept."""
    motion = driven_motion(ideal_robot, gains, duration=2.0)
    robot = replace(ideal_robot, effects=(effect_on('joint2', name, *values),) if name else ())
    constants = plant.constants_of(robot)
    for factor in (1.0, 1.2, 1.0, 1.5, 1.2):
        other = motion.with_torque(('times', factor), lambda torque, by=factor: by * torque)
        plain = make_motion(replace(motion.samples, command=factor * motion.samples.command))
        np.testing.assert_array_equal(unexplained(other, constants), unexplained(plain, constants))


def test_a_rotor_couples_through_a_rigid_joint_in_the_plant_as_in_the_fit(ideal_robot, gains):
    arm = replace(ideal_robot.arm, stiffness=[ideal_robot.arm.stiffness[0], np.inf])
    rigid = replace(ideal_robot, arm=arm, motors=(ideal_robot.motors[0], ''))
    robot = affected(rigid, 'joint2', 'motor_inertia_coupling', 0.005)
    again = null_run(driven_motion(ideal_robot, gains), robot)
    with_it, without = (rms_left(again, plant.constants_of(one))[0] for one in (robot, rigid))
    assert with_it < 0.2 * without


def test_friction_acts_between_joint_and_base_along_a_motion_as_in_the_plant(ideal_robot, gains):
    """Where the base swings at its frequency, friction of the link alone would excite it more."""
    robot = affected(ideal_robot, 'joint1', 'base_flexibility', 4.3, 0.35, 0.03)
    again = null_run(driven_motion(robot, gains), robot)
    with_it, without = (rms_left(again, plant.constants_of(one))[0]
                        for one in (robot, ideal_robot))
    assert with_it < 0.1 * without


def test_a_joint_that_turns_with_its_base_has_no_viscous_friction(ideal_robot):
    constants, work = plant.constants_of(ideal_robot), plant.workspace(2)
    still, turning = plant.init(ideal_robot), plant.init(ideal_robot)
    turning.dq_link[:] = turning.base_rate[:] = 0.7
    torques = []
    for state in (still, turning):
        plant.friction(state, constants, work)
        torques.append(work.friction.copy())
    np.testing.assert_array_equal(*torques)


def test_the_base_bends_under_the_torque_that_is_given(ideal_robot, gains):
    """Not under that which was asked for, where the model knows the difference."""
    both = (effect_on('joint1', 'base_flexibility', 6.0, 1.0, 0.05),
            effect_on('joint1', 'torque_gain', 0.25))
    left = []
    for effects in (both[:1], both):
        robot = replace(ideal_robot, effects=effects)
        motion = driven_motion(robot, gains)
        left += [rms_left(one, plant.constants_of(robot))[0]
                 for one in (motion, null_run(motion, robot))]
    assert max(left) < 1.5 * left[0]


def test_a_late_encoder_is_cleared_where_its_motor_is_quick(ideal_robot):
    """At 12 Hz 3 ms are a fifth of a radian: their square is no trifle."""
    delay, speed = 3e-3, 2.0 * np.pi * 12.0
    time = np.arange(2000) * 1e-3
    true = np.stack([np.zeros_like(time), 0.1 * np.sin(speed * time)], axis=1)
    late = true.copy()
    late[:, 1] = 0.1 * np.sin(speed * (time - delay))
    robot = replace(ideal_robot, effects=tuple(effect_on(joint, 'encoder_skew', delay)
                                               for joint in ideal_robot.joints))
    motion = motion_along(robot, time, np.repeat(late[:, :, None], 2, axis=2), np.zeros((2000, 2)))
    constants = plant.constants_of(robot)
    states, second, _ = cleared(motion, drive_torque(motion, constants), motion.states,
                                motion.second, constants)
    inner = slice(20, -20)
    angle = true[::motion.factor][inner, 1]
    assert states[inner, 3, 0] == pytest.approx(angle, abs=0.02 * 0.1)
    read = motion.second[inner, 1, 0]
    bend = angle * np.dot(read, read) ** 0.5 / np.dot(angle, angle) ** 0.5 * -1.0
    largest = np.abs(bend).max()
    assert np.abs(read - bend).max() > 0.2 * largest
    assert second[inner, 1, 0] == pytest.approx(bend, abs=0.03 * largest)
