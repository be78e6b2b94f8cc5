# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Parameter files: what they say comes through, and what is wrong is said with its line."""

from dataclasses import fields, replace
from pathlib import Path
import re
import warnings

from core_runs import effect_on
from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.experiment.simulated import read_plan, simulate
from gms_flex_control.file_io import controller_file, robot_file, share_path
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.schema import files
from gms_flex_control.schema.keys import controller_keys
import numpy as np
import pytest

pytestmark = pytest.mark.fast

CONFIG = Path(__file__).parents[1] / 'config'
ROBOT = (CONFIG / 'robot.yaml').read_text(encoding='utf-8')
CONTROLLER = (CONFIG / 'controller.yaml').read_text(encoding='utf-8')
EFFECTS = ROBOT + '    effects:\n      {}:\n        {}\n'


def written(folder, text, name='robot.yaml'):
    """Write a file and return its path."""
    path = folder / name
    if isinstance(text, bytes):
        path.write_bytes(text)
    else:
        path.write_text(text, encoding='utf-8')
    return path


def changed(old, new, text=ROBOT):
    """Return the text with the first ``old`` replaced, which must be there."""
    assert old in text
    return text.replace(old, new, 1)


def line_of(fragment, text):
    """Return the line number, from 1, of the first line with ``fragment``."""
    return next(k for k, line in enumerate(text.splitlines(), 1) if fragment in line)


def test_the_default_robot_is_the_papers(robot):
    """Tables 1 to 3; the arm is assumed and says so in its file."""
    assert robot.joints == ('joint1', 'joint2')
    assert robot.motors == ('joint1_motor', 'joint2_motor')
    for side, name, printed in (
            ('forward', 'static', [0.10787, 0.10697]),
            ('forward', 'coulomb', [0.09393, 0.09087]),
            ('forward', 'velocity', [0.00846, 0.07819]),
            ('forward', 'viscous', [0.06589, 0.00374]),
            ('backward', 'static', [0.10433, 0.09470]),
            ('backward', 'coulomb', [0.08997, 0.08363]),
            ('backward', 'velocity', [0.00489, 0.05795]),
            ('backward', 'viscous', [0.07410, 0.00530])):
        np.testing.assert_array_equal(getattr(getattr(robot.friction, side), name), printed)
    np.testing.assert_array_equal(robot.friction.stiffness, [
        [2.26, 5.93, 6.95, 64.24, 11.45, 111.41], [0.12, 16.08, 19.81, 75.86, 138.10, 150.58]])
    np.testing.assert_allclose(robot.friction.weight, 1 / 6, rtol=1e-15)
    np.testing.assert_array_equal(robot.friction.attraction, [1.5, 1.0])
    np.testing.assert_array_equal(robot.arm.gravity, [0.0, 0.0])
    for name in ('mass', 'length', 'motor_inertia', 'stiffness'):
        assert '(assumed' in ROBOT.splitlines()[line_of(f' {name}:', ROBOT) - 1]


def test_the_default_gains_are_the_papers(gains):
    """Section 6; k_e is another one, as its file says."""
    assert gains.compensation == 'gms'
    for name, printed in {'kd_link': 0.8, 'lambda_link': 3.0, 'kd_motor': [0.2, 0.22],
                          'lambda_motor': [30.0, 40.0], 'sign_slope': 50.0}.items():
        np.testing.assert_array_equal(getattr(gains, name), printed)


def assert_same(one, other):
    """Compare two parameter objects field by field, to the last bit."""
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if hasattr(a, '__dataclass_fields__'):
            assert_same(a, b)
        else:
            np.testing.assert_array_equal(a, b, err_msg=field.name)


