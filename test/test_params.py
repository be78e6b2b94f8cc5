# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Parameters that no robot has are refused; what is printed of linear axes has mm and N."""

from dataclasses import replace
import json
import re

from gms_flex_control.answer import align
from gms_flex_control.cli.main import main
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import ConfigError, GmsFlexError, ParameterError
from gms_flex_control.identification.output import report_json
from gms_flex_control.params.arm import ArmParams, in_currents, in_units
from gms_flex_control.params.robot import EncoderParams, FrictionParams, StribeckParams
from gms_flex_control.reports.answers import identification_text
from gms_flex_control.reports.figure_style import save_figure
from gms_flex_control.reports.recordings_page import write_identification_report
from gms_flex_control.schema.files import load_robot, save_robot
from gms_flex_control.view.recorded import scene_of
from identified import identification
from matplotlib.figure import Figure
import numpy as np
import pytest

pytestmark = pytest.mark.fast


def steady(**changes):
    """Return a steady curve of one joint."""
    return StribeckParams(**{'static': [0.1], 'coulomb': [0.09], 'velocity': [0.01],
                             'viscous': [0.0]} | changes)


def blocks(**changes):
    """Return friction of one joint with two blocks."""
    return FrictionParams(forward=steady(), backward=steady(), **{
        'stiffness': [[1.0, 2.0]], 'weight': [[0.5, 0.5]], 'attraction': [1.0]} | changes)


def arm(**changes):
    """Return a chain of two links, the second joint rigid."""
    one = np.ones(2)
    return ArmParams(**{'kind': 'planar', 'mass': one, 'length': one, 'com': 0.5 * one,
                        'inertia': one, 'motor_inertia': one, 'damping': 0.0 * one,
                        'stiffness': [5.0, np.inf]} | changes)


@pytest.mark.parametrize(('make', 'changes', 'sentence'), [
    (steady, {'static': [0.08]}, r'static \[0.08\] is below coulomb .*were they swapped\?'),
    (steady, {'coulomb': [0.0]}, r'coulomb must be above 0, got \[0.\]'),
    (steady, {'velocity': [-0.01]}, r'velocity must be above 0, got \[-0.01\]'),
    (steady, {'viscous': [-0.01]}, r'viscous must be at least 0, got \[-0.01\]'),
    (steady, {'static': [np.nan]}, r'static must be finite, got \[nan\]'),
    (steady, {'viscous': [0.1, 0.2]}, r'viscous must have shape \(1,\) .* got shape \(2,\)'),
    (steady, {'velocity': ['fast']}, r"velocity must be numbers, got \['fast'\]"),
    (blocks, {'weight': [[0.5, 0.6]]}, r'weights must sum to 1 per joint, got sums \[1.1\]'),
    (blocks, {'weight': [[0.5, 0.25, 0.25]]}, r'block weight must have shape \(1, 2\)'),
    (blocks, {'stiffness': [[1.0, -1.0]]}, r'block stiffness must be at least 0'),
    (blocks, {'stiffness': [1.0, 1.0]}, r'block stiffness must have shape \(1, n_blocks\)'),
    (blocks, {'attraction': [0.0]}, r'attraction must be above 0'),
    (blocks, {'attraction': [1.0, 1.0]}, r'attraction must have shape \(1,\)'),
    (arm, {'kind': 'spatial'}, r"arm.kind must be one of planar, decoupled, urdf, got 'spatial'"),
    (arm, {'inertia': [-0.1, 0.1]}, r'inertia must be at least 0, got'),
    (arm, {'mass': [np.nan, 1.0]}, r'mass must be finite, got \[nan'),
    (arm, {'mass': [1.0, 1.0, 1.0]}, r'mass must have shape \(2,\) \(one entry per joint\)'),
    (arm, {'stiffness': [0.0, 1.0]}, r'stiffness must be above 0 \(.inf for a rigid joint\)'),
    (arm, {'motor_inertia': [0.0, 0.0]},
     r'motor_inertia must be above 0 where the joint is flexible'),
    (arm, {'inertia': [0.0, 0.0], 'com': [0.0, 0.1]}, r'each link needs inertia or mass away'),
    (arm, {'gravity': [1.0, 2.0, 3.0]}, r'gravity must have shape \(2,\)'),
    (arm, {'gravity': np.inf}, r'gravity must be finite'),
    (EncoderParams, {'counts': -1}, 'encoder counts must be at least 0, got -1.0'),
    (EncoderParams, {'noise': np.nan}, 'encoder noise must be finite, got nan'),
    (EncoderParams, {'velocity_cutoff': [50.0, 50.0]},
     r'encoder velocity_cutoff must have shape \(\)'),
    (EncoderParams, {'counts': 'many'}, "counts must be numbers, got 'many'"),
    ('gains', {'compensation': 'gsm'}, "must be one of none, gms_paper, gms, .*got 'gsm'"),
    ('gains', {'kd_link': [-0.8, 0.8]}, r'kd_link must be at least 0, got \[-0.8  0.8\]'),
    ('gains', {'lambda_motor': [30.0]}, r'lambda_motor must have shape \(2,\)'),
    ('gains', {'observer_gain': [np.nan, 1.0]}, r'observer_gain must be finite'),
    ('gains', {'filter_bandwidth': [0.0, 100.0]}, r'filter_bandwidth must be above 0'),
    ('robot', {'joints': ('joint1', 'joint1')}, 'joints and motors need names of their own'),
    ('robot', {'joints': ('joint1', 'arm')}, "a joint cannot be called 'arm'.*another"),
    ('robot', {'joints': ('joint1',)}, 'arm describes 2 joints, but joints names 1'),
    ('robot', {'motors': ('motor1', '')}, "'joint2' is flexible but motors has no name for it"),
    ('robot', {'arm': arm()}, "joint 'joint2' is rigid .* but has motor")])
