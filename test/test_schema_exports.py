# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A robot for other programs: MuJoCo moves it as the equations say, what is lost is refused."""

import csv
from dataclasses import replace
import xml.etree.ElementTree as ElementTree

from bench.chain_matrices import matrices
from bench.hidden_robots.sizes import spec
from bench.speed import mujoco_export
from core_runs import single_axis
from gms_flex_control.cli.main import main
from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError
from gms_flex_control.friction import steady_friction
from gms_flex_control.params.robot import WHOLE_ARM
from gms_flex_control.schema import mujoco
from gms_flex_control.schema import target as friction_targets
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.files import save_robot
from gms_flex_control.schema.target import export
import numpy as np
import pytest
from ruamel.yaml import YAML

LUGRE = mujoco_export.LUGRE
DRY = ('presliding', 'stribeck', 'direction')


def with_effects(robot, **effects):
    """Return a robot with effects, values by parameter, on its last joint."""
    return replace(robot, effects=tuple(
        spec(name, robot.n_joints - 1, robot.joints, values) for name, values in effects.items()))


def loaded(robot, without=LUGRE):
    """Return MuJoCo, model and data of an exported robot."""
    library = pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    model = library.MjModel.from_xml_string(export(robot, mujoco.target(), without))
    return library, model, library.MjData(model)


def axis_of(robot, **effects):
    """Return a flywheel on the second joint, its Stribeck curve alike in both directions."""
    one = robot.friction.of_joints([1])
    excess, forward = one.forward.static - one.forward.coulomb, one.forward
    backward = replace(one.backward, static=one.backward.coulomb + excess,
                       velocity=forward.velocity)
    return with_effects(single_axis(replace(one, backward=backward), 1e9), **effects)


def torque_along(robot, rate, way, without=LUGRE):
    """Return the torque on a flywheel after it has turned over a way at a rate [N m]."""
    library, model, data = loaded(robot, without)
    data.qvel = rate
    library.mj_step(model, data, round(abs(way / rate) / model.opt.timestep))
    library.mj_forward(model, data)
    assert (data.qpos[0], data.qvel[0]) == pytest.approx((way, rate), rel=1e-3)
    return (data.qfrc_passive + data.qfrc_actuator)[0]


@pytest.mark.parametrize('rate', [0.02, -0.02, 0.3, -0.3])
def test_steady_friction_in_mujoco_is_the_stribeck_curve(robot, rate):
    """Coulomb and viscous friction differ by direction; Eq. (6)."""
    axis = axis_of(robot)
    found = torque_along(axis, rate, 0.4 * np.sign(rate))
    assert found == pytest.approx(-steady_friction(np.array([rate]), axis.friction)[0], rel=1e-3)


def test_the_blocks_yield_one_by_one(robot):
    """A slow displacement loads each block up to its level, and a return unloads it: Eq. (2)."""
    axis = axis_of(robot)
    levels = 0.5 * axis.friction.weight[0] * (
        axis.friction.forward.coulomb + axis.friction.backward.coulomb)
    for way in (5e-5, 5e-4, 5e-3):
        blocks = np.minimum(axis.friction.stiffness[0] * way, levels).sum()
        bias = 0.5 * (axis.friction.forward.coulomb - axis.friction.backward.coulomb)[0]
        viscous = 1e-4 * axis.friction.forward.viscous[0]
        found = torque_along(axis, 1e-4, way, ('stribeck',))
        assert found == pytest.approx(-(blocks + bias + viscous), rel=2e-3)


@pytest.mark.parametrize(('name', 'values', 'place', 'reported'), [
    ('end_stop', {'angle': 0.1, 'stiffness': 3.0}, 0.25, -0.45),
    ('end_stop', {'angle': -0.1, 'stiffness': 3.0}, -0.25, 0.45),
    ('constant_link_torque', {'bias': -0.3}, 0.25, -0.3),
    ('motor_torque_bias', {'bias': 0.2}, -0.25, 0.2),
    ('torque_ripple', {'amplitude': 0.2, 'order': 4.5, 'phase': 0.3}, 0.25,
     0.2 * np.sin(4.5 * 0.25 + 0.3)),
    ('viscous_error', {'slope': 0.2}, 0.25, -0.2 * 0.5),
    ('viscous_asymmetry', {'slope': 0.002}, -0.25, -0.002 * 0.5),
    ('quadratic_drag', {'drag': 0.2}, -0.25, 0.2 * 0.25),
    ('motor_viscous', {'viscous': 0.2}, 0.25, -0.2 * 0.5)])
def test_the_torque_of_an_effect_comes_on_top(robot, name, values, place, reported):
    rate = 0.5 * np.sign(place)
    without, with_it = (torque_along(axis, rate, place) for axis in (
        axis_of(robot), axis_of(robot, **{name: values})))
    assert with_it - without == pytest.approx(reported, abs=2e-4)


