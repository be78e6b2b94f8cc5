# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The identification experiment in one process shows the friction that it is to identify."""

from dataclasses import replace
from pathlib import Path

from bench.identification_simulated import read_identification_plan, simulate_identification
from gms_flex_control.experiment.simulated import scaled_friction
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np
import pytest

CONFIG = Path(__file__).parents[2] / 'config'
DEMO = CONFIG.parent / 'bench' / 'demos' / 'identification.yaml'
ROBOT = load_robot(CONFIG / 'robot.yaml')
GAINS = load_controller(CONFIG / 'controller.yaml', ROBOT)
PLAN = read_identification_plan([DEMO], ROBOT, GAINS)
K = 1.5  # N m/rad, of both springs


@pytest.fixture(scope='module')
def experiment():
    return simulate_identification(PLAN, ROBOT, GAINS, 3)


def parts(experiment, phase):
    """Yield each Phase of a kind with its samples (slice) and joint number."""
    recording, phases = experiment
    for now, after in zip(phases, phases[1:], strict=False):
        if now.phase == phase and 'relax' not in now.step and 'approach' not in now.step:
            begin, end = np.searchsorted(recording.time, [now.time_ns * 1e-9,
                                                          after.time_ns * 1e-9])
            yield now, slice(begin, end), recording.joints.index(now.joint)


def elastic_torque(recording, j):
    return K * (recording.q_motor[:, j] - recording.q_link[:, j])


def test_phases_are_the_steps_of_the_plan_and_their_time_is_that_of_the_recording(experiment):
    recording, phases = experiment
    assert [phase.step for phase in phases[:-1]] == [step.name for step in PLAN.steps()]
    assert phases[-1].phase == 'idle' and phases[0].time_ns == 0
    times = np.array([phase.time_ns for phase in phases]) * 1e-9
    assert np.all(np.diff(times) > 0) and times[-1] <= recording.time[-1] + 2e-3


@pytest.mark.parametrize('joint', ROBOT.joints)
def test_the_spring_carries_the_stribeck_curve_at_constant_velocity(experiment, joint):
    """Equation (6) from Table 1, against the mean elastic torque in the last half."""
    j, seen = ROBOT.joints.index(joint), 0
    for phase, part, number in parts(experiment, 'constant_velocity'):
        recording = experiment[0]
        held = np.flatnonzero(np.abs(recording.reference[part, 1, j] - phase.value) < 1e-9)
        if number != j or abs(phase.value) < 0.04:
            continue
        late = part.start + held[len(held) // 2:]
        v = np.polyfit(recording.time[late], recording.q_link[late, j], 1)[0]
        steady = getattr(ROBOT.friction, 'forward' if v > 0 else 'backward')
        level = steady.coulomb[j] + (steady.static[j] - steady.coulomb[j]) * np.exp(
            -(v / steady.velocity[j]) ** 2)
        expected = np.sign(v) * level + steady.viscous[j] * v
        assert elastic_torque(recording, j)[late].mean() == pytest.approx(expected, rel=0.05)
        seen += 1
    assert seen >= 8


def test_break_away_stops_soon_after_it_has_broken_away(experiment):
    found = list(parts(experiment, 'break_away'))
    assert len(found) == 4
    for phase, part, j in found:
        moved = np.sign(phase.value) * (experiment[0].q_link[part, j]
                                        - experiment[0].q_link[part.start, j])
        assert 0.03 < moved.max() < 0.2
        gone = part.start + np.argmax(moved > 0.03)
        peak = np.abs(elastic_torque(experiment[0], j)[part.start:gone]).max()
        assert 0.6 < peak / abs(phase.value) < 1.1


def test_springs_are_unloaded_before_a_torque_and_presliding_stays_small(experiment):
    recording, _ = experiment
    for kind in ('presliding', 'break_away'):
        for _, part, j in parts(experiment, kind):
            assert abs(elastic_torque(recording, j)[part.start]) < 0.01
    for phase, part, j in parts(experiment, 'presliding'):
        assert np.ptp(recording.q_link[part, j]) < 0.02
        assert np.abs(elastic_torque(recording, j)[part]).max() < phase.value + 0.015
        pushed = np.isnan(recording.reference[part, 0, j])  # the braking after it moves all joints
        others = np.delete(recording.q_link[part][pushed], j, axis=1)
        assert np.ptp(others) < 2e-3


@pytest.mark.parametrize('factor', [0.4, 2.5])
def test_wrong_beliefs_of_friction_change_the_amplitudes_and_keep_the_range(factor):
    """The first presliding step stays presliding and is not much too small either."""
    true = replace(ROBOT, friction=scaled_friction(ROBOT.friction, factor))
    recording, phases = simulate_identification(PLAN, true, GAINS, 3, model=ROBOT, rate=500)
    assert np.all((np.abs(recording.q_link) < PLAN.upper)[:, :])
    for phase, part, j in parts((recording, phases), 'presliding'):
        weaker = min(true.friction.forward.static[j], true.friction.backward.static[j])
        if '0.04695' in phase.step or '0.04262' in phase.step:
            assert 0.2 < phase.value / weaker < 0.85
            assert np.ptp(recording.q_link[part, j]) < 0.05
        assert np.ptp(recording.q_link[part, j]) < 0.3


def test_a_rigid_axis_is_identified_by_its_own_torque():
    """No motor side: what is recorded is the torque on the joint."""
    arm = replace(ROBOT.arm, stiffness=np.full(2, np.inf))
    rigid = replace(ROBOT, arm=arm, motors=('', ''))
    plan = read_identification_plan([DEMO], rigid, GAINS, overrides={
        'identification.joints': ['joint2'],
        'identification.experiments': ['constant_velocity', 'break_away']})
    recording, phases = simulate_identification(plan, rigid, GAINS, 1)
    assert np.isnan(recording.q_motor).all() and np.isfinite(recording.tau_motor).all()
    for phase, part, j in parts((recording, phases), 'constant_velocity'):
        if phase.value > 0.2:
            held = np.abs(recording.reference[part, 1, j] - phase.value) < 1e-9
            late = part.start + np.flatnonzero(held)[held.sum() // 2:]
            expected = 0.09087 + 0.00374 * phase.value
            assert recording.tau_motor[late, j].mean() == pytest.approx(expected, rel=0.06)


def test_torque_noise_is_recorded_but_does_not_act():
    quiet, noisy = (simulate_identification(PLAN, ROBOT, GAINS, 5, rate=500, torque_noise=noise)[0]
                    for noise in (0.0, 1e-3))
    assert np.array_equal(quiet.q_link, noisy.q_link)
    assert np.std(noisy.tau_motor - quiet.tau_motor) == pytest.approx(1e-3, rel=0.02)
    assert np.all(np.abs(quiet.command) <= PLAN.torque)
    assert np.allclose(quiet.tau_motor[1:], quiet.command[:-1])