def test_what_cannot_be_is_refused(request, make, changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        if isinstance(make, str):
            replace(request.getfixturevalue(make), **changes)
        else:
            make(**changes)


ROTARY = re.compile(r'\b(m?rad|N m|kg m)\b')


def linear(robot):
    """Return a robot with linear axes."""
    return replace(robot, arm=replace(robot.arm, kind='decoupled', axes='linear'))


@pytest.mark.parametrize(('rotary', 'written'), [
    ('0.5 mrad', '0.5 mm'), ('rad/s', 'm/s'), ('[rad^2]', '[m^2]'), ('3 mN m of', '3 mN of'),
    ('N m', 'N'), ('N m/rad', 'N/m'), ('N m s/rad', 'N s/m'), ('N m s^2/rad^2', 'N s^2/m^2'),
    ('N m/rad^3', 'N/m^3'), ('N m/s', 'N/s'), ('kN m', 'kN'), ('kg m^2', 'kg'),
    ('gradient of m, N', 'gradient of m, N'), ('crossover [rad/s]', 'crossover [1/s]'),
    ('phase 0.4 (0.3 .. 0.5) rad; reach 2 rad', 'phase 0.4 (0.3 .. 0.5) radians; reach 2 m'),
    ('phase [deg]  speed [rad/s]', 'phase [deg]  speed [m/s]')])
def test_units_of_linear_axes(robot, rotary, written):
    assert in_units(linear(robot).arm, rotary) == written
    assert in_units(robot.arm, rotary) == rotary


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'gravity': 9.81}, 'the weight on a linear axis as the effect '
     f'"{find("constant_link_torque").words.partition(",")[0]}"'),
    ({'inertia': [0.0, 0.0], 'com': [0.0, 0.0]}, r'needs inertia, the mass that moves \[kg\]')])