def test_a_saved_robot_is_read_back_as_it_was(robot, tmp_path):
    """To the last bit, effects, gravity and a rigid joint included."""
    rng = np.random.default_rng(0)
    arm = replace(robot.arm, gravity=9.81, stiffness=[np.inf, 1.0 / 3.0],
                  mass=rng.uniform(0.1, 1.0, 2), offset=rng.uniform(-2.0, 2.0, 2))
    friction = replace(robot.friction, forward=replace(
        robot.friction.forward, viscous=rng.uniform(0.0, 0.1, 2)))
    effects = (effect_on('joint2', 'backlash', 0.1 / 3), effect_on(
        'joint1', 'torque_ripple', 0.01, 12.0, -0.3), effect_on('arm', 'gravity_tilt', 0.01, 1.0))
    before = replace(robot, motors=('', 'joint2_motor'), arm=arm, friction=friction,
                     effects=effects)
    files.save_robot(before, tmp_path / 'saved.yaml', comment=files.wrapped(
        ['Found by', 12 * 'nine chars ']) + '\nand  a table')
    after = files.load_robot(tmp_path / 'saved.yaml')
    assert_same(replace(after, effects=()), replace(before, effects=()))
    assert set(after.effects) == set(before.effects)
    text = (tmp_path / 'saved.yaml').read_text(encoding='utf-8')
    assert text.startswith('# Found by\n# ' + ' '.join(8 * ['nine chars'])
                           + '\n#     ' + ' '.join(4 * ['nine chars'])
                           + '\n# and  a table\n/**:\n')


def test_whole_numbers_are_taken_for_doubles(tmp_path):
    path = written(tmp_path, changed('mass: 1.0 ', 'mass: 2 '))
    assert files.load_robot(path).arm.mass[1] == 2.0


def test_identified_friction_before_the_robot_file_is_said_to_be_lost(tmp_path, robot):
    """Given last it wins in silence; so does friction that was identified anew, or a part."""
    plain = written(tmp_path, ROBOT)
    named = tmp_path / 'friction.yaml'
    files.save_robot(replace(robot, identified_from=('bag, 10.000 s',)), named)
    alone = tmp_path / 'alone.yaml'
    files.save_values({name: value for name, (value, _) in files.read_parameters(named).items()
                       if name.startswith('friction.')}, alone)
    for first in (named, alone):
        with pytest.warns(UserWarning, match=f'friction of {first} is not used.* give it last'):
            files.load_robot([first, plain])
    part = tmp_path / 'part.yaml'
    files.save_values({'friction.joint1.attraction': 2.0}, part)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for order in ([plain, named], [plain, alone], [plain, plain], [named, named],
                      [named, alone], [named, part], [plain, named, part]):
            files.load_robot(order)


def test_a_file_may_hold_robot_and_controller_and_settings_of_nodes(robot, tmp_path):
    whole = ROBOT + CONTROLLER.split('ros__parameters:\n')[1] + '    rate: 1000.0\n'
    path = written(tmp_path, whole)
    assert_same(files.load_robot(path), robot)
    assert files.load_controller(path, robot).compensation == 'gms'


