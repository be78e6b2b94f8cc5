# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Populations of hidden robots: each is what its row says, and home is what it was before."""

from dataclasses import replace
from functools import cache

from bench.__main__ import main
from bench.chain_matrices import matrices
from bench.hidden_robots import motions, mujoco_plant, plants, sizes, truth
from bench.hidden_robots.cases import make_case
from bench.hidden_robots.populations import belief_errors, POPULATIONS
from gms_flex_control.data.reader import read_recording
import numpy as np
import pytest

TIME = np.arange(10000) * 2e-3
needs_mujoco = pytest.mark.skipif(not mujoco_plant.available(), reason='mujoco is not installed')


@cache
def drawn(population, kind='single', seed=1):
    return make_case(kind, seed, population=population, duration=8.0)


@pytest.mark.parametrize('name', [name for name in POPULATIONS if name != 'mujoco']
                         + [pytest.param('mujoco', marks=needs_mujoco)])
def test_a_population_is_what_its_row_says(name):
    """And the robot with the same thing hidden in it is the one at home."""
    row, case, home = POPULATIONS[name], drawn(name), drawn('home')
    recording = case.recording
    assert case.truth.population == name
    assert np.diff(recording.time) == pytest.approx(1.0 / row.rate)
    assert np.isfinite(recording.q_link).all() == row.links_seen
    assert np.isfinite(recording.q_motor).all() and np.isfinite(recording.command).all()
    encoder = case.nominal.encoder
    assert encoder.counts == (row.counts or home.nominal.encoder.counts)
    assert 0.0999 < encoder.noise * encoder.counts / (2.0 * np.pi) < 0.5001
    assert (case.gains is None) == (row.drive is truth.under_pid)
    assert np.any(case.nominal.arm.gravity) == row.gravity
    np.testing.assert_array_equal(case.truth.robot.arm.stiffness,
                                  home.truth.robot.arm.stiffness)
    assert [spec.name for spec in case.truth.effects] == [
        spec.name for spec in home.truth.effects]
    np.testing.assert_allclose(
        case.truth.torque_noise, row.noise * np.mean(
            [side.static for side in (case.truth.robot.friction.forward,
                                      case.truth.robot.friction.backward)], axis=0))


@pytest.mark.parametrize(('name', 'low', 'high'), [('beliefs_3', 0.03, 0.09),
                                                   ('beliefs_10', 0.1, 0.3)])
def test_what_is_believed_is_far_off_and_physical(name, low, high):
    """Either way, of robots that can be: every mass matrix positive, F_s above F_c."""
    signs = []
    for seed in range(40):
        robot, _ = plants.draw_robot(np.random.default_rng(seed), 'soft')
        belief = plants.draw_belief(np.random.default_rng([1, seed]), robot,
                                    POPULATIONS[name].beliefs)
        for kind, error in belief_errors(robot, belief).items():
            if kind not in ('level', 'static', 'viscous', 'velocity', 'asymmetry',
                            'viscous_asymmetry'):
                off = np.abs(1.0 / (1.0 + error) - 1.0)
                assert np.all((off > low - 1e-9) & (off < high + 1e-9)), kind
        signs += np.sign(belief_errors(robot, belief)['stiffness']).tolist()
        for q in np.linspace(-np.pi, np.pi, 9):
            zero = np.zeros(2)
            mass = matrices(np.array([0.0, q]), zero, zero, zero, belief.arm).mass
            assert np.linalg.eigvalsh(mass).min() > 0.0
        for side in (belief.friction.forward, belief.friction.backward):
            assert np.all(side.static >= side.coulomb) and np.all(side.viscous > 0.0)
    assert abs(np.mean(signs)) < 0.35


def test_pid_follows_without_a_model_of_friction(tmp_path):
    """Its motors are where they are asked to be; hide writes no gains of the cascade."""
    rng = np.random.default_rng(3)
    robot, gains = plants.draw_robot(rng, 'stiff')
    reference = motions.draw_reference(rng, 'rich', 'stiff', TIME)
    run = truth.simulate(robot, robot, gains, reference, drive=truth.under_pid)
    assert sizes.rms(run.true[:, 0] - reference[:, 0]).max() < 0.05
    assert np.isnan(run.friction_hat).all()
    args = ['hide', '--out', str(tmp_path), '--kind', 'clean', '--population', 'pid',
            '--duration', '8']
    assert main(args) == 0
    folder = tmp_path / 'clean_0_pid'
    assert not (folder / 'controller.yaml').exists() and (folder / 'robot.yaml').exists()
    assert np.isfinite(read_recording(folder / 'bag').command).any()


@needs_mujoco
@pytest.mark.parametrize(('plant', 'tilted', 'near'), [('soft', True, 2e-4),
                                                       ('stiff', False, 1e-5)])
def test_mujoco_moves_the_hidden_robot_alike(plant, tilted, near):
    """At steps of 0.1 ms: within 0.2 or 0.01 mrad over 1 s, less than what is hidden."""
    rng = np.random.default_rng(1)
    robot, gains = plants.draw_robot(rng, plant)
    if tilted:
        robot, gains = plants.under_gravity(rng, robot, gains)
    robot = replace(robot, encoder=replace(robot.encoder, counts=0.0, noise=0.0))
    reference = motions.draw_reference(rng, 'rich', plant, TIME)[:500]
    bare = truth.simulate(robot, robot, gains, reference)
    spec = sizes.spec('backlash', 1, robot.joints, sizes.MAIN['backlash'](
        rng, sizes.figures_of(robot, bare, 2e-3)[1]))
    hidden = replace(robot, effects=(spec,))
    ours, theirs = (truth.simulate(hidden, robot, gains, reference, drive=drive)
                    for drive in (truth.under_cascade, mujoco_plant.under_cascade))
    assert np.abs(theirs.true - ours.true)[:, [0, 2]].max() < near
    assert np.abs(bare.true - ours.true)[:, [0, 2]].max() > 5.0 * near
