# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What stands beside a bag: loads, temperatures, torque constants; currents to the end."""

from dataclasses import replace
import json

import faulty
from gms_flex_control.cli.main import main
from gms_flex_control.data import conditions
from gms_flex_control.data.conditions import conditions_of, NAME, with_conditions
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.result import BAD_DATA
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.errors import BagError, ConfigError, IdentificationError
from gms_flex_control.identification.identify import identify
from gms_flex_control.params.arm import Body
from gms_flex_control.schema.files import save_robot
from identified_axis import axis, experiment, part
import numpy as np
import pytest

CONSTANT = 0.05  # N m/A


@pytest.fixture
def amperes():
    """Return a recording whose efforts are currents."""
    recording, _ = experiment(rigid=True)
    return replace(recording, tau_motor=recording.tau_motor / CONSTANT)


def stated(folder, text):
    """Return the Conditions of a bag folder with a recording.yaml."""
    (folder / 'recording.yaml').write_text(text)
    return conditions_of(folder)


def test_friction_of_currents_is_in_amperes_in_table_report_and_json(amperes, tmp_path, capsys):
    """A known torque constant times each number gives the friction that was simulated."""
    write_recording(tmp_path / 'bag', amperes, ('',))
    (tmp_path / 'bag' / 'recording.yaml').write_text('torque_constant: {joint1: unknown}\n')
    assert main(['identify', str(tmp_path / 'bag'), '--blocks', '4', '--out',
                 str(tmp_path / 'out')]) == 0
    text = capsys.readouterr().out
    page = (tmp_path / 'out' / 'report.html').read_text()
    comment = (tmp_path / 'out' / 'friction.yaml').read_text().split('/**')[0]
    for words in (text, page, comment):
        assert 'N m' not in words and 'kg m^2' not in words
    rows = {one['name']: one for one in json.loads(
        (tmp_path / 'out' / 'report.json').read_text())['joints'][0]['estimates']}
    for name, true, unit in (('friction.joint1.forward.coulomb', 0.09087, 'A'),
                             ('friction.joint1.backward.coulomb', 0.08363, 'A'),
                             ('arm.joint1.inertia', 0.035, 'A s^2/rad')):
        assert CONSTANT * rows[name]['value'] == pytest.approx(true, rel=0.05)
        assert rows[name]['unit'] == unit


def test_currents_do_not_move_masses_in_kilograms(amperes):
    recording = replace(amperes, scale_sd=[np.inf], command=np.nan)
    with pytest.raises(IdentificationError, match='torque constant of joint1 is unknown'):
        identify([recording], axis(rigid=True))
    result = find_discrepancy([recording], axis(rigid=True))
    assert result.verdict == BAD_DATA and 'torque constant' in result.words


def test_a_current_among_torques_is_refused():
    """Nothing says how much of the torque of one joint a current of another is."""
    recording, robot = faulty.healthy('rigid gravity')
    with pytest.raises(BagError, match='state it in its recording.yaml'):
        motion_of(replace(recording, scale_sd=[np.inf, 0.0]), robot)


def test_discrepancy_goes_on_in_amperes(amperes, tmp_path, capsys):
    """A level of friction that is believed a fifth too low is found in amperes."""
    recording, _ = part((replace(amperes, command=np.nan), ()), 0.0, 30.0)
    write_recording(tmp_path / 'bag', recording, ('',))
    (tmp_path / 'bag' / 'recording.yaml').write_text('torque_constant: {joint1: unknown}\n')
    robot = axis(rigid=True)
    arm = robot.arm

    def per(torque):
        return torque / CONSTANT
    sides = {side: replace(one, static=per(0.8 * one.static), coulomb=per(0.8 * one.coulomb),
                           viscous=per(one.viscous))
             for side, one in (('forward', robot.friction.forward),
                               ('backward', robot.friction.backward))}
    friction = replace(robot.friction, stiffness=per(robot.friction.stiffness),
                       attraction=per(robot.friction.attraction), **sides)
    save_robot(replace(robot, friction=friction, arm=replace(
        arm, inertia=per(arm.inertia), motor_inertia=per(arm.motor_inertia))),
        tmp_path / 'robot.yaml')
    assert main(['discrepancy', str(tmp_path / 'bag'), '--robot', str(tmp_path / 'robot.yaml'),
                 '--max-effects', '1', '--out', str(tmp_path / 'out')]) == 1
    text = capsys.readouterr().out
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert 'N m' not in text and 'N m' not in page
    found = json.loads((tmp_path / 'out' / 'report.json').read_text())
    assert 'coulomb_error' in str(found['findings'])


