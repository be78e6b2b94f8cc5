# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Motions made of recordings, the equations along them, and null simulations of both."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from bench.hidden_robots.plants import draw_belief, draw_robot
from core_runs import affected, effect_on, padded, single_axis
from discrepancy_runs import (
    as_believed,
    driven_motion,
    FRICTIONLESS,
    motion_along,
    null_run,
    rms_left,
)
from gms_flex_control.data.recording import Recording, resample_held
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import make_motion, motion_of, standing
from gms_flex_control.discrepancy.residuals import cleared, drive_torque, unexplained
from gms_flex_control.discrepancy.result import COMPLETE, FOUND
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.dynamics import chain
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import FrictionParams, StribeckParams
from gms_flex_control.simulation import plant
from gms_flex_control.simulation.loop import SteppedPlant
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

TICK, TICKS = 1e-4, 20  # of the plant [s]; of a sample, as a rule


@pytest.mark.parametrize(('period', 'factor'), [(4e-3, 1), (2e-3, 2), (1e-3, 4)])
def test_a_held_torque_and_the_second_difference_of_the_angle_agree_exactly(period, factor):
    """Under torques held over samples a free axis moves on parabolas; nothing is left of them."""
    rng, inertia = np.random.default_rng(0), 0.02
    command = rng.standard_normal((2000, 1))
    rate = np.concatenate([[0.0], np.cumsum(command[:-1, 0])]) * period / inertia
    step = rate * period + 0.5 * command[:, 0] * period ** 2 / inertia
    angle = np.concatenate([[0.0], np.cumsum(step[:-1])])
    robot = single_axis(FRICTIONLESS, inertia)
    motion = motion_along(robot, np.arange(2000) * period, angle[:, None], command)
    assert motion.factor == factor
    left = unexplained(motion, plant.constants_of(robot))[4:-4]
    np.testing.assert_allclose(left, 0.0, atol=1e-13 * np.ptp(angle) * inertia / period ** 2)
    assert np.abs(motion.drive[4:-4]).max() > 0.5
    heavier = unexplained(motion, plant.constants_of(single_axis(FRICTIONLESS, 1.5 * inertia)))
    np.testing.assert_allclose(heavier[4:-4, 0], 0.5 * motion.drive[4:-4, 0], atol=1e-6)


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


def test_the_mean_of_what_was_held_is_that_of_a_fine_grid():
    rng = np.random.default_rng(0)
    since = np.cumsum(rng.integers(10, 31, 400)) * 1e-4
    torque = rng.standard_normal((400, 2))
    time = since[0] + 2e-3 * np.arange(int((since[-1] - since[0]) / 2e-3) + 1)
    mean = resample_held(torque, since, time, 2e-3)
    fine = time[:, None] + (np.arange(20) + 0.5) * 1e-4
    held = torque[np.searchsorted(since, fine, side='right') - 1]
    assert mean == pytest.approx(held.mean(axis=1), abs=1e-9)


def uneven_recording(robot, reference, seed):
    """Return a Recording of a robot that is read and driven every 1.6 to 2.4 ms, as stamped."""
    rng = np.random.default_rng(seed)
    driven, now = SteppedPlant(robot, period=TICK, substeps=2, seed=seed), 0
    driven.measure()
    time, angles, commands = [], [], []
    while now * TICK < 12.0:
        time.append(now * TICK)
        q_motor, rate = driven.measured.q_motor.copy(), driven.state.dq_motor
        angles.append((driven.measured.q_link.copy(), q_motor))
        command = 8.0 * (reference(time[-1]) - q_motor) - 0.2 * rate
        commands.append(command)
        for _ in range(rng.integers(TICKS - 4, TICKS + 5)):
            driven.advance(command)
            now += 1
    q_link, q_motor = np.moveaxis(np.array(angles), 1, 0)
    return Recording(joints=robot.joints, time=np.array(time), q_link=q_link, q_motor=q_motor,
                     command=np.array(commands), source='uneven')


def tones(time):
    """Return angles (2,) of tones of some speeds [rad]."""
    return np.array([0.5 * np.sin(1.9 * time) + 0.2 * np.sin(5.3 * time),
                     0.4 * np.sin(2.7 * time + 1.0) + 0.15 * np.sin(7.1 * time)])


@pytest.mark.parametrize(('plant_kind', 'effects'), [
    ('soft', ()),
    ('stiff', (effect_on('joint2', 'motor_coulomb', 0.02),))])
def test_uneven_samples_with_true_stamps_are_no_effect(plant_kind, effects):
    """Torque changes where it was stamped, up to a fifth of a sample beside an even grid."""
    rng = np.random.default_rng(4)
    robot, _ = draw_robot(rng, plant_kind)
    nominal = draw_belief(rng, robot)
    recording = uneven_recording(replace(robot, effects=effects), tones, 3)
    result = find_discrepancy([recording], nominal, SearchOptions(most=2))
    assert result.verdict == (FOUND if effects else COMPLETE), result.words
    assert [(one.effect, one.joint) for one in result.named] == [spec.key for spec in effects]
    for one, spec in zip(result.named, effects, strict=True):
        assert one.values[0].value == pytest.approx(spec.values[0], rel=0.05)


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


