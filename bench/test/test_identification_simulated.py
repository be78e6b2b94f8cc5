# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
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
    assert np.all((np.abs(recording.q_link) < PLAN.limits.upper)[:, :])
    for phase, part, j in parts((recording, phases), 'presliding'):
        weaker = min(true.friction.forward.static[j], true.friction.backward.static[j])
        if '0.04695' in phase.step or '0.04262' in phase.step:
            assert 0.2 < phase.value / weaker < 0.85
            assert np.ptp(recording.q_link[part, j]) < 0.05
        assert np.ptp(recording.q_link[part, j]) < 0.3


def test_torque_noise_is_recorded_but_does_not_act():
    quiet, noisy = (simulate_identification(PLAN, ROBOT, GAINS, 5, rate=500, torque_noise=noise)[0]
                    for noise in (0.0, 1e-3))
    assert np.array_equal(quiet.q_link, noisy.q_link)
    assert np.std(noisy.tau_motor - quiet.tau_motor) == pytest.approx(1e-3, rel=0.02)
    assert np.all(np.abs(quiet.command) <= PLAN.limits.torque)
    assert np.allclose(quiet.tau_motor[1:], quiet.command[:-1])