def test_a_step_comes_late_lagged_scaled_and_limited(robot):
    """Limit (1 + gain) (1 - exp(-(t - delay) / time_constant)), saturation before gain."""
    axis = axis_of(robot, actuator_saturation={'limit': 0.5}, torque_gain={'gain_error': 0.2},
                   input_delay={'delay': 0.006}, actuator_lag={'time_constant': 0.01})
    library, model, data = loaded(axis)
    found, time = [], model.opt.timestep * (np.arange(300) + 0.5)
    for _ in time:
        data.ctrl = 2.0
        library.mj_step(model, data)
        found.append(data.actuator_force[0] * model.actuator_gear[0, 0])
    reported = 0.6 * -np.expm1(-np.maximum(time - 0.006, 0.0) / 0.01)
    np.testing.assert_allclose(found, reported, atol=0.016)  # held over a step from its beginning
    assert np.mean(np.subtract(found, reported)) == pytest.approx(0.0, abs=3e-5)


SLIDES = {'kind': 'decoupled', 'axes': 'linear', 'mass': [0.0, 0.0], 'com': [0.0, 0.0]}


@pytest.mark.parametrize('changes', [
    {}, {'offset': [0.4, -0.9], 'gravity': 9.81}, {'stiffness': [np.inf, 1.5]},
    {'kind': 'decoupled', 'gravity': 3.0}, SLIDES, SLIDES | {'stiffness': [np.inf, np.inf]}])
def test_inertia_and_gravity_in_mujoco_are_those_of_the_arm(robot, changes):
    arm = replace(robot.arm, **changes)
    motors = tuple('' if rigid else name for rigid, name in zip(
        arm.rigid, robot.motors, strict=True))
    one, q = replace(robot, arm=arm, motors=motors), np.array([0.3, 1.1])
    library, model, data = loaded(one)
    kinds = library.mjtJoint
    assert np.all(model.jnt_type == (
        kinds.mjJNT_SLIDE if arm.axes == 'linear' else kinds.mjJNT_HINGE))
    data.qpos[[model.joint(name).qposadr[0] for name in one.joints]] = q
    library.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    library.mj_fullM(model, data, mass)
    reported = matrices(q, *np.zeros((3, 2)), arm)
    links, flexible = reported.mass, ~arm.rigid  # with the motors of rigid joints in it
    rows = [model.joint(name).dofadr[0] for name in one.joints]
    np.testing.assert_allclose(mass[np.ix_(rows, rows)], links, rtol=1e-6)
    np.testing.assert_allclose(data.qfrc_bias[rows], reported.gravity, atol=1e-6)
    for joint in np.flatnonzero(flexible):
        dof = model.joint(one.motors[joint]).dofadr[0]
        assert mass[dof, dof] == pytest.approx(arm.motor_inertia[joint], rel=1e-5)


@pytest.mark.parametrize('name', ['backlash', 'input_delay', 'stribeck_error', 'torque_ripple'])
def test_free_runs_in_mujoco_are_as_good_as_ours(name):
    """Half a second at Coulomb levels; without it worse; `bench speed` has all effects."""
    pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    coulomb = mujoco_export.COULOMB
    found = mujoco_export.ratio(name, 3.0, coulomb, coulomb)
    assert 0.8 < found < mujoco_export.TARGET
    if name != 'stribeck_error':  # nothing of which is at Coulomb levels
        assert mujoco_export.ratio(name, 3.0, (*coulomb, name), coulomb) > mujoco_export.TARGET


def test_a_stribeck_curve_as_lugre_is_nearer_to_the_whole_model():
    pytest.importorskip('mujoco', reason="MuJoCo is the extra 'bench'")
    lugre, coulomb = (mujoco_export.ratio('stribeck_error', 4.0, without, motion='slow')
                      for without in (LUGRE, mujoco_export.COULOMB))
    assert lugre < 0.8 * coulomb


@pytest.mark.parametrize('name', registry.names())
def test_every_effect_is_exported_to_mujoco_or_refused_by_name(robot, name):
    nothing = {one.name: max(one.lower, 0.0) for one in registry.find(name).parameters}
    one = with_effects(robot, **{name: nothing})
    if name in mujoco_export.exportable():
        ElementTree.fromstring(export(one, mujoco.target(), LUGRE))
        return
    place = WHOLE_ARM if registry.find(name).whole_arm else robot.joints[-1]
    with pytest.raises(ConfigError, match=f'MuJoCo cannot express {name} of {place}; '
                                          f'add --without .*{name}$'):
        export(one, mujoco.target(), LUGRE)
    assert export(one, mujoco.target(), (*LUGRE, name)) == export(robot, mujoco.target(), LUGRE)


