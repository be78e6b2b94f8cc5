# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The URDF of a robot has its joints, and another engine finds our mass matrix in it."""

from dataclasses import replace
import xml.etree.ElementTree as ElementTree

from bench.chain_matrices import matrices
from gms_flex_control.cli.main import main
from gms_flex_control.file_io import robot_file
from gms_flex_control.schema.files import load_robot
from gms_flex_control.schema.urdf import robot_urdf
import numpy as np
import pytest

pytestmark = pytest.mark.fast

ZERO = np.zeros(2)


def robot(**changes):
    """Return the arm of the paper with other values under ``arm``."""
    paper = load_robot(robot_file())
    motors = tuple('' if np.isinf(k) else name for k, name in zip(
        changes.get('stiffness', paper.arm.stiffness), paper.motors, strict=True))
    return replace(paper, motors=motors, arm=replace(paper.arm, **changes))


def mujoco_mass(text, names, angles):
    """Return the mass matrix that MuJoCo makes of a URDF, rows in the order of ``names``."""
    mujoco = pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in names]] = angles
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    rows = [model.joint(name).dofadr[0] for name in names]
    return full[np.ix_(rows, rows)]


ARMS = {
    'paper': {},
    'lifted': {'offset': [0.4, -0.9], 'gravity': 9.81},
    'half rigid': {'stiffness': [np.inf, 1.5]},
    'decoupled': {'kind': 'decoupled', 'mass': [0.0, 0.0], 'com': [0.0, 0.0],
                  'length': [0.0, 0.0]}}
ARMS['linear'] = {**ARMS['decoupled'], 'axes': 'linear'}


@pytest.mark.parametrize('arm', ARMS)
@pytest.mark.parametrize('q', [(0.0, 0.0), (0.3, 1.1), (-2.0, 2.5)])
def test_mujoco_finds_our_mass_matrix_in_the_links(arm, q):
    """Of a rigid joint URDF lacks the motor's share of its inertia."""
    one = robot(**ARMS[arm])
    text = robot_urdf(one, motors=False)
    kinds = {joint.get('type') for joint in ElementTree.fromstring(text).iter('joint')}
    assert kinds == {'prismatic' if one.arm.axes == 'linear' else 'continuous'}
    found = mujoco_mass(text, one.joints, q)
    reported = matrices(q, ZERO, ZERO, ZERO, one.arm).mass
    rigid = np.diag(np.where(one.arm.rigid, one.arm.motor_inertia, 0.0))
    assert np.allclose(found, reported - rigid, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('q', [(0.0, 0.0), (0.3, 1.1)])
def test_motors_turn_with_the_link_before_them(q):
    """Kinetic energy of a rotor: half of J times the square of its absolute rate."""
    one = robot()
    names = (*one.joints, *one.motors)
    found = mujoco_mass(robot_urdf(one), names, (*q, 0.7, -0.4))
    absolute = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 1.0]])  # of (dq_link, dq_motor)
    reported = absolute.T @ np.diag(one.arm.motor_inertia) @ absolute
    reported[:2, :2] += matrices(q, ZERO, ZERO, ZERO, one.arm).mass
    assert np.allclose(found, reported, rtol=1e-6, atol=1e-6)  # rotors have a mass of 1e-6 kg


def test_joints_are_named_and_joined_as_in_the_robot():
    root = ElementTree.fromstring(robot_urdf(robot()))
    joined = {joint.get('name'): tuple(joint.find(end).get('link') for end in ('parent', 'child'))
              for joint in root.iter('joint')}
    assert joined == {'joint1': ('base', 'joint1_link'), 'joint2': ('joint1_link', 'joint2_link'),
                      'joint1_motor': ('base', 'joint1_motor_link'),
                      'joint2_motor': ('joint1_link', 'joint2_motor_link')}
    assert {joint.get('type') for joint in root.iter('joint')} == {'continuous'}
    links = [link.get('name') for link in root.iter('link')]
    assert sorted(links) == sorted({'base'} | {child for _, child in joined.values()})
    assert 'spring to its link: 1.5 N m/rad' in robot_urdf(robot())


def test_the_tool_writes_what_it_prints(tmp_path, capsys):
    assert main(['urdf', '--name', 'paper']) == 0
    printed = capsys.readouterr().out
    assert ElementTree.fromstring(printed).get('name') == 'paper'
    assert main(['urdf', '--name', 'paper', '--out', str(tmp_path / 'arm.urdf')]) == 0
    assert (tmp_path / 'arm.urdf').read_text() == printed
    assert main(['urdf', '--robot', str(tmp_path / 'none.yaml')]) == 2


def test_limits_and_interfaces_stand_where_ros2_control_reads_them(capsys):
    config = robot_file().parent
    assert main(['urdf', '--robot', str(robot_file()), '--limits', str(config / 'bridge.yaml'),
                 '--ros2-control', 'mock_components/GenericSystem']) == 0
    root = ElementTree.fromstring(capsys.readouterr().out)
    limits = {joint.get('name'): (joint.get('type'), joint.find('limit').attrib)
              for joint in root.findall('joint')}
    assert limits['joint1'] == ('revolute', {'effort': '0.5', 'velocity': '2.0', 'lower': '-1.2',
                                             'upper': '1.2'})
    assert limits['joint2_motor'] == ('continuous', {'effort': '0.5', 'velocity': '2.0'})
    system = root.find('ros2_control')
    assert system.findtext('hardware/plugin') == 'mock_components/GenericSystem'
    takes = {joint.get('name'): [one.get('name') for one in joint.iter('command_interface')]
             for joint in system.iter('joint')}
    assert takes == {'joint1': [], 'joint2': [], 'joint1_motor': ['effort'],
                     'joint2_motor': ['effort']}


def test_a_rigid_robot_takes_efforts_at_its_links():
    text = robot_urdf(robot(stiffness=[np.inf, np.inf]), plugin='some/System')
    system = ElementTree.fromstring(text).find('ros2_control')
    assert [joint.get('name') for joint in system.iter('joint')
            if joint.find('command_interface') is not None] == ['joint1', 'joint2']
