# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Linear axes are declared in the robot file, and what is printed has mm and N."""

from dataclasses import replace
import json
import re

from gms_flex_control.cli.main import main
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.identification.output import report_json
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports.answers import identification_text
from gms_flex_control.reports.figures import save_figure
from gms_flex_control.reports.identification_page import write_identification_report
from gms_flex_control.schema.files import load_robot, save_robot
from gms_flex_control.view.scene import scene_of
from identified import identification
from matplotlib.figure import Figure
import pytest

pytestmark = pytest.mark.fast

ROTARY = re.compile(r'\b(m?rad|N m|kg m)\b')


def linear(robot):
    """Return a robot with linear axes."""
    return replace(robot, arm=replace(robot.arm, kind='decoupled', axes='linear'))


@pytest.mark.parametrize(('rotary', 'written'), [
    ('0.5 mrad', '0.5 mm'), ('rad/s', 'm/s'), ('[rad^2]', '[m^2]'), ('3 mN m of', '3 mN of'),
    ('N m', 'N'), ('N m/rad', 'N/m'), ('N m s/rad', 'N s/m'), ('N m s^2/rad^2', 'N s^2/m^2'),
    ('N m/rad^3', 'N/m^3'), ('N m/s', 'N/s'), ('kN m', 'kN'), ('kg m^2', 'kg'),
    ('gradient of m, N', 'gradient of m, N')])
def test_units_of_linear_axes(robot, rotary, written):
    assert in_units(linear(robot).arm, rotary) == written
    assert in_units(robot.arm, rotary) == rotary


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
    path = str(tmp_path / 'robot.yaml')
    save_robot(linear(robot), path)
    assert main(['simulate', '--robot', path, '--duration', '0.1', '--out',
                 str(tmp_path / 'bag')]) == 0
    assert 'MSE per link [m^2]' in capsys.readouterr().out
    assert main(['export', '--to', 'csv', '--robot', path]) == 0
    assert ROTARY.findall(capsys.readouterr().out) == []
