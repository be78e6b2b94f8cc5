# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Arms of a URDF: rigid-body terms against MuJoCo and the planar closed form; what is refused."""

from dataclasses import replace
from pathlib import Path
import warnings
import xml.etree.ElementTree as ElementTree

from bench.chain_matrices import matrices
import core_runs
from core_runs import affected, effect_on
from gms_flex_control import load_robot, read_plan, records, save_robot
from gms_flex_control.cli.main import main
from gms_flex_control.discrepancy.nuisance import nuisances_of, tuned, with_nuisances
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import base as sig
from gms_flex_control.effects.table import with_changes
from gms_flex_control.errors import ConfigError, ParameterError, TrajectoryError
from gms_flex_control.file_io import robot_file
from gms_flex_control.schema.urdf import robot_urdf
from gms_flex_control.schema.urdf_arm import read_links
from gms_flex_control.simulation import plant
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import require_within
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / 'examples'
ARMS = {name: EXAMPLES / name / 'robot.yaml' for name in ('industrial_arm', 'light_arm')}
JOINTS = ('lift', 'turn', 'reach', 'bend', 'twist', 'tip')
LINK = """<link name="{0}"><inertial><origin xyz="{1}" rpy="{2}"/><mass value="{3}"/>
<inertia ixx="0.05" ixy="0.004" ixz="-0.003" iyy="0.04" iyz="0.002" izz="0.03"/></inertial></link>
"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>
<origin xyz="{4}" rpy="{5}"/><axis xyz="{6}"/><limit lower="-3" upper="3" velocity="2" effort="9"/>
</joint>
"""


def crooked(seed=1):
    """Return the URDF of an arm of askew axes, two of them prismatic, with fixed links between."""
    rng = np.random.default_rng(seed)

    def three(size):
        return ' '.join(repr(float(x)) for x in rng.uniform(-size, size, 3))
    kinds = {'lift': 'prismatic', 'reach': 'prismatic', 'twist': 'continuous'}
    text, last = LINK.format('root', '0 0 0', '0 0 0', 5.0), 'root'
    for name in JOINTS:
        text += LINK.format(f'{name}_link', three(0.2), three(1.0), rng.uniform(0.5, 3.0))
        text += JOINT.format(name, kinds.get(name, 'revolute'), last, f'{name}_link', three(0.4),
                             three(1.5), three(1.0))
        text += LINK.format(f'{name}_box', three(0.1), three(1.0), rng.uniform(0.1, 1.0))
        text += JOINT.format(f'{name}_screws', 'fixed', f'{name}_link', f'{name}_box', three(0.1),
                             three(1.0), '0 0 1')
        last = f'{name}_box' if name == 'bend' else f'{name}_link'
    return f'<robot name="crooked">{text}<link name="tool"/>' + JOINT.format(
        'tool_mount', 'fixed', last, 'tool', '0 0 0.1', '0 0 0', '0 0 1') + '</robot>'


def arm_of(path, joints, like):
    """Return the links of a URDF with the motors of an ArmParams, the first ones."""
    links, n = read_links(path, joints), len(joints)
    return replace(like, frames=links.frames, mass=links.mass, com=links.com,
                   inertia=links.inertia, **{name: np.resize(getattr(like, name), n) for name in (
                       'length', 'motor_inertia', 'stiffness', 'damping', 'offset')})


@pytest.fixture
def crooked_arm(tmp_path):
    """Return the crooked arm, gravity along none of its axes."""
    (tmp_path / 'arm.urdf').write_text(crooked())
    like = replace(load_robot(ARMS['industrial_arm']).arm, gravity=[1.0, -2.0, -9.0])
    return arm_of(tmp_path / 'arm.urdf', JOINTS, like)


