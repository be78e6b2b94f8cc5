# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The links of an arm of a URDF are found from a motion that MuJoCo simulates."""

from dataclasses import replace

from bench.hidden_arms.base_parameters import ordinary_least_squares
from bench.hidden_arms.wrong_links import base_values, believed, hidden_arm, moved
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import low_pass, rms
from gms_flex_control.dynamics import chain
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.arm_differences import base_estimates
from gms_flex_control.identification.arm_regression import fit_base_parameters
from gms_flex_control.identification.inertial_parameters import base_of, link_regressors, sizes_of
from gms_flex_control.identification.objective import friction_torque
from gms_flex_control.identification.segments import segments_of
from gms_flex_control.params.arm import require_body
from gms_flex_control.schema.files import load_robot, save_robot
import numpy as np
import pytest

pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")


@pytest.fixture(scope='module')
def hidden():
    """Return the true arm, the robot as believed and a recording."""
    robot, arm, urdf = hidden_arm()
    return arm, robot, moved(urdf, robot.arm, 10.0)


@pytest.fixture(scope='module')
def found(hidden):
    return fit_base_parameters([hidden[2]], hidden[1])


def test_base_parameters_are_as_many_as_motion_determines_and_make_the_same_torque():
    """The rank of six revolute joints, a vertical first: 36, and four motors apart from links."""
    arm = believed().arm
    lead, combination = base_of(arm)
    assert len(lead) == 40
    motion = np.random.default_rng(1).standard_normal((3, 20, 6))
    columns = link_regressors(*motion, arm)
    np.testing.assert_allclose(columns[:, :, lead] @ combination, columns, rtol=0,
                               atol=1e-5 * np.abs(columns).max())


def test_well_known_base_parameters_are_true_and_beat_ordinary_least_squares(hidden, found):
    """Relative standard deviation below 5 %: within 3 %, and within 5 standard deviations."""
    truth = base_values(hidden[0])
    known = found.error < 0.05 * np.abs(found.values)
    off = np.abs(found.values - truth)
    assert known.sum() >= 20
    assert np.all(off[known] < 0.03 * np.abs(truth[known]))
    assert np.all(off < 5.0 * found.error)
    started = np.abs(found.described - truth)
    assert np.median(off[known] / started[known]) < 0.05
    ordinary = np.abs(ordinary_least_squares(hidden[2], hidden[1].arm)[0] - truth)
    assert np.median(off[known] / ordinary[known]) < 1.0


def test_the_nearest_arm_has_these_base_parameters_and_is_made_of_bodies(hidden, found, tmp_path):
    known = found.error < 0.05 * np.abs(found.values)
    off = np.abs(base_values(found.arm) / np.where(known, found.values, np.inf) - 1.0)
    assert off[known].max() < 0.03
    for mass, inertia in zip(found.arm.mass, found.arm.inertia, strict=True):
        require_body('a link', mass, inertia)
    robot = replace(hidden[1], arm=found.arm)
    save_robot(robot, tmp_path / 'robot.yaml')
    again = load_robot(tmp_path / 'robot.yaml').arm
    for name in ('mass', 'com', 'inertia', 'motor_inertia'):
        np.testing.assert_allclose(getattr(again, name), getattr(found.arm, name), rtol=1e-12)


def test_links_and_motors_are_as_far_off_as_their_standard_deviations_say(hidden, found):
    """Mass and inertia of each link, which the data know together only, and motor inertia."""
    truth = np.vstack([sizes_of(hidden[0]), hidden[0].motor_inertia])
    values = np.vstack([sizes_of(found.arm), found.arm.motor_inertia])
    reported = np.isfinite(found.spread)
    assert reported[:2].all()
    off = np.abs(np.log(values / truth))[reported] / found.spread[reported]
    assert off.max() < 3.0
    assert np.mean(off < 1.0) > 0.5


def test_what_the_motion_does_not_move_is_said(hidden):
    """The last joint at rest: its motor inertia and zz are not identifiable."""
    _, robot, recording = hidden
    still = np.broadcast_to(recording.q_link[:1, 5:], (len(recording.time), 1))
    held = replace(recording, q_link=np.concatenate([recording.q_link[:, :5], still], axis=1))
    result = fit_base_parameters([held], robot)
    rows = {one.name: one for part in base_estimates(result, robot.joints) for one in part}
    assert np.isinf(result.spread[2, 5])
    assert rows['arm.joint6.motor_inertia'].flags == ('not identifiable',)
    assert 'hardly moves it' in rows['arm.joint6.motor_inertia'].note


