# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The plan of the identification experiment: complete, within its limits, or refused."""

from dataclasses import replace
from pathlib import Path

from bench.identification_simulated import read_identification_plan
from gms_flex_control.errors import ConfigError
from gms_flex_control.experiment import identification_plan
from gms_flex_control.experiment.identification_plan import require_space
from gms_flex_control.schema.files import load_controller, load_robot, read_values
import numpy as np
import pytest

pytestmark = pytest.mark.fast

CONFIG = Path(__file__).parents[1] / 'config'
ROBOT = load_robot(CONFIG / 'robot.yaml')
GAINS = load_controller(CONFIG / 'controller.yaml', ROBOT)
FILES = ('identification.yaml', '../bench/demos/identification.yaml')
COUNT = 2 * np.pi / 20000


def planned(name='identification.yaml', **overrides):
    """Return the plan of a file with keys changed, '__' for '.'."""
    changed = {f"identification.{key.replace('__', '.')}": value
               for key, value in overrides.items()}
    return read_identification_plan([CONFIG / name], ROBOT, GAINS, overrides=changed)


@pytest.fixture(scope='module', params=FILES)
def plan(request):
    return planned(request.param)


def motions(plan):
    """Yield step, joint number and sampled reference (T, 5, n) of every motion step."""
    for step in plan.experiments:
        if step.kind == 'motion':
            trajectory = plan.trajectory(step)
            time = np.linspace(0.0, trajectory.end, 3000)
            yield step, plan.joints.index(step.joint), trajectory.sample(time)


def test_every_motion_keeps_the_limits_of_its_joint(plan):
    for step, j, reference in motions(plan):
        q, dq, ddq = reference[:, 0, j], reference[:, 1, j], reference[:, 2, j]
        assert plan.limits.lower[j] < q.min() and q.max() < plan.limits.upper[j], step.name
        assert np.abs(dq).max() <= plan.limits.velocity[j] * 1.001, step.name
        assert np.abs(ddq).max() <= plan.limits.acceleration[j] * 1.001, step.name
        others = np.delete(reference, j, axis=2)
        assert np.all(others[:, 1:] == 0.0), step.name


def test_every_torque_keeps_the_limit_and_begins_and_ends_smoothly_at_zero(plan):
    for step in plan.experiments:
        if step.kind != 'torque':
            continue
        trajectory = plan.trajectory(step)
        torque = trajectory.sample(np.linspace(0.0, trajectory.end, 3000))
        assert trajectory.quantity == 'effort'
        assert np.all(np.abs(torque[:, 0]).max(axis=0) <= plan.limits.torque)
        assert np.abs(torque[:, 0]).max() == pytest.approx(abs(step.value), rel=1e-3)
        assert np.abs(torque[[0, -1], :3]).max() < 1e-9
        assert np.abs(np.diff(torque[:, 1], axis=0)).max() < 0.01  # no kink rings the motor


def test_there_are_as_many_velocities_per_direction_and_repeats_as_the_paper_has():
    plan = planned()
    for joint in plan.joints:
        values = [step.value for step in plan.experiments
                  if step.joint == joint and step.phase == 'constant_velocity']
        speeds, times = np.unique(values, return_counts=True)
        assert len(speeds) == 20 and np.all(times == 3)
        assert np.allclose(np.sort(-speeds[:10]), speeds[10:])
        ratios = speeds[11:] / speeds[10:-1]
        assert ratios == pytest.approx(np.full(9, ratios[0]))


def test_each_constant_velocity_is_held_and_covers_enough_encoder_counts(plan):
    slow = 0
    for step, j, reference in motions(plan):
        if step.phase != 'constant_velocity':
            continue
        held = np.abs(reference[:, 1, j] - step.value) < 1e-9
        assert held.sum() > 10
        last = np.flatnonzero(held)[[0, -1]]
        assert abs(np.diff(reference[last, 0, j])[0]) > 10 * COUNT
        before = abs(reference[last[0], 0, j] - reference[0, 0, j])
        slow += abs(step.value) < 0.1
        if abs(step.value) < 0.1:
            assert before > 0.3  # further than the softest block of the paper's slips after
    assert slow > 10


def test_sliding_never_reverses_and_reaches_the_stribeck_velocity(plan):
    for joint, velocity in zip(ROBOT.joints, (0.0067, 0.068), strict=True):
        slowest = np.inf
        for step, j, reference in motions(plan):
            if step.phase == 'sliding' and step.joint == joint:
                rate = np.sign(step.value) * reference[:, 1, j]
                assert rate.min() > -1e-12
                slowest = min(slowest, np.median(rate))
        assert slowest == pytest.approx(velocity, rel=0.1)


def test_names_are_unique_and_all_four_experiments_are_there(plan):
    names = [step.name for step in plan.steps()]
    assert len(set(names)) == len(names)
    for joint in plan.joints:
        assert {step.phase for step in plan.steps() if step.joint == joint} == {
            'approach', 'constant_velocity', 'break_away', 'presliding', 'sliding'}