def test_a_known_constant_makes_torques(amperes, tmp_path):
    found = with_conditions(amperes, stated(
        tmp_path, f'torque_constant: {{joint1: {CONSTANT}}}\ntemperature: 31\n'))
    np.testing.assert_allclose(found.tau_motor, experiment(rigid=True)[0].tau_motor)
    assert found.operation.temperature == '31' and not found.scale_sd.any()
    partly = with_conditions(amperes, stated(
        tmp_path, 'torque_constant: {joint1: {value: 0.06, sd: 0.2}}\n'))
    np.testing.assert_array_equal(partly.scale_sd, 0.2)


def test_what_is_stated_beside_a_bag_is_read_with_it(amperes, tmp_path):
    """A joint that is left out may be named; one that the bag lacks may not."""
    write_recording(tmp_path / 'bag', amperes, ('',))
    file = tmp_path / 'bag' / NAME
    file.write_text(f'torque_constant: {{joint1: {CONSTANT}}}\n')
    np.testing.assert_allclose(read_recording(tmp_path / 'bag').tau_motor,
                               experiment(rigid=True)[0].tau_motor, rtol=1e-12)
    two = replace(amperes, joints=('a', 'joint1'), **{
        name: np.repeat(getattr(amperes, name), 2, axis=1) for name in (
            'q_link', 'dq_link', 'q_motor', 'dq_motor', 'tau_motor', 'command',
            'friction_hat')}, reference=np.full((len(amperes.time), 5, 2), np.nan), scale_sd=0.0)
    write_recording(tmp_path / 'two', two, ('', ''))
    (tmp_path / 'two' / NAME).write_text(f'torque_constant: {{a: 2, joint1: {CONSTANT}}}\n')
    assert read_recording(tmp_path / 'two', ['a']).tau_motor[5, 0] == pytest.approx(
        2.0 * amperes.tau_motor[5, 0])
    (tmp_path / 'two' / NAME).write_text('torque_constant: {b: 2}\n')
    with pytest.raises(ConfigError, match="names 'b', the recording has a"):
        read_recording(tmp_path / 'two', ['a'])


def test_found_constants_and_loads_are_written_for_the_next_command(tmp_path):
    """Constants as stated times what was found; what else the file says stays."""
    (tmp_path / NAME).write_text(
        'temperature: warm\ntorque_constant: {a: {value: 2, sd: 0.1}, b_motor: unknown, c: 5}\n')
    load = Body(3.0, np.array([0.1, 0.0, 0.2]), np.diag([0.1, 0.2, 0.15]))
    text = conditions.with_found(tmp_path, {'a': (1.5, 0.01), 'b': (7.0, 0.02)}, load,
                                 {'a': '', 'b': 'b_motor'})
    (tmp_path / NAME).write_text(text)
    again = conditions_of(tmp_path)
    assert again.torque_constant == {'c': (5, 0.0), 'a': (3.0, 0.01), 'b': (7.0, 0.02)}
    assert again.operation.temperature == 'warm' and not again.operation.load_unknown
    for one, other in zip(again.operation.load, load, strict=True):
        np.testing.assert_allclose(one, other)


def test_a_load_is_a_body_in_the_frame_at_the_end_of_the_arm(tmp_path):
    load = stated(tmp_path, 'load: {mass: 2, com: [0, 0, 0.1]}\n').operation.load
    assert load.mass == 2.0 and load.com[2] == 0.1 and np.all(np.diag(load.inertia) > 0.0)
    assert stated(tmp_path, 'load: {mass: 0}\n').operation.load is None
    assert conditions_of(tmp_path / 'nowhere').operation.load is None
    lost = stated(tmp_path, 'load: unknown\n')
    assert lost.operation.load is None and lost.operation.load_unknown