def test_a_null_simulation_belongs_to_its_model_whatever_the_recording_held(ideal_robot, gains):
    """The recording holds backlash and a tenth of friction as bias; the simulated one neither."""
    effects = (effect_on('joint1', 'backlash', 0.005),
               effect_on('joint2', 'motor_torque_bias', 0.01))
    motion = driven_motion(replace(ideal_robot, effects=effects), gains)
    again = null_run(motion, ideal_robot)
    before, after = (rms_left(one, plant.constants_of(ideal_robot)) for one in (motion, again))
    assert before[0] > 3e-3 and before[3] > 9e-3
    assert np.all(after < 0.1 * before.max())
    assert np.abs(again.samples.readings - motion.samples.readings)[:, 1].max() < 0.02
    assert np.ptp(motion.samples.readings[:, 1], axis=0).min() > 0.4


@pytest.mark.parametrize('delay', [9.5e-3, -4e-3])
def test_a_null_simulation_is_recorded_as_wrongly_as_its_model_says(ideal_robot, gains, delay):
    """By samples: what its torques leave, taken as they acted, is its encoders' alone."""
    late = affected(ideal_robot, 'arm', 'recording_delay', delay)
    likelihood = Likelihood([driven_motion(ideal_robot, gains)], ideal_robot)
    x = np.zeros(len(likelihood.nuisances))
    static = np.tile(ideal_robot.friction.forward.static, 2)
    runs = likelihood.null_simulations(late, x)([np.random.default_rng(0)])
    left, as_stamped = (np.sqrt(np.mean(uniform_filter1d(likelihood.unexplained(
        runs, robot, x)[0][50:-50], 10, axis=0) ** 2, axis=0)) for robot in (late, ideal_robot))
    assert np.all(left < 0.02 * static)
    assert np.all(left[2:] < 0.1 * as_stamped[2:])


@pytest.mark.parametrize('inertia', [0.11, 0.01, 0.0])
def test_a_rigid_axis_is_held_on_its_motion_wherever_its_inertia_stands(inertia):
    """Of link or rotor; friction is believed a fifth too small."""
    friction = StribeckParams(coulomb=[0.1], static=[0.1], velocity=[0.1], viscous=[0.0])
    friction = FrictionParams(forward=friction, backward=friction, stiffness=[[50.0]],
                              weight=[[1.0]], attraction=[50.0])
    robot = single_axis(friction, inertia, motor_inertia=0.11 - inertia)
    time = np.arange(2500)[:, None] * 2e-3
    angle = 0.3 * np.sin(np.pi * time)
    command = 0.125 * np.sign(np.cos(np.pi * time)) - 0.11 * np.pi ** 2 * angle
    motion = motion_along(robot, time[:, 0], angle, command)
    again = null_run(motion, robot)
    assert np.abs(again.samples.readings - motion.samples.readings).max() < 1e-3


def test_links_that_carry_a_heavy_one_are_held_at_100_hz(ideal_robot):
    """What holds a joint while the other gives way is a fiftieth of its inertia at 0."""
    arm = ArmParams(kind='planar', mass=[0.2, 10.0], length=[0.5, 0.0], com=[0.25, 0.5],
                    inertia=[0.01, 0.01], motor_inertia=[0.02, 0.02], stiffness=[np.inf] * 2,
                    damping=[0.0, 0.0], gravity=0.0)
    robot = rigid_joints(('shoulder', 'elbow'))
    blocks = ideal_robot.friction.stiffness.shape[1]  # compiled for those already
    robot = replace(robot, arm=arm, friction=padded(robot.friction, blocks))
    time = np.arange(1000) * 0.01
    turns, size = 2.0 * np.pi * np.array([0.3, 0.5]), np.array([0.4, 0.3])
    q, dq, ddq = (size * turns ** k * np.sin(np.outer(time, turns) + 0.5 * np.pi * k)
                  for k in range(3))
    mass = chain.mass_matrices(q, arm)
    ratio = np.einsum('kjj,kjj->kj', mass, np.linalg.inv(mass))
    assert ratio.max() > 50.0
    command = chain.inverse_dynamics(q, dq, ddq, arm) + np.tanh(dq / 0.01)
    motion = motion_along(robot, time, q, command)
    again = null_run(motion, robot)
    assert np.abs(again.samples.readings - motion.samples.readings).max() < 0.05


@pytest.mark.parametrize(('seed', 'gravity'), [(7, True), (10, False)])
def test_a_null_simulation_stands_where_the_recording_stood(seed, gravity):
    """Under a weight that makes it fall otherwise, and where a soft spring would let it creep."""
    case = make_case('clean', seed, gravity=gravity, duration=20.0)
    motion, robot = motion_of(case.recording, case.truth.robot), case.truth.robot
    again = null_run(motion, case.nominal)
    assert np.abs(again.states - motion.states)[:, [0, 3]].max() < 0.02
    assert motion.standing[motion.time > 1.0].mean() > 0.01
    standing = motion.standing & again.standing
    assert standing.sum() > 0.5 * motion.standing.sum()
    alike = [Likelihood([motion], robot, seed) for seed in range(2)]
    level = np.mean([np.mean(as_believed(one).whitened ** 2) for one in alike])
    assert level == pytest.approx(np.mean([np.mean(one.clean ** 2) for one in alike]), rel=0.1)
