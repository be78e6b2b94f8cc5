# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The motion that `gms_flex plan` writes: its condition number, its limits, its collisions."""

from dataclasses import replace
import json
from pathlib import Path

from gms_flex_control.cli.main import main
from gms_flex_control.design import excitation
from gms_flex_control.design.excitation import Capsules, segment_distance
from gms_flex_control.dynamics import chain
from gms_flex_control.errors import ConfigError
from gms_flex_control.experiment.simulated import read_plan
from gms_flex_control.schema.files import load_robot
from gms_flex_control.trajectory.builders import fourier
import numpy as np
import pytest

ROBOT = Path(__file__).parents[1] / 'examples' / 'industrial_arm' / 'robot.yaml'
PENDULUM = """<robot name="p"><link name="base"/><link name="rod"><inertial>
<mass value="2"/><origin xyz="0 0 -0.5"/>
<inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="3" effort="60"/></joint></robot>"""
FRICTION = """
    friction:
      swing:
        forward: {static: 0.6, coulomb: 0.5, velocity: 0.05, viscous: 0.1}
        backward: {static: 0.6, coulomb: 0.5, velocity: 0.05, viscous: 0.1}
        stiffness: [500.0]
        weight: [1.0]
        attraction: 50.0
"""


@pytest.fixture
def pendulum(tmp_path):
    (tmp_path / 'p.urdf').write_text(PENDULUM)
    (tmp_path / 'robot.yaml').write_text(
        "/**:\n  ros__parameters:\n    joints: [swing]\n    motors: ['']\n    arm:\n"
        '      kind: urdf\n      urdf: p.urdf\n'
        '      swing: {motor_inertia: 0.0, stiffness: .inf}\n' + FRICTION[1:])
    return tmp_path / 'robot.yaml'


@pytest.fixture(scope='module')
def written(tmp_path_factory):
    """Return folder and plan.json of the example's plan."""
    out = tmp_path_factory.mktemp('plan')
    assert main(['plan', '--robot', str(ROBOT), '--harmonics', '3', '--acceleration', '20',
                 '--out', str(out)]) == 0
    return out, json.loads((out / 'plan.json').read_text())


def test_the_condition_number_of_a_pendulum_is_that_of_its_three_columns(pendulum):
    """Inertia, and both parts of the first moment: ddq, cos q and sin q, friction taken out."""
    robot, time = load_robot(pendulum), np.arange(0.0, 10.0, 0.01)
    angle = 0.8 * np.sin(2.0 * time) + 0.3 * np.cos(5.0 * time)
    rate = 1.6 * np.cos(2.0 * time) - 1.5 * np.sin(5.0 * time)
    second = -3.2 * np.sin(2.0 * time) - 7.5 * np.cos(5.0 * time)
    table = np.stack([second, np.cos(angle), np.sin(angle)], axis=1)
    friction = np.stack([np.sign(rate), rate, np.ones(len(time))], axis=1)
    table -= friction @ np.linalg.lstsq(friction, table, rcond=None)[0]
    number, _ = excitation.condition_number(angle[:, None], rate[:, None], second[:, None], robot)
    assert number == pytest.approx(np.linalg.cond(table / np.linalg.norm(table, axis=0)))


def test_the_written_motion_keeps_all_limits_from_rest_to_rest(written):
    robot, (folder, values) = load_robot(ROBOT), written
    frames, arm = robot.arm.frames, robot.arm
    plan = read_plan([ROBOT, ROBOT.with_name('controller.yaml'), folder / 'trajectory.yaml'])
    time = np.arange(0.0, plan.trajectory.end, 1e-3)
    angle, rate, second = np.moveaxis(plan.trajectory.sample(time)[:, :3], 1, 0)
    assert np.all(angle >= frames.lower) and np.all(angle <= frames.upper)
    assert np.all(np.abs(rate) <= frames.velocity) and np.all(np.abs(second) <= 20.0)
    torque = chain.inverse_dynamics(angle, rate, second, arm) + arm.motor_inertia * second
    steady = robot.friction.forward
    torque += np.sign(rate) * steady.coulomb + steady.viscous * rate
    assert np.all(np.abs(torque) <= 1.01 * frames.effort)
    assert Capsules(arm).least(angle) > 0.0
    for k in (0, -1):
        np.testing.assert_allclose([rate[k], second[k]], 0.0, atol=0.05)
    assert max(values['shares_of_limits'].values()) > 0.8, 'limits are made use of'
    assert values['condition_number'] < 0.2 * values['sinusoids']


def test_lines_are_as_far_apart_as_a_fine_search_finds():
    rng = np.random.default_rng(0)
    ends = rng.standard_normal((4, 50, 3))
    grid = np.linspace(0.0, 1.0, 201)
    first = ends[0][:, None] + grid[:, None] * (ends[1] - ends[0])[:, None]
    second = ends[2][:, None] + grid[:, None] * (ends[3] - ends[2])[:, None]
    far = np.linalg.norm(first[:, :, None] - second[:, None], axis=3).min(axis=(1, 2))
    np.testing.assert_allclose(segment_distance(*ends), far, atol=2e-2)
    assert np.all(segment_distance(*ends) <= far + 1e-12)
    a, c = np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]])
    x = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(segment_distance(a, x, c, c + x), 1.0)


def test_a_folded_arm_meets_itself():
    arm = load_robot(ROBOT).arm
    angle = np.zeros((1, 6))
    open_gap = Capsules(arm).least(angle)
    angle[0, 2] = 2.6
    assert open_gap > 0.0 > Capsules(arm).least(angle)


def test_a_fourier_series_has_its_own_derivatives():
    """Against the series written out, to 1e-8 of each derivative's size."""
    sine, cosine = np.random.default_rng(0).standard_normal((2, 4, 2))
    motion = fourier(sine, cosine, 5.0, repeats=2, ramp_time=1.5)
    time = np.linspace(0.0, 10.0, 997)[:-1]
    omega = 2.0 * np.pi / 5.0 * np.arange(1, 5)
    found = motion.sample(1.5 + time)
    for k in range(5):
        turn = omega * time[:, None] + 0.5 * np.pi * k
        true = (np.sin(turn) * omega ** k) @ sine + (np.cos(turn) * omega ** k) @ cosine
        np.testing.assert_allclose(found[:, k], true, atol=(1e-9, 1e-8, 1e-7, 1e-5, 1e-4)[k]
                                   * np.abs(true).max())
    for end in (0.0, motion.end):
        np.testing.assert_allclose(motion.sample(end), 0.0, atol=1e-9)


def test_limits_that_leave_no_room_are_named(pendulum):
    robot = load_robot(pendulum)
    bounds = excitation.Bounds.of_robot(robot)
    weak = replace(bounds, torque=np.array([5.0]), lower=np.array([1.0]))
    with pytest.raises(ConfigError, match='torque is .* times its limit'):
        excitation.plan_excitation(robot, weak, harmonics=2)


def test_a_planar_arm_is_refused(capsys, tmp_path):
    planar = Path(__file__).parents[1] / 'config' / 'robot.yaml'
    assert main(['plan', '--robot', str(planar), '--out', str(tmp_path / 'p')]) == 2
    assert 'plan needs urdf' in ' '.join(capsys.readouterr().err.split())
    assert not (tmp_path / 'p').exists()