def on_a_line(robot, arm):
    """Return a Recording of joints that turn all at once, with friction and what no model has."""
    rng, time = np.random.default_rng(2), np.arange(3000) / 100.0
    turns, size = 2.0 * np.pi * np.array([0.1, 0.27, 0.6]), np.array([0.5, 0.2, 0.08])
    angles = np.outer(time, turns) + rng.uniform(0.0, 6.0, 3)
    way = 0.4 * np.array([1.0, -0.6, 0.9, 1.2, 0.8, 1.1])
    q, dq, ddq = (np.outer(np.sin(angles + 0.5 * np.pi * k) @ (size * turns ** k), way)
                  for k in range(3))
    q += np.array([0.2, -0.7, 0.9, 0.1, 0.5, 0.0])
    torque = chain.inverse_dynamics(q, dq, ddq, arm) + np.tanh(dq / 0.01)
    torque += 0.05 * torque.std(axis=0) * low_pass(20.0 * rng.standard_normal(q.shape), 40)
    return Recording(joints=robot.joints, time=time, source='line', tau_motor=torque,
                     q_link=q + 2e-5 * rng.standard_normal(q.shape))


def test_motion_of_all_joints_at_once_makes_no_constant_torque_of_their_weight(hidden):
    """What differs between the directions is 0, and gravity hardly changes along that line."""
    recording = on_a_line(hidden[1], hidden[0])
    offset = fit_base_parameters([recording], hidden[1]).offset
    assert np.all(np.abs(offset) < 0.2 * np.sqrt(np.mean(recording.tau_motor ** 2, axis=0)))


def test_a_recording_that_the_low_pass_leaves_nothing_of_is_refused(hidden):
    """Two seconds at 10 Hz are a piece, but shorter than the filter."""
    _, robot, recording = hidden
    every = round(0.1 / recording.period)
    short = recording.of_samples(slice(0, 20 * every, every))
    with pytest.raises(IdentificationError, match='too short for the filter of the regression'):
        fit_base_parameters([short], robot)


def test_what_the_links_leave_of_the_torque_is_the_friction(hidden, found):
    """Friction of the simulated joints, which wrong masses of the URDF hide."""
    _, robot, recording = hidden
    mass = np.diag(chain.mass_matrices(np.zeros((1, 6)), robot.arm)[0])
    segment, = segments_of(recording, robot, ('motor',) * 6)
    rate = segment.rate[200:-200]
    true = (0.02 * mass + 4.0) * np.sign(rate) + (0.05 * mass + 2.0) * rate
    off = [rms(low_pass(friction_torque(segment, arm)[200:-200] - true, 50).ravel())
           / rms(true.ravel()) for arm in (found.arm, robot.arm)]
    assert off[0] < 0.1 < 1.0 < off[1], off


def test_links_found_joint_by_joint_predict_no_worse_than_those_of_the_urdf(hidden):
    """Each joint moves in a recording of its own; judged on another motion of the first two."""
    _, robot, _ = hidden
    urdf, alone = hidden_arm()[2], np.eye(6)
    recordings = [moved(urdf, robot.arm, 4.0, seed=j, noise=0.02, moving=alone[j])
                  for j in range(6)]
    found = fit_base_parameters(recordings, robot)
    for j in range(2):
        apart = moved(urdf, robot.arm, 4.0, seed=50 + j, noise=0.02, moving=alone[j])
        segment, = segments_of(apart, robot, ('motor',) * 6)
        rate = segment.rate[:, j]
        friction = low_pass(np.stack([rate > 0, rate < 0, rate], axis=1).astype(float), 50)
        off = []
        for arm in (found.arm, robot.arm):
            torque = low_pass(friction_torque(segment, arm)[:, j], 50)
            rest = torque - friction @ np.linalg.lstsq(friction, torque, rcond=None)[0]
            off.append(rms(rest[200:-200]) / rms(segment.torque[:, j]))
        assert off[0] < min(off[1], 0.01), off