# what is wrong: (old text, new text), the line it stands on, the sentence
WRONG = [
    ('mass: 2.3 ', 'mass: heavy ', "arm.joint1.mass must be a number [kg], got 'heavy'"),
    ('mass: 2.3 ', 'mass: true ', 'arm.joint1.mass must be a number [kg], got True'),
    ('mass: 2.3 ', 'mass: .nan ', 'arm.joint1.mass must be finite, got nan'),
    ('mass: 2.3 ', f'mass: 1{400 * "0"} ', 'arm.joint1.mass must be finite, got inf'),
    ('inertia: 0.0075 ', 'inertia: -0.0075 ',
     'arm.joint2.inertia must be from 0 to 1e+09 kg m^2, got -0.0075'),
    ('motor_inertia: 0.006 ', 'motor_inertai: 0.006 ',
     'arm.joint1.motor_inertai is not a known parameter; did you mean '
     "'arm.joint1.motor_inertia'?"),
    ('counts: 20000.0 ', 'count: 20000.0 ',
     "encoder.count is not a known parameter; did you mean 'encoder.counts'?"),
    ('      joint2:\n        mass: 1.0 ', '      joint3:\n        mass: 1.0 ',
     "arm.joint3.mass is not a known parameter; unknown joint 'joint3'; did you mean 'joint2'?"),
    ('static: 0.10787 ', 'static: 0.08 ',
     'friction.joint1.forward: static 0.08 is below coulomb 0.09393: the Stribeck curve would '
     'rise with speed; were they swapped?'),
    ('weight: [0.16666666666666666', 'weight: [0.2',
     'friction.joint1.weight sums to 1.03333, not to 1; divide each weight'),
    ('[2.26, ', '[two, ',
     "friction.joint1.stiffness must be a list of numbers [N m/rad], got ['two', 5.93"),
    ('[2.26, ', '[.nan, ', 'friction.joint1.stiffness must be finite, got nan'),
    ('joints: [joint1, joint2]', 'joints: joint1', "joints must be a list of texts, got 'joint1'"),
    ('joints: [joint1, joint2]', 'joints: []', 'joints is empty: name at least one'),
    ('joints: [joint1, joint2]', 'joints: [joint1, joint1]', "joints names 'joint1' twice"),
    ('counts: 20000.0 ', 'counts: {} ', 'encoder.counts must be a number, got {}'),
    ('counts: 20000.0 ', 'counts: -1.0 ', 'encoder.counts must be at least 0, got -1'),
    ('counts: 20000.0 ', 'counts: many ', "encoder.counts must be a number, got 'many'"),
    ('motors: [joint1_motor, joint2_motor]', 'motors: [joint1_motor]',
     'motors describes 1 joints, but joints names 2'),
    ('kind: planar', 'kind: planer',
     "arm.kind must be one of planar, decoupled, urdf, got 'planer'; did you mean 'planar'?"),
    ('    arm:', '\tarm:', 'is not valid YAML (found character'),
    ('        length: 0.35 ', '        mass: 0.35 ',
     'is not valid YAML (found duplicate key "mass"')]


def refused(load, *given):
    """Return the sentence that files are refused with."""
    with pytest.raises((ConfigError, ParameterError)) as error:
        load(*given)
    return str(error.value)


@pytest.mark.parametrize(('old', 'new', 'sentence'), WRONG)
def test_what_is_wrong_in_a_robot_file_is_said_with_its_line(old, new, sentence, tmp_path):
    text = changed(old, new)
    path = written(tmp_path, text)
    message = refused(files.load_robot, path)
    assert sentence in message and '\n' not in message
    found = re.match(re.escape(str(path)) + r':(\d+): ', message)
    assert found, message
    assert abs(int(found[1]) - line_of(new.splitlines()[-1].rstrip(), text)) <= 1


