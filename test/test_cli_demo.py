# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The demo, shortened: three node processes, a recorder, bags, Table 4 and the report."""

import json

from bench import __main__ as bench
from gms_flex_control.cli.main import main
from gms_flex_control.data.bag import summarise
from gms_flex_control.data.reader import read_recording
import numpy as np
from processes import run_with_nodes
import pytest

MODES = ('none', 'gms')


@pytest.fixture(scope='module')
def outcome(tmp_path_factory):
    """Run two compensations for 3 s each; return the folder and what was printed."""
    out = tmp_path_factory.mktemp('demo') / 'output'
    return out, run_with_nodes('demo', '--out', out, '--motions', 'sinusoid', '--modes', *MODES,
                               '--duration', 3)


def test_both_tables_are_printed_and_progress_on_a_terminal_only(outcome):
    folder, process = outcome
    assert process.stderr == ''
    assert [path.name for path in sorted((folder / 'log').glob('*/*.log'))] == 2 * [
        'controller.log', 'plant.log', 'recorder.log', 'trajectory.log']
    assert 'three nodes over DDS' not in process.stdout
    for text in ('Table 4', 'Exact model', 'report.html', 'table4.json'):
        assert text in process.stdout


@pytest.mark.parametrize('mode', MODES)
def test_each_bag_has_every_sample_of_every_topic(outcome, mode):
    bag = outcome[0] / 'bags' / f'sinusoid_{mode}'
    counts = {topic.name: topic.count for topic in summarise(bag).topics}
    assert counts['/joint_states'] == 1500
    assert counts['/cascade_controller/state'] == 1500
    assert counts['/effort_controller/commands'] == 1501  # the controller ends with a zero
    assert counts['/reference'] in (1500, 1501)  # it is a sample ahead
    recording = read_recording(bag)
    for field in ('q_link', 'q_motor', 'tau_motor', 'command', 'reference', 'friction_hat'):
        assert np.all(np.isfinite(getattr(recording, field))), field
    exact = read_recording(outcome[0] / 'bags' / 'exact_model' / f'sinusoid_{mode}')
    np.testing.assert_array_equal(exact.time, recording.time)
    np.testing.assert_array_equal(exact.reference, recording.reference)


def test_the_table_and_the_report_are_made(outcome):
    out, _ = outcome
    table = json.loads((out / 'table4.json').read_text())
    assert table
    mse = {mode: np.mean((recording.q_link - recording.reference[:, 0]) ** 2, axis=0)
           for mode in MODES for recording in [read_recording(out / 'bags' / f'sinusoid_{mode}')]}
    assert np.all(mse['none'] > 3.0 * mse['gms'])
    for value in (*mse['none'], *mse['gms']):
        assert any(number == pytest.approx(value) for number in numbers_in(table))
    report = (out / 'report.html').read_text()
    assert 'friction x 0.85' in report and len(report) > 50_000
    assert list(out.glob('*.png'))


def numbers_in(tree):
    """Yield every number in nested lists and dicts."""
    for value in tree.values() if isinstance(tree, dict) else tree:
        if isinstance(value, (dict, list)):
            yield from numbers_in(value)
        elif isinstance(value, float):
            yield value


@pytest.mark.parametrize(('tool', 'prog', 'verb'), [
    (main, 'gms_flex', 'demo'), (bench.main, bench.PROG, 'demo-identify'),
    (bench.main, bench.PROG, 'demo-discrepancy'), (bench.main, bench.PROG, 'demo-next')])
def test_a_folder_it_did_not_make_is_left_alone(tool, prog, verb, tmp_path, capsys):
    (tmp_path / 'thesis.tex').write_text('years of work')
    assert tool([verb, '--out', str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f'{prog} {verb}: {tmp_path} exists and was not made by {verb}: name another --out\n')
    assert tool([verb, '--out', str(tmp_path / 'thesis.tex')]) == 2
    assert (tmp_path / 'thesis.tex').read_text() == 'years of work'


def test_a_bad_duration_leaves_an_earlier_demo(tmp_path, capsys):
    (tmp_path / '.gms_flex_demo').touch()
    (tmp_path / 'report.html').write_text('of yesterday')
    assert main(['demo', '--out', str(tmp_path), '--duration', '-1']) == 2
    assert '--duration' in capsys.readouterr().err
    assert (tmp_path / 'report.html').is_file()
