# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Arms in space in which something is hidden: how they move, and how answers are judged."""

from pathlib import Path
from types import SimpleNamespace

from bench.hidden_arms.hidden_arms import (
    case_of,
    Job,
    judged,
    keep,
    kept,
    Outcome,
    truth_of,
    try_job,
)
from bench.hidden_arms.plant import Hidden, recording_of
from gms_flex_control.discrepancy.gap import free_runs
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.effects.table import with_changes
from gms_flex_control.identification.identify import identify
from gms_flex_control.schema.files import load_robot
from gms_flex_control.simulation import plant
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
GAIN, SLOPE = ('torque_gain', 'joint2'), ('viscous_error', 'joint3')


def answer(*keys, alike=()):
    """Return findings of an answer."""
    return [SimpleNamespace(key=key, indistinguishable_from=alike) for key in keys]


@pytest.mark.parametrize('kind, truth, verdict, findings, right, wrong', [
    ('single', [GAIN], 'found', answer(GAIN, SLOPE), True, False),
    ('single', [GAIN], 'found', answer(SLOPE, GAIN), False, True),
    ('single', [GAIN], 'found', answer(SLOPE, alike=(GAIN,)), False, False),
    ('single', [GAIN], 'unexplained', answer(), False, False),
    ('single', [], 'complete', answer(), True, False),  # friction that was identified
    ('single', [], 'found', answer(SLOPE), False, True),
    ('double', [GAIN, SLOPE], 'found', answer(SLOPE, GAIN), True, False),
    ('double', [GAIN, SLOPE], 'found', answer(SLOPE), False, False),
    ('clean', [], 'complete', answer(), True, False),
    ('clean', [], 'unexplained', answer(), False, False),
    ('outside', [], 'unexplained', answer(), True, False),
    ('outside', [], 'found', answer(SLOPE), False, True),
])
def test_an_answer_is_judged_by_what_was_hidden(kind, truth, verdict, findings, right, wrong):
    assert judged(kind, truth, verdict, findings) == (right, wrong)


def test_the_true_robot_runs_as_mujoco_moves_it():
    """Two effects in MuJoCo and the same two in the model: free runs stay at the noise."""
    case = case_of(Job('industrial', 'double', 1, 4.0))
    assert len(case.hidden) == 2
    motion = motion_of(case.recording, case.believed)

    def error(robot):
        _, _, motor = free_runs(motion, plant.constants_of(robot))
        return np.sqrt(np.mean(motor ** 2))
    assert error(case.true) < 0.2 * error(case.believed)


@pytest.mark.parametrize('joint', ['joint2', 'joint5'])  # on a spring, rigid
@pytest.mark.parametrize('name, values', [
    ('load_friction', {'ratio': 0.1, 'reach': 1e-3}),
    ('position_friction', {'ratio': 0.5, 'order': 2.0, 'phase': 1.0}),
    ('torque_ripple', {'amplitude': 3.0, 'order': 8.0, 'phase': 1.0}),
    ('torque_gain', {'gain_error': 0.1}), ('constant_link_torque', {'bias': 3.0}),
    ('quadratic_drag', {'drag': 10.0}), ('input_delay', {'delay': 5e-3})])
def test_an_effect_in_mujoco_is_that_of_the_catalogue(name, values, joint):
    case = case_of(Job('light', 'clean', 5, 1.0))
    hidden = Hidden(name=name, joint=joint, values=values)
    recording = recording_of(case.true, case.believed, [hidden], seconds=6.0, noise=0.0,
                             motors_only=False, seed=5)
    motion, free = motion_of(recording, case.believed), []
    for robot in (case.true, truth_of(case.true, [hidden])):
        _, link, _ = free_runs(motion, plant.constants_of(robot))
        free.append(np.sqrt(np.mean(link ** 2)))
    assert free[1] < 0.2 * free[0]


def test_friction_by_load_of_a_rigid_wrist_is_no_torque_constant():
    outcome = try_job(Job('light', 'single', 7100, 20.0))
    assert outcome.hidden.startswith('load_friction joint5')
    assert outcome.right and outcome.free_ratio < 0.1


def test_friction_of_a_heavy_arm_is_not_lost_in_noise_of_accelerations_that_are_computed():
    """Noise of a drive moves the link that is computed with it."""
    robot = load_robot(ROOT / 'examples' / 'industrial_arm' / 'robot.yaml')
    found = identify([recording_of(robot, robot, seconds=20.0, noise=0.06, motors_only=True,
                                   seed=7601)], robot)
    for side in ('forward', 'backward'):
        own, true = (getattr(one.friction, side).coulomb for one in (found.robot, robot))
        assert own == pytest.approx(true, rel=0.05)


def test_effects_that_are_parameters_change_the_robot():
    believed = case_of(Job('light', 'clean', 0, 1.0)).believed
    true = truth_of(believed, (
        Hidden(name='link_inertia_error', joint='joint3', values={'ratio': 0.2}),
        Hidden(name='torque_gain', joint='joint1', values={'gain_error': 0.1})))
    assert [one.key for one in true.effects] == [('torque_gain', 'joint1')]
    assert with_changes(true).arm.mass[2] == pytest.approx(1.2 * believed.arm.mass[2])


def test_outcomes_are_read_back_by_job(tmp_path):
    found = {Job('light', 'single', 3, 20.0): Outcome(
        'backlash joint2', False, 0.01, 'found', True, False, 0.2, float('nan'), 31.0, 500.0)}
    keep(tmp_path / 'out.json', found)
    (job, outcome), = kept(tmp_path / 'out.json').items()
    assert job in found and outcome[:7] == found[job][:7] and outcome.took == 31.0
    assert kept(tmp_path / 'none.json') == kept(None) == {}