@pytest.mark.parametrize(('text', 'sentence'), [
    *((EFFECTS.format(joint, lines), sentence) for joint, lines, sentence in (
        ('joint1', 'backlsh: {half_gap: 0.1}', "effects.joint1.backlsh.half_gap: effect 'backlsh' "
         "is not in the catalogue; did you mean 'backlash'?"),
        ('joint9', 'backlash: {half_gap: 0.1}', "unknown joint 'joint9'; did you mean 'joint"),
        ('joint1', 'backlash: {half_gp: 0.1}', "backlash has no parameter 'half_gp'; did you mean "
         "'half_gap'?"),
        ('joint1', 'backlash: {half_gap: -0.1}', 'half_gap must be at least 0 rad, got -0.1'),
        ('joint1', 'backlash: {half_gap: wide}', "half_gap must be a number [rad], got 'wide'"),
        ('joint1', 'backlash: {}', 'effects.joint1.backlash must have the form'),
        ('joint1', 'backlash: 0.1', 'must have the form effects.<joint>.<effect>.<parameter>'),
        ('joint1', 'tip_payload: {mass: 0.1}', 'tip_payload belongs under effects.arm'),
        ('arm', 'backlash: {half_gap: 0.1}', 'backlash belongs under effects.<joint>'),
        ('joint1', 'torque_ripple: {amplitude: 0.1}', 'effects.joint1.torque_ripple.order [1] is '
         'missing: periods per revolution'))),
    ('', "is not a ROS parameter file; it begins with '/**:' and 'ros__parameters:'"),
    ('a: 1\n', 'is not a ROS parameter file'),
    ('- 1\n', 'is not a ROS parameter file'),
    ("'/**': 3\n", 'is not a ROS parameter file'),
    ('/**:\n  ros__parameters:\n', 'joints is missing: the robot file lists the names of'),
    ('#' * 1_000_001, 'larger than 1000000 bytes'),
    (b'\xff\xfe\x00', 'is not UTF-8 text'),
    (changed('joint1:\n        mass', 'joint1: [\n        mass'), 'is not valid YAML'),
    (changed('        motor_inertia: 0.006 ', '        # '),
     'arm.joint1.motor_inertia is missing: motor inertia reflected to the joint [kg m^2]'),
    (changed('[2.26, 5.93,', '[5.93,'), 'friction.joint1: stiffness has 5 blocks and weight 6'),
    (changed('attraction: 1.5', 'attraction: 0.0'),
     'friction.joint1.attraction must be above 0 N m/s, got 0'),
    (changed('        mass: 2.3 ', '        # '), 'arm.joint1.mass is missing: a planar chain'),
    (changed('stiffness: 1.5 ', 'stiffness: .inf '), "joint 'joint1' is rigid (stiffness .inf) "
     "but has motor 'joint1_motor'"),
])
def test_a_file_that_is_no_robot_is_refused_by_name(text, sentence, tmp_path):
    path = written(tmp_path, text)
    message = refused(files.load_robot, path)
    assert message.startswith(str(path)) and sentence in message


def test_friction_that_is_to_be_identified_need_not_be_stated(tmp_path, robot):
    """Of a joint of which nothing is stated; the arm is as ever, and a gap is still refused."""
    arm, _, friction = ROBOT.partition('    friction:\n')
    _, joint2, of_joint2 = friction.partition('      joint2:\n')
    path = written(tmp_path, f'{arm}    friction:\n{joint2}{of_joint2}')
    with pytest.raises(ConfigError, match=r'friction\.joint1\.forward\.static is missing'):
        files.load_robot(path)
    found = files.load_robot(path, to_identify=True)
    assert found.arm.mass.tolist() == robot.arm.mass.tolist()
    assert found.friction.forward.static[1] == robot.friction.forward.static[1]
    path.write_text(changed('attraction: 1.5', '#'), encoding='utf-8')
    with pytest.raises(ConfigError, match=r'friction\.joint1\.attraction is missing'):
        files.load_robot(path, to_identify=True)


@pytest.mark.parametrize('place', ['nowhere.yaml', '.'])
def test_a_file_that_cannot_be_read_is_named(place, tmp_path):
    with pytest.raises(ConfigError, match=r'cannot be read \((No such file|Is a directory)'):
        files.load_robot(tmp_path / place)


@pytest.mark.parametrize(('old', 'new', 'sentence'), [
    ('kd_link: 0.8 ', 'kd_link: -0.8 ', 'gains.joint1.kd_link must be from 0 to 1e+09'),
    ('kd_link: 0.8 ', 'kd_lnk: 0.8 ', "did you mean 'gains.joint1.kd_link'?"),
    ('compensation: gms ', 'compensation: gsm ',
     "disturbance_observer, got 'gsm'; did you mean 'gms'?"),
    ('compensation: gms ', 'compensation: magic ', "disturbance_observer, got 'magic'"),
    ('      joint2:', '      joint3:', "unknown joint 'joint3'; did you mean 'joint2'?"),
    ('torque_limit: 2.0 ', '# ', 'gains.joint1.torque_limit is missing: largest motor torque'),
    ('filter_bandwidth: 100.0 ', 'filter_bandwidth: 0.0 ', 'must be from 0.001 to 100000 rad/s'),
])
def test_what_is_wrong_in_a_controller_file_is_said(robot, old, new, sentence, tmp_path):
    path = written(tmp_path, changed(old, new, CONTROLLER), 'controller.yaml')
    message = refused(files.load_controller, path, robot)
    assert message.startswith(str(path)) and sentence in message and message.count('lugre') <= 1


