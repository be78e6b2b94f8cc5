# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Recordings made ready: torques as held, links that stand, samples that are uneven."""

from dataclasses import replace

from bench.hidden_robots.plants import draw_belief, draw_robot
from core_runs import effect_on, single_axis
from discrepancy_runs import FRICTIONLESS, motion_along
from gms_flex_control.data.recording import Recording, resample_held
from gms_flex_control.discrepancy.motion import standing
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.result import COMPLETE, FOUND
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.simulation import plant
from gms_flex_control.simulation.loop import SteppedPlant
import numpy as np
import pytest

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
