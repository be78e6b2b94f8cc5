# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`gms_flex discrepancy`: the installed verb from bag to files, and what it refuses."""

from dataclasses import replace
import json
import re
import shutil
import subprocess

from bench.hidden_robots.cases import make_case
from bench.hidden_robots.hide import write_case
from gms_flex_control.cli.main import main
from gms_flex_control.data.writer import write_recording
from gms_flex_control.experiment.driven import executable
from gms_flex_control.schema.files import load_robot
from identified_axis import part as part_of
import pytest

DURATION = 12.0


def read_json(text):
    """Return strict JSON."""
    return json.loads(text, parse_constant=pytest.fail)


@pytest.fixture(scope='module')
def case():
    """Return a robot with backlash nobody knows of, driven for 12 s."""
    return make_case('single', 3, effect='backlash', plant='soft', duration=DURATION)


@pytest.fixture(scope='module')
def folder(case, tmp_path_factory):
    """Return the folder of its bag and robot file."""
    path = tmp_path_factory.mktemp('hidden') / 'case'
    write_case(case, path)
    return path


@pytest.fixture(scope='module')
def outcome(folder):
    """Return the finished process of the verb on it; its results are in ``folder``/out."""
    return subprocess.run(
        [*executable('gms_flex'), 'discrepancy', folder / 'bag', '--robot', folder / 'robot.yaml',
         '--out', folder / 'out', '--holdout', folder / 'held_out',
         '--models', folder / 'robot.yaml', '--controller', folder / 'controller.yaml'],
        capture_output=True, text=True, timeout=300)


@pytest.fixture(scope='module')
def report(folder, outcome):
    """Return its report.json."""
    assert outcome.returncode == 1, outcome.stderr
    return read_json((folder / 'out' / 'report.json').read_text(encoding='utf-8'))


def test_the_hidden_effect_is_named_with_its_size(case, report):
    truth, = case.truth.effects
    found = report['findings'][0]
    assert report['verdict'] == 'effects_found'
    assert (found['effect'], found['joint']) == ('backlash', truth.joint)
    gap = found['parameters']['half_gap']
    assert gap['unit'] == 'rad' and gap['low'] < gap['value'] < gap['high']
    assert gap['value'] == pytest.approx(truth.values[0], rel=0.02)
    assert found['rms_after'][truth.joint] < 0.5 * found['rms_before'][truth.joint]
    assert found['evidence'] and found['score'] > 0.0 and 'runner_up' in found


def test_the_gap_shrinks_on_the_other_motion(case, report):
    joint = case.truth.effects[0].joint
    gap = report['gap']
    assert report['holdout'] and set(gap['floor']) == set(case.nominal.joints)
    assert gap['after'][joint] < 0.5 * gap['retuned'][joint] < gap['before'][joint]
    assert gap['free_after'][joint] < 0.5 * gap['free_before'][joint]


def test_the_closed_loop_of_the_other_motion_comes_closer(case, report, folder):
    joint = case.truth.effects[0].joint
    loop = report['gap']['closed_loop']
    assert loop['sources'] == [str(folder / 'held_out')]
    assert loop['after'][joint] < loop['retuned'][joint]
    assert max(loop['floor'][joint], loop['after'][joint]) < loop['before'][joint]
    assert 'closed loop, simulated anew' in report['words']
    page = (folder / 'out' / 'report.html').read_text(encoding='utf-8')
    assert f'{joint}: closed loop, simulated - measured' in page


def test_the_model_written_has_the_effect_and_loads(case, folder, report):
    robot = load_robot(folder / 'out' / 'robot.yaml')
    spec, = robot.effects
    assert spec.key == ('backlash', case.truth.effects[0].joint)
    assert spec.values[0] == report['findings'][0]['parameters']['half_gap']['value']
    knob = next(one for one in report['retuned'] if one['parameter'] == 'motor_inertia')
    j = robot.joints.index(knob['joint'])
    assert robot.arm.motor_inertia[j] == pytest.approx(
        case.nominal.arm.motor_inertia[j] * (1.0 + knob['change']))


def test_the_terminal_ends_with_the_answer_and_shows_no_progress(case, outcome, report):
    *_, answer, numbers, last = outcome.stdout.rstrip().split('\n\n')
    assert max(map(len, answer.splitlines())) < 99
    joint, gap = case.truth.effects[0].joint, report['gap']
    assert outcome.stdout.count(f'lacks backlash of {joint}') == 1 and report['words'].startswith(
        f'The model lacks backlash of {joint}')
    assert f'lacks backlash of {joint}' in answer and 'torque noise alone would leave' in answer
    for row, figures in zip(numbers.splitlines()[2:4], (
            ('retuned', 'after', 'floor'), ('free_before', 'free_after', 'free_floor')),
            strict=True):
        assert f'of {joint} ' in row
        assert [float(cell) for cell in row.split()[-3:]] == pytest.approx(
            [1e3 * gap[name][joint] for name in figures], rel=0.006)  # three digits
    assert re.match(r'next: (\S*/)?gms_flex identify ', last)  # on the path or not
    assert outcome.stderr == ''