def test_reordered_joints_keep_their_values(robot, tmp_path):
    """The order is that of ``joints``; values go by name."""
    text = changed('[joint1, joint2]', '[joint2, joint1]')
    path = written(tmp_path, changed('[joint1_motor, joint2_motor]',
                                     '[joint2_motor, joint1_motor]', text))
    swapped = files.load_robot(path)
    np.testing.assert_array_equal(swapped.arm.mass, robot.arm.mass[::-1])
    np.testing.assert_array_equal(swapped.friction.stiffness, robot.friction.stiffness[::-1])


def test_joints_may_have_different_numbers_of_blocks(tmp_path):
    """The shorter row is filled with blocks that carry nothing."""
    weights = ROBOT[ROBOT.index('weight: ['):ROBOT.index(']  # 1/N') + 1]
    text = changed(weights, 'weight: [0.25, 0.75]')
    path = written(tmp_path, changed('[2.26, 5.93, 6.95, 64.24, 11.45, 111.41]', '[5.0, 50.0]',
                                     text))
    friction = files.load_robot(path).friction
    assert friction.stiffness.shape == (2, 6)
    np.testing.assert_array_equal(friction.stiffness[0], [5.0, 50.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(friction.weight[0], [0.25, 0.75, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize('gain, used', [
    ('sign_slope', ('gms_paper', 'stribeck')),
    ('filter_bandwidth', tuple(set(COMPENSATIONS) - {'none', 'gms_paper'}))])
def test_a_gain_of_some_modes_changes_those_that_its_description_names(gain, used, robot, gains):
    """Two values, one motion: the torque differs in these modes and in no other."""
    plan = read_plan([robot_file(), controller_file(), share_path() / 'config' / 'sinusoid.yaml'],
                     duration=0.5)
    key, = (key for key in controller_keys(robot.joints) if key.name == f'gains.joint1.{gain}')
    differ = []
    for mode in COMPENSATIONS:
        one, other = (simulate(replace(plan, gains=replace(gains, compensation=mode, **{
            gain: factor * getattr(gains, gain)}))).command for factor in (1.0, 0.5))
        if not np.array_equal(one, other):
            differ.append(mode)
    assert set(differ) == set(used)
    named = [mode for mode in COMPENSATIONS if re.search(rf'\b{mode}\b', key.description)]
    assert set(named) in (set(used), set(COMPENSATIONS) - set(used))


@pytest.mark.parametrize(('text', 'sentence'), [
    ('effects: [backlash]', 'effects is not a known parameter: effects.<joint>.<effect>.<param'),
    ('uncertainty: 0.1', 'uncertainty is not a known parameter: uncertainty.<joint>.<kind>'),
    ('arm: 3', 'arm is not a known parameter: arm.kind and others stand under it'),
    ('gains: [1.0]', 'gains is not a known parameter: gains.joint1.')])
def test_a_value_in_the_place_of_a_group_is_told_from_a_wrong_name(text, sentence, tmp_path):
    """With its own place, though another file has the group."""
    path = written(tmp_path, f'/**:\n  ros__parameters:\n    {text}\n')
    message = refused(files.load_robot, [CONFIG / 'robot.yaml', path])
    assert message.startswith(f'{path}:3: {sentence}')
