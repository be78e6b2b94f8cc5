# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Compensations side by side: conditions, figures and batches."""

from dataclasses import replace
import json
import re
import shlex

from core_runs import model_with_error, padded
from gms_flex_control.cli.main import main
from gms_flex_control.file_io import robot_file
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.reports import comparison_page
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.files import save_robot, save_values
from gms_flex_control.simulation import loop
from gms_flex_control.trajectory import builders
from gms_flex_control.tuning import study
from gms_flex_control.tuning.study import conditions, CONTESTANTS, plant_of, PlantCondition
import numpy as np
import pytest


@pytest.fixture
def only():
    """Return a function that leaves some compensations alone to be compared."""
    whole = dict(CONTESTANTS)

    def keep(*modes):
        for mode in set(whole) - set(modes):
            del CONTESTANTS[mode]
    yield keep
    CONTESTANTS.clear()
    CONTESTANTS.update(whole)


def setting_of(arm, draws=0):
    return study.Setting(*arm, np.ones(2), 500.0, draws, 0)


def test_conditions_change_what_they_name(arm):
    believed = robot_values(arm[0])
    by_name = {one.name: robot_values(plant_of(arm[0], one, 0)) for one in conditions(2)}
    for name, key, factor in (('friction +30 %', 'friction.joint1.forward.static', 1.3),
                              ('friction -30 %', 'friction.joint2.backward.viscous', 0.7),
                              ('K -20 %', 'arm.joint2.stiffness', 0.8),
                              ('M +30 %', 'arm.joint1.mass', 1.3),
                              ('M +30 %', 'arm.joint1.inertia', 1.3),
                              ('nominal', 'arm.joint1.mass', 1.0),
                              ('1000 Hz', 'arm.joint1.mass', 1.0)):
        assert by_name[name][key] == pytest.approx(factor * believed[key])
    assert by_name['4096 counts']['encoder.counts'] == 4096.0
    drawn = [by_name[f'drawn {k}']['arm.joint1.stiffness'] for k in (0, 1)]
    assert drawn[0] != drawn[1]


def trial(mse, hold=0.0, torque=1.0):
    return {'lost': False, 'mse': mse, 'hold': [hold, 0.0], 'torque': [torque] * 2,
            'rate': [2.0, 2.0]}


def test_the_table_is_what_the_cells_say(arm):
    """Counted by hand: root of the mean, the worse of a group, lost where one is lost."""
    setting = setting_of(arm, draws=2)
    outcomes = {key: {motion: trial([1e-6, 3e-6], 4e-3) for motion in ('sinusoid', 'polynomial')}
                for key in study.cells(setting)}
    outcomes['gms | K +20 %']['sinusoid'] = trial([9e-6, 3e-6])
    outcomes['gms | drawn 1']['polynomial'] = trial([1e-6, 11e-6], 7e-3)
    outcomes['none | M -30 %']['sinusoid'] = {'lost': True}
    rows = {row.mode: row for row in study.table(outcomes, setting)}
    better = rows['gms']
    assert better.errors['nominal'] == pytest.approx(2e-6 ** 0.5)
    assert better.errors['K'] == pytest.approx(4e-6 ** 0.5)
    assert better.drawn == [pytest.approx(2e-6 ** 0.5), pytest.approx(4e-6 ** 0.5)]
    assert better.hold == [4e-3, 0.0] and better.drawn_hold == 7e-3
    assert better.torque == pytest.approx(1.0) and better.rate == pytest.approx(2.0)
    assert rows['none'].errors['M'] is None and rows['none'].errors['K'] is not None
    line = next(one for one in comparison_page.plant_text(list(rows.values())).splitlines()
                if one.startswith('GMS, better'))
    assert line.split()[2:6] == ['1.41', '1.41', '2', '1.41']