def test_models_are_compared_by_one_yardstick(outcome, report, folder):
    given, found, same = report['models']
    assert [one['model'] for one in (given, found)] == ['as given', 'with what was found']
    assert same == {**given, 'model': str(folder / 'robot.yaml')}
    assert found['missing'] < 0.5 < given['missing_retuned'] < given['missing']
    assert given['torque'] == pytest.approx(report['gap']['before'])
    assert f'{folder / "robot.yaml"}: missing' in outcome.stdout


def test_page_and_pictures_are_written(case, folder, report):
    joint = case.truth.effects[0].joint
    page = (folder / 'out' / 'report.html').read_text(encoding='utf-8')
    for part in (report['words'].split(';')[0], f'backlash of {joint}', 'The gap', 'torsion [rad]',
                 'What was tried', 'simulated - measured', 'motor_inertia', 'Models compared',
                 'Recording: '):
        assert part in page, part
    answer = page.partition('</main>')[0]
    assert f'lacks backlash of {joint}' in answer and answer.count('<figure') == 1
    assert 'src="http' not in page and 'href="http' not in page
    assert {one['variable'] for one in report['dependences']} == {
        'time [s]', 'link angle [rad]', 'motor angle [rad]', 'link rate [rad/s]',
        'motor rate [rad/s]', 'torsion [rad]', 'torque [N m]', 'link acceleration [rad/s^2]',
        'time since reversal [s]', 'direction', 'distance since reversal [rad]'}
    for name in ('gap.png', f'evidence_1_backlash_{joint}.png', 'map_joint1_1.png',
                 'map_joint2_2.png'):
        assert (folder / 'out' / name).read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'


def run(folder, *arguments, robot=None):
    """Run the verb here, results into ``folder``/out; return the exit code."""
    return main(['discrepancy', *map(str, arguments), '--out', str(folder / 'out'), '--robot',
                 str(robot or folder / 'robot.yaml')])


@pytest.fixture
def reversed_torque(case, tmp_path):
    """Return a bag of 6 s with the torque the wrong way round."""
    recording, _ = part_of((case.recording, ()), 0.0, 6.0)
    wrong = replace(recording, tau_motor=-recording.tau_motor, command=-recording.command)
    write_recording(tmp_path / 'bag', wrong, case.nominal.motors)
    return tmp_path / 'bag'


MADE_BY_SOME = ('robot.yaml', 'gap.png', 'evidence_1_backlash_joint1.png', 'map_joint1_1.png')


@pytest.mark.parametrize(('earlier', 'kept'), [
    ('{"verdict": "complete"}', False), ('{"joints": {}}', True), ('half a rep', True)])
def test_bad_data_are_named_and_end_the_run(folder, tmp_path, capsys, reversed_torque, earlier,
                                            kept):
    """And what an earlier run of this verb has left goes, but nothing else."""
    (tmp_path / 'out').mkdir()
    for name in (*MADE_BY_SOME, 'notes.png'):
        (tmp_path / 'out' / name).write_text('of an earlier run')
    (tmp_path / 'out' / 'report.json').write_text(earlier)
    as_json = ['--json'] * kept
    assert run(tmp_path, reversed_torque, *as_json, robot=folder / 'robot.yaml') == 2
    printed = capsys.readouterr()
    report = read_json((tmp_path / 'out' / 'report.json').read_text(encoding='utf-8'))
    if as_json:
        assert read_json(printed.out) == report and printed.err == ''
    else:
        assert printed.out == '' and 'wrong sign' in ' '.join(printed.err.split())
    assert report['verdict'] == 'bad_data' and report['gap'] is None
    assert any('wrong sign' in fault for fault in report['faults'])
    assert all((tmp_path / 'out' / name).exists() is kept for name in MADE_BY_SOME)
    assert (tmp_path / 'out' / 'notes.png').exists()
    page = (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')
    assert 'The data are at fault' in page and 'wrong sign' in page


@pytest.mark.parametrize('verb', ['discrepancy', 'identify'])
def test_what_is_fitted_is_not_given_again_by_another_path_nor_as_a_copy(
        folder, tmp_path, capsys, verb):
    shutil.copytree(folder / 'held_out', tmp_path / 'copy')
    for other in (folder / 'x' / '..' / 'held_out', tmp_path / 'copy'):
        assert main([verb, str(folder / 'bag'), str(folder / 'held_out'), '--holdout', str(other),
                     '--robot', str(folder / 'robot.yaml'), '--out', str(tmp_path / 'out')]) == 2
        error = capsys.readouterr().err
        assert 'is among the bags and in --holdout' in error and error.count('\n') == 1
        assert main([verb, str(folder / 'held_out'), str(other), '--robot',
                     str(folder / 'robot.yaml'), '--out', str(tmp_path / 'out')]) == 2
        error = capsys.readouterr().err
        assert 'is given twice' in error and error.count('\n') == 1
    assert not (tmp_path / 'out').exists()
