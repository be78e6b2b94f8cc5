# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Null simulations: a recording's motion as the model would have made it."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from core_runs import affected, effect_on, padded, single_axis
from discrepancy_runs import as_believed, driven_motion, motion_along, null_run, rms_left
from gms_flex_control.discrepancy.likelihood import Likelihood
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.dynamics import chain
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import FrictionParams, StribeckParams
from gms_flex_control.simulation import plant
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d


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
