# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The benchmark: what it compares is the same, and its figures come out; no time is asserted."""

from dataclasses import replace
import json

from bench.__main__ import main
from bench.chain_matrices import matrices
from bench.speed import fit, mujoco_arm, numpy_identification, numpy_loop, ros_loop
from gms_flex_control.file_io import controller_file, robot_file
from gms_flex_control.params.robot import EncoderParams
from gms_flex_control.schema.files import load_controller, load_robot
from gms_flex_control.simulation import loop
from gms_flex_control.trajectory.builders import sinusoid
import numpy as np
import pytest


@pytest.fixture(scope='module')
def robot():
    return replace(load_robot(robot_file()), encoder=EncoderParams())


@pytest.fixture(scope='module')
def gains(robot):
    return load_controller(controller_file(), robot)


@pytest.mark.parametrize('compensation', ['none', 'gms_paper'])
@pytest.mark.parametrize(('period', 'limit'), [(1.0, 2.0), (6.0, 100.0)])
def test_plain_numpy_and_the_kernels_compute_the_same(robot, gains, compensation, period,
                                                      limit):
    """Two implementations of all equations, with reversals; a low torque limit saturates."""
    gains = replace(gains, compensation=compensation, torque_limit=[limit, limit])
    damped = replace(robot, arm=replace(robot.arm, damping=[0.02, 0.01], gravity=0.5))
    run = loop.run(damped, robot, gains, sinusoid([1.0, 0.7], period, ramp_time=0.2),
                   duration=0.7, period_ns=1_000_000, substeps=4)
    q, command = numpy_loop.run(damped, robot, gains, run.reference, 1e-3, 4)
    assert np.ptp(q, axis=0).min() > 0.05
    if limit == 2.0:
        assert np.any(np.abs(command) == limit)
    np.testing.assert_allclose(q, run.true[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(command, run.command, rtol=0, atol=1e-8)


def test_the_mechanism_in_mujoco_is_the_same(robot):
    """Same inertias at any angle, and without friction the same motion of the free springs."""
    pytest.importorskip('mujoco')
    q = np.array([0.4, -0.8])
    expected = np.diag([0.0, 0.0, *robot.arm.motor_inertia])
    expected[:2, :2] = matrices(q, *np.zeros((3, 2)), robot.arm).mass
    np.testing.assert_allclose(mujoco_arm.MujocoArm(robot, 1e-4).mass_matrix(q), expected,
                               atol=1e-9)
    slippery = robot.friction.each_way(lambda way: replace(
        way, static=[1e-9, 1e-9], coulomb=[1e-9, 1e-9], viscous=[0.02, 0.01]))
    free = replace(robot, friction=slippery)
    arm, command = mujoco_arm.MujocoArm(free, 1e-4), np.array([0.1, -0.05])
    arm.advance(command, 3000)
    ours = numpy_loop.NumpyPlant(free)
    ours.advance(command, 1e-4, 3000)
    np.testing.assert_allclose(arm.data.qpos, [*ours.q, *ours.q_motor], rtol=2e-3)


def test_the_plain_fit_has_the_same_cost_at_any_parameters_and_is_found_wanting(robot, gains):
    """The reference for speed computes what the kernels compute, encoders' intervals included."""
    counted = replace(robot, encoder=EncoderParams(counts=20000.0))
    axis, bundle = fit.simulated(counted, gains, {
        'identification.experiments': ('presliding',),
        'identification.presliding_levels': (0.8,)}, 125.0)
    case = fit.fit_presliding(bundle, axis)
    rng, floor = np.random.default_rng(1), 3e-6
    plain = numpy_identification.PlainObjective(bundle, case.objective, floor)
    for _ in range(3):
        free = case.start + 0.3 * rng.standard_normal(len(case.start))
        expected = case.objective.evaluate(case.coordinates, free, 1.0, floor).cost.sum()
        assert plain.cost(case.coordinates.unpack(free)[0]) == pytest.approx(expected, rel=1e-6)
    seconds, reference, times = fit.compare(case, 0.5, 1)
    assert 'samples of one joint' in seconds.note and 'evaluations' in reference.note
    assert times.value == pytest.approx(reference.value / seconds.value)


def test_the_command_prints_the_suites_asked_for(capsys):
    assert main(['speed', '--quick', '--only', 'step', 'tick', '--json']) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert {'step', 'tick'} == {m['suite'] for m in found}
    assert all(np.isfinite(m['value']) and m['value'] > 0 for m in found)


@pytest.mark.flaky(reruns=2)  # other processes of the machine can delay real nodes
def test_the_bridge_that_is_measured_answers():
    """In a fault it would send zeros now and then, which look like late answers."""
    pytest.importorskip('rclpy')
    timing, _ = ros_loop.run_bridge(200.0, 3.0)
    assert timing['lost'] < timing['samples'] / 2


@pytest.mark.flaky(reruns=2)  # likewise
@pytest.mark.parametrize('composed', [False, True])
def test_answers_to_the_simulated_robot_are_timed(composed):
    pytest.importorskip('rclpy')
    timing, _ = ros_loop.run_loop(200.0, 3.0, composed=composed)
    assert timing['lost'] < timing['samples'] / 2


def test_the_full_fit_finds_the_friction_that_was_simulated(robot, gains):
    axis, bundle = fit.simulated(robot, gains, {}, 250.0)
    case = fit.fit_everything(bundle, axis)
    found = case.coordinates.parameters(case.ours())[[1, 5]]
    sides = axis.friction.forward, axis.friction.backward
    assert found == pytest.approx([side.coulomb[0] for side in sides], rel=0.03)