@pytest.mark.parametrize('name', ['industrial_arm', 'crooked_arm'])
def test_many_states_agree_with_mujoco(name, crooked_arm):
    """The URDF is read by MuJoCo itself, which merges fixed links its own way."""
    mujoco = pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    arm = crooked_arm if name == 'crooked_arm' else load_robot(ARMS[name]).arm
    arm = replace(arm, stiffness=np.ones(arm.n_joints))  # no motor is part of M
    n, rng = arm.n_joints, np.random.default_rng(3)
    model = mujoco.MjModel.from_xml_string(Path(arm.frames.source).read_text())
    model.opt.gravity[:] = arm.gravity
    data, full = mujoco.MjData(model), np.zeros((n, n))
    q, dq, ddq = rng.uniform(-2.0, 2.0, (3, 200, n))
    needed = chain.inverse_dynamics(q, dq, ddq, arm)
    work, links = records.build(chain.work_layout(n)), chain.constants_of(arm)
    for k in range(200):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        expected = full @ ddq[k] + data.qfrc_bias
        np.testing.assert_allclose(needed[k], expected, rtol=0,
                                   atol=1e-10 * np.abs(expected).max())
        work.tau[:] = needed[k]
        chain.accelerations(q[k], dq[k], links, work)
        np.testing.assert_allclose(work.acceleration, ddq[k], rtol=0, atol=1e-9)


def test_a_planar_chain_written_as_urdf_has_the_terms_of_the_closed_form(tmp_path):
    """M, C and g with both time derivatives; C is that of the Christoffel symbols in both."""
    n, rng = 2, np.random.default_rng(2)
    paper = load_robot(robot_file())
    planar = replace(paper.arm, gravity=[1.5, -9.0], **{
        name: rng.uniform(0.2, 1.0, n) for name in (
            'mass', 'length', 'com', 'inertia', 'motor_inertia', 'damping', 'offset')},
        stiffness=np.r_[np.inf, np.full(n - 1, 9.0)])
    joints = tuple(f'j{j}' for j in range(n))
    path = tmp_path / 'planar.urdf'
    friction = replace(paper.friction.of_joints(np.arange(n) % 2), stiffness=np.ones((n, 1)),
                       weight=np.ones((n, 1)), attraction=np.ones(n))
    path.write_text(robot_urdf(replace(
        paper, joints=joints, motors=('',) + tuple(f'm{j}' for j in range(1, n)), arm=planar,
        friction=friction), motors=False))
    links = read_links(path, joints)  # offsets are in the URDF
    lifted = replace(planar, kind='urdf', frames=links.frames, mass=links.mass, com=links.com,
                     inertia=links.inertia, length=np.zeros(n), offset=np.zeros(n),
                     gravity=[1.5, -9.0, 0.0])
    q, dq, ddq, d3q = rng.uniform(-2.0, 2.0, (4, n))
    for one, other in zip(matrices(q, dq, ddq, d3q, planar),
                          matrices(q, dq, ddq, d3q, lifted), strict=True):
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-12 * max(1.0, np.abs(one).max()))
    work, m = [records.build(chain.work_layout(n), tau=ddq, implicit=[0.3, 0.6])
               for _ in range(2)], []
    for arm, space in zip((planar, lifted), work, strict=True):
        terms, out, between = chain.constants_of(arm), np.empty((2, n)), np.empty((n, n))
        chain.accelerations(q, dq, terms, space)
        chain.mass_times(ddq, terms, space, out[0])
        chain.mass_solve(ddq, terms, space, out[1])
        chain.mass_between(np.arange(n), terms, space, between)
        energy = core_runs.energy(q, dq, q, dq, arm)
        m.append([space.acceleration.copy(), *out, *between, energy])
    for one, other in zip(*m, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-11)


