# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the search for what is missing makes of samples that are uneven, or read late."""

from dataclasses import replace

from gms_flex_control.discrepancy.path import make_path, mean_held
from gms_flex_control.discrepancy.residuals import corrected, drive_torque
from gms_flex_control.discrepancy.result import COMPLETE, FOUND
from gms_flex_control.discrepancy.workflow import discrepancy
from gms_flex_control.hidden.plants import draw_belief, draw_robot
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.recording import Recording
from gms_flex_control.simulation import plant
from gms_flex_control.simulation.stepped import SteppedPlant
import numpy as np
import pytest

TICK, TICKS = 1e-4, 20  # of the plant [s]; of a sample, as a rule


def uneven_recording(robot, reference, seed):
    """Return a Recording of a robot that is read and driven every 1.6 to 2.4 ms, as stamped."""
    rng = np.random.default_rng(seed)
    driven, now = SteppedPlant(robot, period=TICK, substeps=2, seed=seed), 0
    driven.measure()
    time, angles, commands = [], [], []
    while now * TICK < 20.0:
        time.append(now * TICK)
        q_motor, rate = driven.measured.q_motor.copy(), driven.state.dq_motor
        angles.append((driven.measured.q_link.copy(), q_motor))
        command = 8.0 * (reference(time[-1]) - q_motor) - 0.2 * rate
        commands.append(command)
        for _ in range(rng.integers(TICKS - 4, TICKS + 5)):
            driven.advance(command)
            now += 1
    q_link, q_motor = np.moveaxis(np.array(angles), 1, 0)
    unknown = np.full_like(q_link, np.nan)
    return Recording(
        joints=robot.joints, time=np.array(time), q_link=q_link, q_motor=q_motor,
        dq_link=unknown, dq_motor=unknown, tau_motor=unknown, command=np.array(commands),
        reference=np.full((len(time), 5, robot.n_joints), np.nan), friction_hat=unknown,
        source='uneven')


def tones(time):
    """Return angles (2,) of tones of some speeds [rad]."""
    return np.array([0.5 * np.sin(1.9 * time) + 0.2 * np.sin(5.3 * time),
                     0.4 * np.sin(2.7 * time + 1.0) + 0.15 * np.sin(7.1 * time)])


def test_the_mean_of_what_was_held_is_that_of_a_fine_grid():
    rng = np.random.default_rng(0)
    since = np.cumsum(rng.integers(10, 31, 400)) * 1e-4
    torque = rng.standard_normal((400, 2))
    time = since[0] + 2e-3 * np.arange(int((since[-1] - since[0]) / 2e-3) + 1)
    mean = mean_held(torque, since, time, 2e-3)
    fine = time[:, None] + (np.arange(20) + 0.5) * 1e-4
    held = torque[np.searchsorted(since, fine, side='right') - 1]
    assert mean == pytest.approx(held.mean(axis=1), abs=1e-9)


@pytest.mark.parametrize(('plant_kind', 'effects'), [
    ('stiff', ()), ('soft', ()),
    ('stiff', (EffectSpec(name='motor_coulomb', joint='joint2', values=(0.02,)),))])
def test_uneven_samples_with_true_stamps_are_no_effect(plant_kind, effects):
    """Torque changes where it was stamped, up to a fifth of a sample beside an even grid."""
    rng = np.random.default_rng(4)
    robot, _ = draw_robot(rng, plant_kind)
    nominal = draw_belief(rng, robot)
    result = discrepancy([uneven_recording(replace(robot, effects=effects), tones, 3)], nominal)
    assert result.verdict == (FOUND if effects else COMPLETE), result.words
    assert [(one.effect, one.joint) for one in result.named] == [
        (spec.name, spec.joint) for spec in effects]
    for one, spec in zip(result.named, effects, strict=True):
        assert one.values[0].value == pytest.approx(spec.values[0], rel=0.05)


def test_a_late_encoder_is_cleared_where_its_motor_is_quick(ideal_robot):
    """At 12 Hz 3 ms are a fifth of a radian: their square is no trifle."""
    delay, speed = 3e-3, 2.0 * np.pi * 12.0
    time = np.arange(2000) * 1e-3
    true = np.stack([np.zeros_like(time), 0.1 * np.sin(speed * time)], axis=1)
    late = true.copy()
    late[:, 1] = 0.1 * np.sin(speed * (time - delay))
    robot = replace(ideal_robot, effects=tuple(
        EffectSpec(name='encoder_skew', joint=joint, values=(delay,))
        for joint in ideal_robot.joints))
    readings = np.repeat(late[:, :, None], robot.n_joints, axis=2)
    path = make_path(robot.joints, time, 1e-3, readings, np.zeros((2000, robot.n_joints)),
                     np.zeros(2000), True, 'a tone')
    constants, work = plant.constants_of(robot), plant.workspace(robot.n_joints)
    drive = drive_torque(path, constants, work)
    motion, second = corrected(path, drive, path.motion, path.second, constants, work)
    inner = slice(20, -20)
    angle = true[::path.factor][inner, 1]
    assert motion[inner, 3, 0] == pytest.approx(angle, abs=0.02 * 0.1)
    read = path.second[inner, 1, 0]
    bend = angle * np.dot(read, read) ** 0.5 / np.dot(angle, angle) ** 0.5 * -1.0
    largest = np.abs(bend).max()
    assert np.abs(read - bend).max() > 0.2 * largest
    assert second[inner, 1, 0] == pytest.approx(bend, abs=0.03 * largest)