def test_a_motion_begins_where_the_step_before_ended(plan):
    place = kind = None
    for step in plan.steps():
        if step.kind == 'motion':
            assert np.allclose(step.begin, place, rtol=0, atol=1e-9)
            assert np.allclose(plan.trajectory(step).sample(0.0)[0], step.begin, atol=1e-12)
        if step.kind in ('motion', 'approach'):
            place = step.end
        assert step.kind != 'torque' or kind == 'relax'
        kind = step.kind


def test_what_is_finished_is_left_out_and_the_rest_is_approached():
    plan = planned(FILES[1])
    names = [step.name for step in plan.experiments]
    half = plan.steps(finished=names[:21])
    assert [step.name for step in half if step in plan.experiments] == names[21:]
    assert half[0].kind == 'approach' and half[0].end == plan.experiments[21].begin
    assert plan.steps(finished=names) == ()


def test_gravity_is_held_by_a_bias():
    arm = replace(ROBOT.arm, gravity=np.array([0.0, -9.81]))
    heavy = replace(ROBOT, arm=arm)
    gains = replace(GAINS, torque_limit=np.array([20.0, 20.0]))
    values, _ = read_values([CONFIG / FILES[1]])
    plan = identification_plan.plan_identification(values, heavy, gains)
    step = next(step for step in plan.experiments if step.kind == 'torque')
    m, com, length = arm.mass, arm.com, arm.length[0]
    second = m[1] * com[1] * 9.81  # both links lie along x
    first = (m[0] * com[0] + m[1] * length) * 9.81 + second
    assert step.trajectory_parameters['trajectory.joint1.bias'] == pytest.approx(first)
    assert step.trajectory_parameters['trajectory.joint2.bias'] == pytest.approx(second)


@pytest.mark.parametrize(('overrides', 'sentence'), [
    ({'joint1__fastest': 1.3}, r'joint1.*step constant_velocity/joint1/\+1.3/.* reaches '
     r'1.3 rad/s, the limit of velocity is 1.2 rad/s; '),
    ({'joint2__upper': 0.0}, r'joint2.*step constant_velocity/joint2/\+2.25/1of3 needs 4.1 rad, '
     'the range within the margins is 1.4 rad; widen'),
    ({'joint1__upper': -1.1}, r'identification.joint1.upper must be above lower by more'),
    ({'joint1__acceleration': 20.0}, r'step constant_velocity/joint1/\+1.08/1of3 needs .* N m of '
     'the motor of joint1, the limit is 2 N m'),
    ({'joint2__torque': 0.12}, r'step .* needs .* of the motor of joint2, the limit is 0.12 N m'),
    ({'joint1__slowest': 1e-5}, r'\+0.0004762/1of3 needs 13.2 s for 20 encoder counts, the '
     'limit longest_dwell is 10 s'),
    ({'joint1__slowest': 2.0}, r'slowest is 2 rad/s, which is not below the fastest'),
    ({'sliding_speeds': [400.0]}, r'step sliding/joint1/\+2.67 has room for'),
    ({'joints': ['joint3']}, r"unknown joint 'joint3' \(robot has joint1, joint2\)"),
    ({'experiments': ['presliding', 'slide']}, r"unknown 'slide' at place 2, known are"),
    ({'speeds': 1}, r'identification.speeds must be from 2 to 1000, got 1'),
    ({'presliding_levels': [0.5, 1.2]}, r'presliding_levels must be from 0.01 to 0.99'),
    ({'sped': 3}, r'identification.sped is not a known parameter'),
])
def test_a_step_that_cannot_keep_a_limit_is_refused_before_anything_moves(overrides, sentence):
    with pytest.raises(ConfigError, match=sentence):
        planned(**overrides)


def test_a_recording_needs_space(tmp_path):
    require_space(tmp_path / 'not' / 'yet', 1000)
    reason = r'MB free and the recording needs about \d+ MB'
    with pytest.raises(identification_plan.ExperimentError, match=reason):
        require_space(tmp_path, 1e18)


def test_amplitudes_follow_the_least_break_away_torque():
    plan = planned('../bench/demos/identification.yaml')
    adaptation = identification_plan.Adaptation(plan)
    broken = next(step for step in plan.experiments if step.phase == 'break_away')
    slid = next(step for step in plan.experiments if step.phase == 'presliding')
    assert adaptation.applied_to(slid) == slid
    top = 0.5 * plan.trajectory(broken).end
    assert adaptation.broke_away(broken, 10 * top) == pytest.approx(abs(broken.value))
    half = adaptation.broke_away(broken, 0.5 * top)
    assert half == pytest.approx(0.5 * abs(broken.value))
    adaptation.broke_away(broken, top)
    adapted = adaptation.applied_to(slid)
    factor = 0.85 * half / 0.10433
    assert adapted.value == pytest.approx(factor * slid.value)
    name = 'trajectory.joint1.levels'
    assert adapted.trajectory_parameters[name] == pytest.approx(
        [factor * level for level in slid.trajectory_parameters[name]])
    assert adaptation.applied_to(broken) == broken