def test_derivatives_are_those_of_finite_differences(crooked_arm):
    def at(t):
        return [2.0 ** k * np.sin(2.0 * t + np.arange(6) + 0.5 * np.pi * k) for k in range(4)]
    t, step = 0.4, 1e-5
    before, now, after = (matrices(*at(t + k * step), crooked_arm) for k in (-1, 0, 1))
    for name in ('mass', 'coriolis', 'gravity'):
        for lower, upper in (('', 'd'), ('d', 'dd')):
            reported = getattr(now, upper + name)
            slope = (getattr(after, lower + name) - getattr(before, lower + name)) / (2 * step)
            np.testing.assert_allclose(reported, slope, rtol=0, atol=1e-7 * np.abs(slope).max())
    skew = now.dmass - 2.0 * now.coriolis
    np.testing.assert_allclose(skew, -skew.T, atol=1e-11)


def test_the_robot_is_saved_and_read_back(tmp_path):
    robot = load_robot(ARMS['light_arm'])
    for arm in (robot.arm, robot.arm.scaled(np.linspace(0.5, 2.0, 7)),
                replace(robot.arm, com=1.1 * robot.arm.com)):
        save_robot(replace(robot, arm=arm), tmp_path / 'other' / 'robot.yaml')
        again = load_robot(tmp_path / 'other' / 'robot.yaml').arm
        for name in ('mass', 'com', 'inertia', 'gravity', 'stiffness', 'motor_inertia'):
            np.testing.assert_allclose(getattr(again, name), getattr(arm, name), rtol=1e-14)


INERTIAL = '<inertial><mass value="{}"/><inertia ixx="{}" ixy="0" ixz="0" iyy="{}" iyz="0" ' \
           'izz="{}"/></inertial>'
GOOD = INERTIAL.format(1, 0.1, 0.1, 0.1)
TWO = ('<robot name="r"><link name="base"/><link name="a">{a}</link><link name="b">{b}</link>'
       '<joint name="j1" type="{kind}"><parent link="base"/><child link="a"/>'
       '<axis xyz="{axis}"/><limit lower="{lower}" upper="2" effort="1" velocity="1"/></joint>'
       '<joint name="j2" type="revolute"><parent link="a"/><child link="b"/>'
       '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
       '{more}</robot>')
BRANCH = ('<link name="c">' + GOOD + '</link><joint name="finger" type="prismatic"><parent '
          'link="a"/><child link="c"/><axis xyz="1 0 0"/></joint>')


def two(**changes):
    """Return a URDF of two joints with other texts in it."""
    return TWO.format(**{'a': GOOD, 'b': GOOD, 'kind': 'revolute', 'axis': '0 1 0', 'lower': -2,
                         'more': ''} | changes)


@pytest.mark.parametrize(('text', 'sentence'), [
    (two(b=''), "link 'b', which joint 'j2' moves, has no <inertial>: give it mass and inertia"),
    (two(a='<visual/>'), "link 'a' has a shape but no <inertial>"),
    (two(a=INERTIAL.format(-1, 0.1, 0.1, 0.1)), "link 'a' has mass -1 kg: give a mass above 0"),
    (two(a=INERTIAL.format(1, 0.1, 0.1, -0.1)), 'each must be above 0'),
    (two(a=INERTIAL.format(1, 0.1, 0.1, 0.3)), 'no body has one above the sum of the other two'),
    (two(a=INERTIAL.format(1, 'x', 0.1, 0.1)), "ixx of <inertia> must be a number, got 'x'"),
    (two(a='<inertial><mass value="1"/></inertial>'), "link 'a' lacks ixx of <inertia>"),
    (two(a=INERTIAL.format(1, 1e4, 1e4, 1e4)), 'inertia of 10000 kg m.2 at 1 kg.*like kg mm.2'),
    (two(a=GOOD.replace('<inertial>', '<inertial><origin xyz="0 0 150"/>')),
     "link 'a' has an <origin> 150 m away: it looks like millimetres"),
    (two(kind='floating'), 'name the link beyond it with arm.base'),
    (two(kind='fixed'), "joint 'j1' is fixed and cannot be one of joints"),
    (two(kind='revolut'), "has the type 'revolut'; did you mean 'revolute'"),
    (two(axis='0 0 0'), 'axis 0 0 0: give its direction'),
    (two(axis='0 1'), "xyz of <axis> must be 3 numbers, got '0 1'"),
    (two(lower=-120), 'they look like degrees'),
    (two(more='<joint name="loop" type="fixed"><parent link="base"/><child link="b"/></joint>'),
     "link 'b' is moved by two joints, 'j2' and 'loop': closed chains are not supported"),
    (two(more='<joint name="on" type="fixed"><parent link="b"/><child link="hand"/></joint>'),
     "names the link 'hand', which is not there"),
    (two(more=BRANCH), "'finger' is a branch or goes on beyond the chain.*set arm.tip: b"),
    (two().replace('j2', 'elbow'), "has no joint 'j2' that 'joints' of the robot file names; it "
                                   'has j1, elbow'),
    ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
     'has xacro that is not expanded; expand it with: xacro arm.urdf > arm_expanded.urdf'),
    ('<sdf/>', 'its root is <sdf>, not <robot>'),
    ('<robot>', 'is not XML'),
])
def test_a_urdf_that_is_no_arm_is_refused_in_a_sentence(text, sentence, tmp_path):
    (tmp_path / 'arm.urdf').write_text(text)
    with pytest.raises(ConfigError, match=sentence):
        read_links(tmp_path / 'arm.urdf', ('j1', 'j2'))