def test_a_cell_is_the_simulation_it_names(arm):
    found = study.try_cell(study.cells(setting_of(arm))['gms | friction +30 %'])
    plant = model_with_error(arm[0], friction=1.3)
    plant = replace(plant, friction=replace(plant.friction, attraction=arm[0].friction.attraction))
    run = loop.run(plant, *arm, builders.sinusoid(np.ones(2), 6.0), duration=20.0)
    mse = np.mean((run.true[:, 0] - run.reference[:, 0]) ** 2, axis=0)
    np.testing.assert_allclose(found['sinusoid']['mse'], mse, rtol=1e-9)


def test_a_robot_that_runs_away_is_lost_and_not_a_number(arm):
    setting = setting_of(arm)._replace(gains=replace(arm[1], kd_motor=np.full(2, 60.0)))
    outcome = study.try_cell(
        study.Cell(setting, 'gms', PlantCondition('slow', 'slow', rate=100.0)))
    assert study.error_of(outcome) is None or study.error_of(outcome) > 0.1
    json.dumps(outcome, allow_nan=False)


def test_compare_prints_the_table_and_writes_a_page_that_stands_alone(
        tmp_path, capsys, only):
    only('none', 'gms')
    assert main(['compare', '--draws', '1', '--workers', '1', '--out', str(tmp_path)]) == 0
    out = capsys.readouterr().out
    reported = json.loads((tmp_path / 'comparison.json').read_text())
    errors = {row['mode']: row['errors'] for row in reported['rows']}
    for group in ('nominal', 'friction', 'K', 'M', '200 Hz', '65536 counts'):
        assert errors['gms'][group] < 0.4 * errors['none'][group]
    page = (tmp_path / 'report.html').read_text()
    assert 'One thing different at a time' in page
    assert not re.search(r'(src|href)="(?!#|data:)', page)
    assert 'GMS, better' in out
    *_, numbers, last = out.rstrip().split('\n\n')
    none, gms, floor = map(float, numbers.splitlines()[2].split()[-3:])
    assert [none, gms] == pytest.approx([1e3 * errors[mode]['nominal'] for mode in (
        'none', 'gms')], rel=0.006)
    # without friction there is less error than with what nobody compensates
    assert 0.0 < floor < 0.1 * none and last.startswith('next: gms_flex simulate')


def test_the_robot_as_identified_is_the_plant(arm, tmp_path, only, capsys):
    """As `gms_flex identify` writes it: a file beside that of the robot, the later one winning."""
    only('none')
    twice = tmp_path / 'friction.yaml'
    values = {name: 2.0 * value for name, value in robot_values(arm[0]).items()
              if name.startswith('friction.') and name.endswith(('.static', '.coulomb'))}
    save_values(values, twice)
    assert main(['compare', str(robot_file()), str(twice), '--draws', '0', '--workers', '1',
                 '--json', '--out', str(tmp_path)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / 'comparison.json').read_text())
    once = study.error_of(study.try_cell(study.cells(setting_of(arm))['none | nominal']))
    assert printed['rows'][0]['errors']['nominal'] > 1.5 * once
    assert str(twice) in (tmp_path / 'report.html').read_text()


def test_what_compare_and_tune_say_comes_next_runs_with_a_robot_of_its_own(
        tmp_path, monkeypatch, capsys, only):
    """The sinusoid of config/ is for the joints of the paper: both write the one they tried."""
    only('none', 'gms')
    monkeypatch.chdir(tmp_path)
    robot = rigid_joints(['slide'])
    save_robot(replace(robot, friction=padded(robot.friction)), 'robot.yaml')
    for verb in ('tune --robot robot.yaml --torque-limit 20 --amplitude 0.2 --out tuned',
                 'compare robot.yaml --controller tuned/controller.yaml --amplitude 0.2 --draws 0 '
                 '--workers 1 --out compared'):
        assert main(verb.split()) == 0
        printed = capsys.readouterr().out
        assert 'condition' not in printed.split('alpha')[0]  # none on rigid joints
        assert main(shlex.split(printed.partition('next: ')[2])[1:]) == 0
        capsys.readouterr()
