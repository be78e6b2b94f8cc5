# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Hidden robots: their integrator against others, and cases drawn from seeds."""

from dataclasses import replace
import json
from types import SimpleNamespace

from bench.__main__ import main
from bench.chain_matrices import matrices
from bench.hidden_robots import cases, plants, sizes, truth
from core_runs import push_plant
from gms_flex_control.data.reader import read_recording
from gms_flex_control.effects import registry
from gms_flex_control.effects.base import Term
from gms_flex_control.errors import ConfigError
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np
import pytest

TIME = np.arange(500) * 2e-3
COMMAND = np.stack([0.5 * np.sin(1.3 * TIME) + 0.1 * np.sin(7 * TIME), 0.3 * np.sin(2.1 * TIME)],
                   axis=1)


def test_the_plant_converges_to_the_hidden_robot(ideal_robot):
    """The plant is of first order: each refinement by four takes about as much off."""
    hidden = truth.simulate_open(ideal_robot, COMMAND, substeps=200)[1:]
    errors = [np.abs(push_plant(ideal_robot, COMMAND, 2e-3, substeps=substeps)[:, :4]
                     - hidden).max() for substeps in (25, 100, 400)]
    assert errors[1] < errors[0] / 2.5 and errors[2] < errors[1] / 2.5
    assert errors[2] < 3e-4
    coarse = truth.simulate_open(ideal_robot, COMMAND)[1:]
    assert np.abs(coarse - hidden).max() < 1e-4


@pytest.mark.parametrize('name', sorted(
    name for name in registry.names() if issubclass(registry.find(name), Term)))
def test_every_term_acts_in_the_hidden_robot_as_in_the_plant(ideal_robot, name):
    """What an effect changes in one integrator, it changes in the other as well."""
    stage = registry.find(name).stage
    if stage == stage.SENSOR or name == 'supply_sag':
        pytest.skip('acts on what is measured, or with a voltage')
    drawn = sizes.MAIN | sizes.ASKED
    if name not in drawn:
        pytest.skip('no robot of the bench has it')
    figures = sizes.figures_of(ideal_robot, TURNING, 2e-3)
    rng = np.random.default_rng(3)
    spec = sizes.spec(name, 1, ideal_robot.joints, drawn[name](rng, figures[1]))
    robots = ideal_robot, replace(ideal_robot, effects=(spec,))
    command = 1.5 * COMMAND[:250]
    plant = [push_plant(robot, command, 2e-3, substeps=200)[:, :4] for robot in robots]
    hidden = [truth.simulate_open(robot, command)[1:] for robot in robots]
    change = plant[1] - plant[0]
    assert np.abs(hidden[1] - hidden[0] - change).max() < 0.15 * np.abs(change).max() + 1e-4


TURNING = truth.Motion(
    None, np.stack([np.stack([np.sin(TIME), np.cos(TIME), 1.1 * np.sin(TIME),
                              1.1 * np.cos(TIME)], axis=1)] * 2, axis=2), COMMAND, None, None,
    None)


@pytest.mark.parametrize('kind', cases.KINDS)
def test_a_case_hides_what_its_kind_says(kind):
    case = cases.make_case(kind, 3, duration=10.0)
    found = case.truth
    assert len(found.effects) == {'clean': 0, 'outside': 0, 'double': 2}.get(kind, 1)
    assert len(found.clutter) == (14 if kind == 'clutter' else 0)
    assert (found.outsider is not None) == (kind == 'outside')
    assert found.robot.effects == found.effects + found.clutter
    assert (found.kind, found.seed, found.motion) == (kind, 3, 'rich')
    assert case.nominal.effects == ()
    assert case.recording.time[-1] == pytest.approx(10.0 - 2e-3)
    assert not np.allclose(case.held_out.q_link, case.recording.q_link)
    for name in ('q_link', 'q_motor', 'tau_motor', 'command', 'reference'):
        assert np.isfinite(getattr(case.recording, name)).all()
    np.testing.assert_array_equal(case.recording.tau_motor[1:], case.recording.command[:-1])


def test_what_is_believed_lies_1_to_3_percent_off():
    robot, _ = plants.draw_robot(np.random.default_rng(0), 'soft')
    belief = plants.draw_belief(np.random.default_rng(1), robot)
    pairs = [(base_parameters(belief.arm), base_parameters(robot.arm)),
             (belief.arm.stiffness, robot.arm.stiffness),
             (belief.arm.motor_inertia, robot.arm.motor_inertia),
             (belief.friction.forward.coulomb, robot.friction.forward.coulomb),
             (belief.friction.backward.static, robot.friction.backward.static),
             (belief.friction.forward.viscous, robot.friction.forward.viscous)]
    for believed, true in pairs:
        off = np.abs(believed / true - 1.0)
        assert np.all((off > 0.0099) & (off < 0.0301))


def base_parameters(arm):
    """Return the three constants of M of two links, from M itself at two poses."""
    def mass(q2):
        zero = np.zeros(2)
        return matrices(np.array([0.0, q2]), zero, zero, zero, arm).mass
    straight, square = mass(0.0), mass(np.pi / 2)
    coupled = straight[0, 1] - square[0, 1]
    return np.array([square[0, 0] - square[1, 1], coupled, square[1, 1]])


def test_a_longer_chain_is_refused():
    three = SimpleNamespace(arm=SimpleNamespace(kind='planar'), n_joints=3, effects=())
    with pytest.raises(ConfigError, match='one or two joints, got 3'):
        truth.constants_of(three)


def test_hide_writes_what_a_user_has_and_the_truth(tmp_path, capsys):
    """Bag, believed robot and gains read back; an existing case is kept."""
    args = ['hide', '--out', str(tmp_path), '--kind', 'double', '--seeds', '2', '--duration', '8']
    assert main(args) == 0
    folder = tmp_path / 'double_2'
    case = cases.make_case('double', 2, duration=8.0)
    recording = read_recording(folder / 'bag')
    np.testing.assert_allclose(recording.q_link, case.recording.q_link, atol=1e-12)
    np.testing.assert_allclose(recording.tau_motor, case.recording.tau_motor, atol=1e-12)
    robot = load_robot(folder / 'robot.yaml')
    np.testing.assert_array_equal(robot.arm.stiffness, case.nominal.arm.stiffness)
    gains = load_controller(folder / 'controller.yaml', robot)
    np.testing.assert_array_equal(gains.kd_motor, case.gains.kd_motor)
    reported = json.loads((folder / 'truth.json').read_text())
    assert [one['effect'] for one in reported['effects']] == [
        spec.name for spec in case.truth.effects]
    assert main(args) == 0
    assert 'kept as it is' in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ['double_2']


def test_a_bag_that_names_the_motors_alone_gives_links_without_angles(tmp_path, capsys):
    """As `gms_flex hide` writes it of a robot whose links have no encoders."""
    args = ['--kind', 'clean', '--seeds', '3', '--duration', '4', '--population']
    assert main(['hide', '--out', str(tmp_path), *args, 'motors_only']) == 0
    own = cases.make_case('clean', 3, duration=4.0).recording
    folder, = tmp_path.iterdir()
    robot = load_robot(folder / 'robot.yaml')
    read = read_recording(folder / 'bag', joints=own.joints, motors=robot.motors)
    assert read.joints == own.joints and np.isnan(read.q_link).all()
    np.testing.assert_array_equal(read.q_motor, own.q_motor)
    np.testing.assert_array_equal(read.command, own.command)
    assert main(['hide', '--out', str(tmp_path), *args, 'none']) == 2
    assert "population 'none' is unknown" in capsys.readouterr().err
