# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What an identification leaves for machines: report.json and friction.yaml."""

from dataclasses import replace
import json

from gms_flex_control.file_io import controller_file, robot_file, write_json
from gms_flex_control.identification import outcome, output
from gms_flex_control.identification.outcome import estimated
from gms_flex_control.identification.output import friction_values, uncertainty_of, write_friction
from gms_flex_control.params.robot import UNCERTAIN
from gms_flex_control.schema.files import load_controller, load_robot, read_parameters
from identified import ERRORS, identification
import numpy as np
import pytest

FIELDS = ('static', 'coulomb', 'velocity', 'viscous')


def edited(made, j=0, **changes):
    """Return the identification with fields of one JointResult replaced."""
    joints = list(made.joints)
    joints[j] = replace(joints[j], **changes)
    return replace(made, joints=tuple(joints))


def estimate(low, high, flags=(), value=1.0):
    """Return an Estimate with an interval."""
    return outcome.Estimate('friction.joint1.attraction', 'N m/s', value,
                            outcome.Interval(low, high), flags, '')


def same_friction(a, b):
    """Assert that two FrictionParams say the same, blocks that carry nothing aside."""
    for way in ('forward', 'backward'):
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(getattr(a, way), name),
                                          getattr(getattr(b, way), name))
    np.testing.assert_array_equal(a.attraction, b.attraction)
    for j in range(len(a.attraction)):
        used = [each.weight[j] > 0.0 for each in (a, b)]
        for name in ('stiffness', 'weight'):
            np.testing.assert_array_equal(getattr(a, name)[j, used[0]],
                                          getattr(b, name)[j, used[1]])


@pytest.mark.parametrize('joints', [1, 2])
def test_friction_yaml_loads_after_the_robot_file_and_equals(tmp_path, joints):
    from gms_flex_control.schema.files import save_robot
    made = identification(joints)
    made = replace(made, robot=replace(made.robot, identified_from=('bag, 60.000 s',)))
    write_friction(made, tmp_path / 'friction.yaml')
    save_robot(made.believed, tmp_path / 'robot.yaml')
    robot = load_robot([tmp_path / 'robot.yaml', tmp_path / 'friction.yaml'])
    same_friction(robot.friction, made.robot.friction)
    np.testing.assert_array_equal(robot.arm.inertia, made.believed.arm.inertia)
    np.testing.assert_array_equal(robot.arm.stiffness, made.believed.arm.stiffness)
    assert robot.motors == made.believed.motors
    assert robot.identified_from == ('bag, 60.000 s',)
    load_controller([controller_file(), tmp_path / 'friction.yaml'], load_robot(robot_file()))


def test_friction_yaml_holds_friction_alone_and_no_empty_blocks(tmp_path):
    write_friction(identification(), tmp_path / 'friction.yaml')
    names = {name.split('.')[0] for name in read_parameters(tmp_path / 'friction.yaml')}
    assert names == {'joints', 'motors', 'friction', 'uncertainty'}
    weights = friction_values(identification())['friction.joint1.weight']
    assert len(weights) == 6 and 0.0 not in weights


def test_friction_that_the_data_leave_open_is_known_worse_than_usual():
    """Ten per cent of viscous friction, four times what is usual; the other joint as before."""
    made = identification()
    assert uncertainty_of(made)['viscous', 'joint1'] < 0.1
    opened = edited(made, estimates=tuple(
        one._replace(flags=(outcome.NOT_IDENTIFIABLE,)) if one.name.endswith('viscous') else one
        for one in made.joints[0].estimates))
    values = uncertainty_of(opened)
    assert values['viscous', 'joint1'] == pytest.approx(4.0 * UNCERTAIN['viscous'].sd)
    assert values | {('viscous', 'joint1'): 0.0} == uncertainty_of(made) | {
        ('viscous', 'joint1'): 0.0}


def test_an_arm_is_known_as_its_intervals_say_and_what_is_open_worse_than_usual():
    """
    Of links that carry each other no worse: all at once they would be anything.

    A motor inertia that identification leaves as described is as sure as its description.
    """
    made = identification()
    made = edited(made, estimates=(
        *made.joints[0].estimates,
        estimated('arm.joint1.stiffness', 'N m/rad', 10.0, 0.3),
        estimated('arm.joint1.damping', 'N m s/rad', 0.1, 0.0001),
        estimated('arm.joint1.motor_inertia', 'kg m^2', 0.1, 0.09, known=False),
        estimated('arm.joint1.gravity_torque', 'N m', 2.0, 0.2)))
    assert ('motor_inertia', 'joint1') not in uncertainty_of(made)  # as described
    arm = made.believed.arm
    made = replace(made, believed=replace(made.believed, arm=replace(
        arm, motor_inertia=1.5 * arm.motor_inertia)))
    values = uncertainty_of(made)
    found = {kind: values.get((kind, 'joint1')) for kind in UNCERTAIN}
    assert found['stiffness'] == pytest.approx(0.03) and found['gravity'] == pytest.approx(0.1)
    assert found['damping'] == pytest.approx(0.5 * UNCERTAIN['damping'].sd)
    assert found['motor_inertia'] == pytest.approx(4.0 * UNCERTAIN['motor_inertia'].sd)
    assert found['inertia'] is None
    spread = np.array([[0.01, 0.3], [0.2, np.inf], [np.inf, np.inf]])
    values = uncertainty_of(replace(made, spread=spread))
    for joint, kind, sd in (('joint1', 'gravity', 0.01), ('joint2', 'gravity', 0.06),
                            ('joint1', 'inertia', 0.06), ('joint2', 'inertia', 0.06)):
        assert values[kind, joint] == pytest.approx(sd)