@pytest.mark.parametrize(('text', 'sentence'), [
    ('laod: {mass: 1}', "laod is not a key here; did you mean 'load'"),
    ('load: {mass: -1}', 'load.mass is -1 kg'),
    ('load: {mass: heavy}', "load.mass must be a number, got 'heavy'"),
    ('load: {mass: 1, com: [1, 2]}', 'load.com must be 3 numbers'),
    ('load: {mass: 1, inertia: [1, 0, 0, 0.1, 0, 0.1]}', 'no body'),
    ('load: {com: [0, 0, 0]}', "load lacks 'mass'"),
    ('torque_constant: 3', 'must be a mapping such as {joint1: 12.4, joint2: unknown}, got 3'),
    ('torque_constant: {joint1: 0}', 'needs a value other than 0'),
    ('torque_constant: {joint1: {vlaue: 3}}', 'torque_constant.joint1.vlaue is not a key here'),
    ('coupling: {joint6: joint5}', 'coupling.joint6 must be a mapping such as {joint5: 1.0}'),
    ('coupling: {joint6: {joint5: one}}', 'coupling.joint6.joint5 must be a number'),
    ('load: [', 'is not valid YAML')])
def test_a_wrong_file_is_refused_in_one_sentence(tmp_path, text, sentence):
    with pytest.raises(ConfigError, match=sentence) as caught:
        stated(tmp_path, text + '\n')
    assert 'recording.yaml:' in str(caught.value)


@pytest.fixture
def wrist():
    """Return a recording of three joints, of the first no torque, of the second one lost."""
    torque = np.arange(12.0).reshape(4, 3)
    torque[:, 0], torque[2, 1] = np.nan, np.nan
    return Recording(joints=('a', 'b', 'c'), time=np.arange(4.0), source='wrist',
                     tau_motor=torque, command=2.0 * torque)


def test_torque_that_is_missing_is_missing_of_the_joints_of_its_motor_alone(wrist):
    found = with_conditions(wrist, conditions.Conditions(coupling={'c': {'b': 0.5}}))
    lost = [10.0 - 3.0 * k for k in (3, 2, 1, 0)]
    torque = np.array([[np.nan, b + 0.5 * c, c] for b, c in zip(lost, (2, 5, 8, 11), strict=True)])
    torque[2, 1] = np.nan
    np.testing.assert_array_equal(found.tau_motor, torque)
    np.testing.assert_array_equal(found.command, 2.0 * torque)


@pytest.mark.parametrize(('constants', 'sentence'), [
    ('b: unknown, c: 9.1', 'b has a coupled motor, but its torque constant is not known'),
    ('b: 9.1, c: unknown', 'c has a coupled motor'),
    ('b: 9.1, c: {value: 9.1, sd: 0.1}', 'state it without sd in recording.yaml')])
def test_torques_of_coupled_motors_are_not_added_to_currents(wrist, tmp_path, constants, sentence):
    known = stated(tmp_path, f'torque_constant: {{a: unknown, {constants}}}\n'
                             'coupling: {c: {b: 0.5}}\n')
    with pytest.raises(ConfigError, match=sentence):
        with_conditions(wrist, known)


def test_what_is_known_of_a_recording_is_repeated_beside_the_next(tmp_path):
    """All of a bag, or of the robot alone where efforts are recorded in another way."""
    for name in ('old', 'new', 'simulated'):
        (tmp_path / name).mkdir()
    stated(tmp_path / 'old', 'load: {mass: 2}\ntemperature: warm\ntorque_constant: {a: 3.0}\n')
    conditions.repeat_conditions(tmp_path / 'old', tmp_path / 'new')
    conditions.repeat_conditions(tmp_path / 'old', tmp_path / 'simulated', conditions.OF_ROBOT)
    new, simulated = (conditions_of(tmp_path / name) for name in ('new', 'simulated'))
    assert new.operation.load.mass == simulated.operation.load.mass == 2.0
    assert new.operation.temperature == simulated.operation.temperature == 'warm'
    assert new.torque_constant == {'a': (3.0, 0.0)} and simulated.torque_constant is None


def test_coupled_motors_need_an_arm_of_a_urdf():
    recording = replace(experiment(rigid=True)[0], coupling=np.eye(1))
    with pytest.raises(IdentificationError, match='coupled motors, whose friction needs an arm'):
        identify([recording], axis(rigid=True))


def test_a_load_needs_an_arm_of_a_urdf(tmp_path):
    recording = with_conditions(experiment(rigid=True)[0], stated(tmp_path, 'load: {mass: 2}\n'))
    with pytest.raises(IdentificationError, match='needs an arm of a URDF'):
        identify([recording], axis(rigid=True))
    with pytest.raises(BagError, match='decoupled axes do not share'):
        motion_of(recording, axis(rigid=True))