def test_what_moves_a_linear_axis_is_asked_for(robot, changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        replace(linear(robot).arm, **changes)


def test_the_file_keeps_them_and_a_chain_has_none(robot, tmp_path):
    path = tmp_path / 'robot.yaml'
    save_robot(linear(robot), path)
    assert load_robot(path).arm.axes == 'linear'
    path.write_text(path.read_text().replace('decoupled', 'planar'))
    with pytest.raises(GmsFlexError, match='arm.axes linear needs arm.kind decoupled, got planar'):
        load_robot(path)


def test_text_page_and_numbers_of_an_identification_have_mm_and_n(tmp_path):
    made = identification()
    assert ROTARY.search(identification_text(made))
    made = replace(made, robot=linear(made.robot))
    page = write_identification_report(made, tmp_path)[0].read_text('utf-8')
    text = re.sub(r'<script>.*?</script>|src="[^"]*"', '', page, flags=re.DOTALL)
    assert ROTARY.findall(text) == [] and ' mm' in text and '[N]' in text
    numbers = json.dumps(report_json(made)['joints'])
    assert ROTARY.findall(numbers) == [] and '"N s/m"' in numbers


def test_pictures_have_mm_and_n(robot, tmp_path):
    figure = Figure()
    panel = figure.subplots()
    panel.set_ylabel('angle [mrad]')
    save_figure(figure, tmp_path / 'one.png', lambda text: in_units(linear(robot).arm, text))
    assert panel.get_ylabel() == 'angle [mm]'


def test_the_page_of_view_has_mm_and_n(robot):
    assert scene_of(linear(robot)).units == {'rad': 'm', 'mrad': 'mm', 'N m': 'N'}
    assert scene_of(robot).units['mrad'] == 'mrad'


def test_the_tool_states_them(robot, tmp_path, capsys):
    path, bag = str(tmp_path / 'robot.yaml'), str(tmp_path / 'bag')
    save_robot(linear(robot), path)
    effects = tmp_path / 'effects.yaml'
    effects.write_text('/**:\n  ros__parameters:\n    effects:\n      joint1:\n'
                       '        torque_ripple: {amplitude: 0.1, order: 600.0, phase: 0.5}\n')
    assert main(['simulate', '--robot', path, '--duration', '0.1', '--out', bag]) == 0
    assert 'MSE per link [m^2]' in capsys.readouterr().out
    assert main(['export', '--to', 'csv', '--robot', path, str(effects)]) == 0
    csv = capsys.readouterr().out
    assert ROTARY.findall(csv) == [] and 'phase,joint1,0.5,radians' in csv
    out = tmp_path / 'results'
    assert main(['analyse', bag, '--label', 'sinusoid_gms', '--out', str(out)]) == 0
    page = re.sub(r'<script>.*?</script>', '', (out / 'report.html').read_text('utf-8'),
                  flags=re.DOTALL)
    for text in (capsys.readouterr().out, page, (out / 'table4.json').read_text()):
        assert ROTARY.findall(text) == []


def test_what_is_missing_of_a_linear_axis_is_its_mass(tmp_path):
    path = tmp_path / 'robot.yaml'
    path.write_text('/**:\n  ros__parameters:\n    joints: [slide]\n    arm:\n'
                    '      {kind: decoupled, axes: linear, slide: {stiffness: .inf}}\n')
    with pytest.raises(ConfigError, match=r'inertia is missing: .* all that moves \[kg\]'):
        load_robot(path)


def test_a_table_keeps_its_columns_in_other_units():
    """Units are longer or shorter, and numbers stand in one column all the same."""
    rows = [['coulomb', unit, value, 'note'] for unit, value in (
        ('N m', '(1.7)'), ('N m s/rad', '0.25'), ('kg m^2', '12'), ('rad/s', '3'))]
    table = align(['', 'unit', 'value', ''], rows)
    ends = {line.index('note') for text in (table, in_currents(table))
            for line in text.splitlines()[2:]}
    assert len(ends) == 1
    assert in_currents('3 N m, or 5 mN m of friction') == '3 A, or 5 mA of friction'
    assert in_currents('torque [N], N = 4 blocks') == 'torque [A], N = 4 blocks'