def test_what_mujoco_has_alone_is_refused_together(robot):
    both = with_effects(robot, backlash={'half_gap': 0.01}, spring_offset={'offset': 0.1})
    with pytest.raises(ConfigError, match=r'spring_offset of joint2 \(behind backlash\)'):
        export(both, mujoco.target(), LUGRE)
    for order in ((0, 1), (1, 0)):  # a spring acts behind any play
        effects = with_effects(robot, backlash={'half_gap': 0.01}, spring_hysteresis={
            'force': 0.01, 'yield': 0.02}).effects
        with pytest.raises(ConfigError, match='spring_hysteresis of joint2'):
            export(replace(robot, effects=tuple(effects[k] for k in order)), mujoco.target(),
                   LUGRE)
    first = replace(both, effects=both.effects[::-1])
    springs = ElementTree.fromstring(export(first, mujoco.target(), LUGRE)).iter('fixed')
    rests = {spring.get('name'): spring.get('springlength') for spring in springs}
    assert [float(value) for value in rests['joint2_spring'].split()] == [-0.11, -0.09]


def test_a_step_that_is_too_long_is_refused_with_one_that_is_not(robot):
    with pytest.raises(ConfigError, match=r'--timestep 0.1: .* joint1 need 0.06 s or less'):
        export(robot, mujoco.target(0.1), (*LUGRE, 'presliding', 'stribeck'))


@pytest.mark.parametrize(('words', 'sentence'), [
    ('--to mujoco', 'MuJoCo cannot express attraction of joint1 and joint2, stribeck_direction of '
     'joint1 and joint2; add --without attraction stribeck_direction to export friction that '
     'follows its Stribeck curve at once, the mean of what both directions add to Coulomb '
     'friction instead'),
    ('--to mujoco --without attraction stribeck', None),
    ('--to mujoco --without backlsh',
     "--without backlsh: no such part or effect; did you mean 'backlash'?"),
    ('--to urdf --without stribeck', 'URDF cannot express spring of joint1 and joint2, '
     'motor_inertia of joint1 and joint2, presliding of joint1 and joint2, direction of joint1 '
     'and joint2; add --without stribeck spring motor_inertia presliding direction to export '
     'rigid joints, the inertia of links alone, dry friction without the stiffness of its blocks, '
     'the mean friction of both directions of motion instead'),
    ('--to csv --without backlash', '--without: csv holds every parameter; leave the option out'),
    ('--to urdf --timestep 0.001', '--timestep 0.001 --to urdf: give an integration step above 0 '
     's and below 1 s, to mujoco only')])
def test_the_tool_says_what_is_lost_and_how_to_go_on(words, sentence, capsys):
    assert main(['export', *words.split()]) == (2 if sentence else 0)
    printed, reported = capsys.readouterr()
    assert reported == (f'gms_flex export: {sentence}\n' if sentence else '')
    assert bool(printed) == (sentence is None)


def test_urdf_has_dynamics_of_both_directions_and_viscous_errors(robot):
    one = with_effects(robot, viscous_error={'slope': 0.01}, coulomb_error={'ratio': 0.5})
    text = export(one, friction_targets.URDF, ('spring', 'motor_inertia', *DRY))
    found = {joint.get('name'): joint.find('dynamics').attrib
             for joint in ElementTree.fromstring(text).iter('joint')}
    assert list(found) == list(robot.joints)
    assert float(found['joint2']['damping']) == pytest.approx((0.00374 + 0.0053) / 2 + 0.01)
    assert float(found['joint2']['friction']) == pytest.approx(1.5 * (0.09087 + 0.08363) / 2)


def test_ros2_control_has_one_list_over_joints_each(robot):
    text = export(robot, friction_targets.ROS2_CONTROL, DRY)
    found = YAML(typ='safe').load(text)['/**']['ros__parameters']
    assert found['joints'] == list(robot.joints)
    assert found['friction'] == {'viscous': pytest.approx([0.069995, 0.00452]),
                                 'coulomb': pytest.approx([0.09195, 0.08725])}


def test_csv_holds_every_number_of_the_files_with_its_unit(robot, tmp_path):
    one = with_effects(robot, backlash={'half_gap': 0.002}, gravity_tilt={
        'tilt': 0.01, 'direction': 1.0})
    save_robot(one, tmp_path / 'robot.yaml')
    out = tmp_path / 'parameters.csv'
    assert main(['export', '--to', 'csv', '--robot', str(tmp_path / 'robot.yaml'), '--out',
                 str(out)]) == 0
    rows = {row['parameter']: row for row in csv.DictReader(out.open())}
    for name, value in robot_values(one).items():
        if name not in ('joints', 'motors', 'arm.kind'):
            listed = value if isinstance(value, list) else [value]
            keys = [f'{name}[{k}]' for k in range(len(value))] if listed is value else [name]
            assert [float(rows[key]['value']) for key in keys] == listed
            assert all(rows[key]['unit'] for key in keys)
    assert rows['effects.joint2.backlash.half_gap']['joint'] == 'joint2'
    assert rows['effects.arm.gravity_tilt.tilt']['unit'] == 'rad'