def test_a_link_of_no_inertia_beside_its_motor_is_open():
    made = identification()
    n, arm = made.robot.n_joints, made.robot.arm
    rigid = replace(made.robot, motors=('',) * n, arm=replace(arm, stiffness=np.full(n, np.inf)))
    made = edited(replace(made, robot=rigid), estimates=(
        *made.joints[0].estimates,
        estimated('arm.joint1.inertia', 'kg m^2', 0.5 * arm.motor_inertia[0], 1e-4)))
    assert uncertainty_of(made)['inertia', 'joint1'] == pytest.approx(
        4.0 * UNCERTAIN['inertia'].sd)


def test_bags_of_one_name_get_files_of_their_own(tmp_path):
    made = replace(identification(), sources=('monday/bag', 'tuesday/bag', 'tuesday/other'),
                   constants={'joint1': (2.0, 0.01)})
    files = output.condition_files(made, tmp_path)
    assert [one.name for one in files.values()] == [
        'bag_1.recording.yaml', 'bag_2.recording.yaml', 'other.recording.yaml']


def test_an_arm_parameter_is_written_where_the_fit_changed_it():
    made = identification()
    arm = replace(made.robot.arm, inertia=made.robot.arm.inertia * [1.0, 1.1])
    values = friction_values(replace(made, robot=replace(made.robot, arm=arm)))
    written = {name: value for name, value in values.items() if name.startswith('arm.')}
    assert written == {'arm.joint2.inertia': pytest.approx(0.00825)}


def test_a_joint_taken_as_rigid_keeps_its_motor_and_spring(tmp_path):
    made = identification()
    arm = replace(made.robot.arm, stiffness=[np.inf, 1.5])
    made = replace(made, robot=replace(made.robot, arm=arm, motors=('', 'joint2_motor')))
    write_friction(made, tmp_path / 'friction.yaml')
    robot = load_robot([robot_file(), tmp_path / 'friction.yaml'])
    assert robot.motors == ('joint1_motor', 'joint2_motor')
    np.testing.assert_array_equal(robot.arm.stiffness, [1.5, 1.5])


def test_report_json_is_strictly_valid_and_complete(tmp_path):
    made = edited(identification(), held_out=ERRORS._replace(
        repeatability=np.nan, free_run_rms=np.inf, torque_rms=np.float32(0.5)))
    write_json(tmp_path / 'report.json', output.report_json(made))
    found = json.loads((tmp_path / 'report.json').read_text('utf-8'), parse_constant=pytest.fail)
    assert found == output.report_json(made)
    assert (found['duration'], found['sources'], found['warnings']) == (
        412.5, ['bags/a', 'bags/b'], ['3 samples were lost.'])
    first, second = found['joints']
    assert first['held_out']['repeatability'] is first['held_out']['free_run_rms'] is None
    assert first['held_out']['torque_rms'] == 0.5 and first['side'] == 'spring'
    assert [each['n_blocks'] for each in first['candidates'] if each['chosen']] == [4]
    assert len(second['estimates']) == len(made.joints[1].estimates)
    lost = next(each for each in second['estimates'] if each['flags'])
    assert lost['standing'] == 'not identifiable' and 'larger amplitude' in lost['note']
    assert lost['interval'] == pytest.approx([0.96 * lost['value'], 1.04 * lost['value']])
    assert (tmp_path / 'report.json').stat().st_size < 40_000


@pytest.mark.parametrize(('made', 'expected'), [
    (estimate(0.95, 1.05), 'well known'),
    (estimate(0.5, 1.5), 'roughly known'),
    (estimate(np.nan, np.nan), 'roughly known'),
    (estimate(1.0, 1.0), 'set, not fitted'),
    (estimate(0.95, 1.05, ('at bound',)), 'doubtful'),
    (estimate(0.95, 1.05, ('at bound', 'not identifiable')), 'not identifiable'),
    (estimate(0.95, 1.05, value=np.nan), 'not identifiable')])
def test_how_far_a_number_can_be_trusted(made, expected):
    assert outcome.standing(made) == expected