@pytest.mark.parametrize(('moments', 'taken', 'warned'), [
    ((0.00191, 0.00846, 0.01059), (0.00202, 0.00857, 0.01059), True),  # as of a real arm's link
    ((0.0, 0.1, 0.1), (2e-6, 0.1, 0.1), False),                        # a rod
    ((0.0, 0.0, 0.0), (2e-6, 2e-6, 2e-6), False),                      # a point
    ((0.1, 0.1, 0.2), (0.1, 0.1, 0.2), False),                         # a plate
])
def test_an_inertia_that_no_body_has_becomes_the_nearest(moments, taken, warned, tmp_path):
    """The second moments of the body, half the trace less a moment, are none below 0."""
    path = tmp_path / 'arm.urdf'
    path.write_text(two(b=INERTIAL.format(1, *moments)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        found = read_links(path, ('j1', 'j2')).inertia[1]
    np.testing.assert_allclose(np.linalg.eigvalsh(found), taken, atol=3e-6)
    assert [str(one.message)[:8] for one in caught] == ["link 'b'"] * warned


def test_the_chain_is_chosen_by_joints_base_and_tip(tmp_path):
    """What is held at 0 beside the chain is carried; what lies before the base is not."""
    path = tmp_path / 'arm.urdf'
    path.write_text(two(more=BRANCH))
    np.testing.assert_array_equal(read_links(path, ('j1', 'j2'), tip='b').mass, [2.0, 1.0])
    np.testing.assert_array_equal(read_links(path, ('j1', 'finger'), tip='c').mass, [2.0, 1.0])
    np.testing.assert_array_equal(read_links(path, ('j2',), base='a', tip='b').mass, [1.0])
    for joints, options, sentence in (
            (('j2', 'j1'), {'tip': 'b'}, r'from the base outwards: \[j1, j2\]'),
            (('j2',), {'tip': 'b'}, "joint 'j1' moves within the chain, but joints does not"),
            (('j1', 'j2', 'finger'), {}, 'it is a branch'),
            (('j1',), {'tip': 'hand'}, "has no link 'hand' that arm.tip names"),
            (('j2',), {'base': 'bass'}, "has no link 'bass' that arm.base names")):
        with pytest.raises(ConfigError, match=sentence):
            read_links(path, joints, **options)
    with pytest.raises(ConfigError, match='cannot be read .No such file.*relative to the robot'):
        read_links(tmp_path / 'none.urdf', ('j1',))


def test_a_fixed_link_with_a_shape_alone_weighs_nothing(tmp_path):
    """As flanges and tool frames of many URDFs; the robot file may leave motor sides out."""
    flange = ('<link name="flange"><collision/></link><joint name="end" type="fixed">'
              '<parent link="b"/><child link="flange"/></joint>')
    (tmp_path / 'arm.urdf').write_text(two(more=flange))
    np.testing.assert_array_equal(read_links(tmp_path / 'arm.urdf', ('j1', 'j2')).mass, 1.0)
    (tmp_path / 'robot.yaml').write_text(
        '/**: {ros__parameters: {joints: [j1, j2], motors: ["", ""], '
        'arm: {kind: urdf, urdf: arm.urdf, gravity_vector: [0.0, 0.0, -9.81]}}}')
    arm = load_robot(tmp_path / 'robot.yaml', to_identify=True).arm
    assert arm.rigid.all() and not arm.motor_inertia.any()


@pytest.mark.parametrize(('old', 'new', 'sentence'), [
    ('urdf: light_arm.urdf', 'urdf: lost.urdf', r'robot.yaml:\d+: arm.urdf .*lost.urdf: cannot'),
    ('gravity_vector: [0.0, 0.0, -9.81]', 'gravity: 9.81', 'give arm.gravity_vector'),
    ('gravity_vector: [0.0, 0.0, -9.81]', 'gravity_vector: [9.81]', 'must have three numbers'),
    ('kind: urdf', 'kind: planar', r'arm.joint1.inertia is missing'),
    ('stiffness: 6000.0', 'mass: 3.0\n        stiffness: 6000.0', 'the URDF states it')])
def test_a_robot_file_that_contradicts_its_urdf_is_refused(old, new, sentence, tmp_path):
    text = ARMS['light_arm'].read_text()
    assert old in text
    (tmp_path / 'light_arm.urdf').write_text(ARMS['light_arm'].with_name(
        'light_arm.urdf').read_text())
    (tmp_path / 'robot.yaml').write_text(text.replace(old, new, 1))
    with pytest.raises((ConfigError, ParameterError), match=sentence):
        load_robot(tmp_path / 'robot.yaml')


@pytest.mark.parametrize('effects', [(), (effect_on('joint4', 'link_inertia_error', 0.3),)])
def test_what_a_search_retunes_of_the_links_is_what_is_written(effects, tmp_path):
    robot = replace(load_robot(ARMS['light_arm']), effects=effects)
    base = plant.constants_of(robot)
    nuisances = nuisances_of(robot)
    x = np.random.default_rng(0).uniform(-0.04, 0.04, len(nuisances))
    save_robot(with_nuisances(robot, nuisances, x), tmp_path / 'robot.yaml')
    made = plant.constants_of(load_robot(tmp_path / 'robot.yaml')).chain
    asked = tuned(base, nuisances, x, plant.constants_of(replace(robot, effects=()))).chain
    for name in asked.dtype.names:
        np.testing.assert_allclose(made[name], asked[name], rtol=1e-9, atol=1e-15, err_msg=name)
    assert not np.allclose(asked.mass, base.chain.mass, rtol=1e-3)


def test_poses_lie_within_the_ranges_and_show_the_inertias():
    arm = load_robot(ARMS['industrial_arm']).arm
    q = chain.configurations(arm, 500)
    assert np.all((q >= arm.frames.lower) & (q <= arm.frames.upper))
    assert np.all(np.ptp(q, axis=0) > 1.9 * np.minimum(arm.frames.upper, np.pi))
    masses = chain.mass_matrices(q, arm)
    still = np.zeros(6)
    for k in (0, 7, 123):
        np.testing.assert_allclose(masses[k], matrices(q[k], still, still, still, arm).mass,
                                   rtol=1e-11, atol=1e-12)
    own, motors = chain.own_inertia(chain.constants_of(arm))
    np.testing.assert_allclose(own + motors, np.diag(masses[0]), rtol=1e-12)


def test_what_does_not_know_such_an_arm_says_so(tmp_path, capsys):
    robot = str(ARMS['light_arm'])
    assert main(['urdf', '--robot', robot, '--out', str(tmp_path / 'arm.urdf')]) == 0
    names = load_robot(robot).joints
    np.testing.assert_array_equal(read_links(tmp_path / 'arm.urdf', names).inertia,
                                  load_robot(robot).arm.inertia)
    assert '<dynamics damping="6.0" friction="7.0" />' in (tmp_path / 'arm.urdf').read_text()
    root, frames = ElementTree.parse(tmp_path / 'arm.urdf'), load_robot(robot).arm.frames
    for name in ('lower', 'upper', 'velocity', 'effort'):
        assert [float(root.find(f"joint[@name='{joint}']/limit").get(name))
                for joint in names] == getattr(frames, name).tolist()
    assert main(['urdf', '--robot', robot, '--ros2-control', 'x/Y']) != 0
    assert 'belong into that file' in capsys.readouterr().err
    assert main(['export', '--to', 'mujoco', '--robot', robot]) != 0
    assert 'MuJoCo reads' in capsys.readouterr().err
    payload = tmp_path / 'payload.yaml'
    payload.write_text('/**:\n  ros__parameters:\n    effects.arm.tip_payload.mass: 1.0\n')
    save_robot(load_robot([robot, payload]), tmp_path / 'saved.yaml')
    assert [spec.values for spec in load_robot(tmp_path / 'saved.yaml').effects] == [(1.0,)]


def hidden(robot, name, *values, joint='arm'):
    """Return a robot with an effect put into its parameters."""
    return with_changes(affected(robot, joint, name, *values))


@pytest.mark.parametrize('tip', ['', 'tool'])
def test_a_payload_at_the_tip_is_a_link_on_a_fixed_joint_there(tip, tmp_path):
    """Without arm.tip it hangs on the frame farthest from the last joint, here the tool's."""
    text = crooked().replace('xyz="0 0 0.1"', 'xyz="0.3 -0.2 0.9"')
    ball = text.replace('<link name="tool"/>', LINK.format('tool', '0 0 0', '0 0 0', 0.7).replace(
        '"0.05"', '"1e-12"').replace('"0.04"', '"1e-12"').replace('"0.03"', '"1e-12"').replace(
        '"0.004"', '"0"').replace('"-0.003"', '"0"').replace('"0.002"', '"0"'))
    robot, found = load_robot(ARMS['industrial_arm']), []
    for name, content in (('bare', text), ('loaded', ball)):
        path = tmp_path / f'{name}.urdf'
        path.write_text(content)
        links = read_links(path, JOINTS, tip=tip)
        found.append(replace(robot.arm, frames=links.frames, mass=links.mass, com=links.com,
                             inertia=links.inertia))
    bare, loaded = found
    changed = hidden(replace(robot, arm=bare), 'tip_payload', 0.7).arm
    for name in ('mass', 'com', 'inertia'):
        np.testing.assert_allclose(getattr(changed, name), getattr(loaded, name), atol=1e-10)
    assert not np.allclose(changed.com[-1], bare.com[-1])


def test_a_tilted_base_turns_gravity_towards_a_direction():
    """Level, from the x axis towards y; hung on a wall, in the plane across gravity."""
    robot = load_robot(ARMS['industrial_arm'])
    found = hidden(robot, 'gravity_tilt', 0.1, 0.4).arm.gravity
    np.testing.assert_allclose(found, 9.81 * np.array([
        np.sin(0.1) * np.cos(0.4), np.sin(0.1) * np.sin(0.4), -np.cos(0.1)]), rtol=1e-12)
    wall = replace(robot, arm=replace(robot.arm, gravity=[-9.81, 0.0, 0.0]))
    found = hidden(wall, 'gravity_tilt', 0.1, 0.0).arm.gravity
    np.testing.assert_allclose(found, 9.81 * np.array([-np.cos(0.1), np.sin(0.1), 0.0]),
                               rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(('axis', 'cosine'), [
    ('0 0 1', 1.0), ('0 0.6 0.8', 0.8), ('0 1 0', 0.0), ('0 0 -1', -1.0)])
def test_a_motor_carried_by_a_link_is_coupled_by_the_cosine_of_both_axes(axis, cosine, tmp_path):
    """At rest M q'' + S cos e_1 q_m'' = 0 and J q_m'' + S cos q_1'' = u."""
    (tmp_path / 'arm.urdf').write_text(two(axis='0 0 1').replace(
        '<axis xyz="0 0 1"/><limit lower="-1"', f'<axis xyz="{axis}"/><limit lower="-1"'))
    robot = load_robot(ARMS['industrial_arm'])
    arm = replace(arm_of(tmp_path / 'arm.urdf', ('j1', 'j2'), robot.arm), gravity=np.zeros(3))
    friction = robot.friction.of_joints([0, 1])
    coupling, motor = 0.05, arm.motor_inertia[1]
    pair = replace(robot, joints=('j1', 'j2'), motors=('m1', 'm2'), arm=arm, friction=friction,
                   effects=(effect_on('j2', 'motor_inertia_coupling', coupling),))
    state, work = plant.init(pair), plant.workspace(2)
    command = np.array([0.0, 3.0])
    for _ in range(30):  # the accelerations of the substep before converge
        plant.advance(state, command, 0.0, 1e-12, 1, plant.constants_of(pair), work)
    mass = np.zeros((3, 3))
    mass[:2, :2] = chain.mass_matrices(np.zeros((1, 2)), arm)[0]
    mass[2, 2], mass[0, 2] = motor, coupling * cosine
    mass[2, 0] = mass[0, 2]
    q1, _, q_motor = np.linalg.solve(mass, [0.0, 0.0, 3.0])
    found = work.signals[0, sig.DDQ_LINK], work.signals[1, sig.DDQ_MOTOR]
    assert found == pytest.approx((q1, q_motor), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(('name', 'value', 'sentence'), [
    ('joint2.amplitude', 1.7, r'joint2 goes to -?1\.7 rad at .* s, beyond its limit of -?1.6 rad'),
    ('joint6.period', 0.3, r'joint6 moves at .* rad/s at .*, beyond its limit of -?7 rad/s'),
    ('joint4.amplitude', 0.5, None)])
def test_a_motion_beyond_the_limits_of_the_urdf_is_refused(name, value, sentence):
    files = [ARMS['industrial_arm'].with_name(f'{what}.yaml')
             for what in ('robot', 'controller', 'trajectory')]
    overrides = {f'trajectory.{name}': value}
    if sentence is None:
        assert read_plan(files, overrides=overrides).trajectory.n_joints == 6
        return
    with pytest.raises(TrajectoryError, match=f'{sentence} in .*industrial_arm.urdf; reduce'):
        read_plan(files, overrides=overrides)


def test_a_robot_that_stands_beyond_a_limit_may_move_inwards():
    frames = load_robot(ARMS['industrial_arm']).arm.frames
    joints, still = [f'joint{j}' for j in range(1, 7)], np.zeros(6)
    outside = still + [0.0, 1.7, 0.0, 0.0, 0.0, 0.0]
    inwards = builders.approach(builders.at_rest(outside), builders.hold(still), 0.0)
    require_within(inwards, joints, frames, still)
    with pytest.raises(TrajectoryError, match='joint2 goes to 1.9 rad'):
        require_within(builders.approach(builders.at_rest(outside), builders.hold(
            outside + [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]), 0.0), joints, frames, still)
    offset = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])  # as the URDF counts
    with pytest.raises(TrajectoryError, match='joint2 goes to 1.8 rad'):
        require_within(builders.via_points([still, 2.6 * offset], 2.0, 0.0), joints, frames,
                       offset)
