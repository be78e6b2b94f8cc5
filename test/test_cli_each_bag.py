# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many bags, each identified by itself: the same wherever it is done and whoever is killed."""

import csv
import json
import os
from pathlib import Path
import signal
import subprocess
from types import SimpleNamespace

from gms_flex_control.cli import each_bag as each
from gms_flex_control.cli.each_bag import reason_or
from gms_flex_control.cli.identify_bags import identify_bag, items_of
from gms_flex_control.cli.main import build_parser, main
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import BatchError, ConfigError
from gms_flex_control.identification.output import is_outlier, over_bags
from identified_axis import pendulum
from loopback_cluster import until
import numpy as np
from processes import environment_of, TOOL
import pytest

NAMES = ('first', 'empty', 'second', 'third')
INERTIAS = {'first': 0.02, 'second': 0.022, 'third': 0.02}


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Return paths of four bags of a pendulum, the second without a file."""
    folder = tmp_path_factory.mktemp('bags')
    for seed, (name, inertia) in enumerate(INERTIAS.items()):
        write_recording(folder / name, pendulum(inertia, seconds=12.0, seed=seed), ('',))
    (folder / 'empty').mkdir()
    return [str(folder / name) for name in NAMES]


def arguments(bags, out, *further):
    """Return the words of the verb."""
    return ['identify', *bags, '--each', '--blocks', '1', '--out', str(out), *further]


@pytest.fixture(scope='module')
def alone(bags, tmp_path_factory):
    """Return a folder of results made by a plain loop in this process, and what was returned."""
    out = tmp_path_factory.mktemp('alone')
    items, _ = items_of(build_parser().parse_args(arguments(bags, out)))
    return out, {item.place.name: reason_or(identify_bag, item) for item in items.values()}


def results(out):
    """Return what must be the same in two folders of results: all but how long it took."""
    found = {}
    for name in INERTIAS:
        report = json.loads((out / name / 'report.json').read_text())
        report.pop('seconds')
        found[name] = report, (out / name / 'friction.yaml').read_text()
    return found


def assert_same(out, alone):
    """Raise unless a batch has what the plain loop has, nothing beside it, and says so."""
    folder, values = alone
    assert results(out) == results(folder)
    assert sorted(path.name for path in out.iterdir()) == sorted([
        *INERTIAS, 'outcomes.jsonl', 'spread.csv', 'summary.csv', 'summary.json'])
    for name in INERTIAS:
        assert {path.name for path in (out / name).iterdir()} == {
            path.name for path in (folder / name).iterdir()}
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['bags'] == [{'bag': name, **values[name]} for name in NAMES]


def run_in_process(bags, out, *further):
    """Start the verb as a process of its own."""
    return subprocess.Popen([*TOOL, *arguments(bags, out, *further)], env=environment_of(),
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def children(pid):
    """Return the processes that work for one."""
    found = (Path('/proc') / str(pid) / 'task' / str(pid) / 'children').read_text().split()
    return [int(child) for child in found
            if b'spawn_main' in Path(f'/proc/{child}/cmdline').read_bytes()]


def parts_in(out):
    """Return folders that are being written."""
    return list(Path(out).glob('.*.part'))


def identified_in(out):
    """Return the names of bags that the journal of a run has."""
    lines = (out / 'outcomes.jsonl').read_text().splitlines()
    return [line.split('"')[3].split()[0] for line in lines if '"reason": null' in line]


def test_each_bag_is_identified_as_if_it_were_alone(bags, alone, tmp_path):
    """One bag by the plain verb has the very same files, but for how long it took."""
    folder, values = alone
    assert main(['identify', bags[0], '--blocks', '1', '--out', str(tmp_path / 'one')]) == 0
    for name in ('report.json', 'friction.yaml'):
        one, of_many = ([line for line in (path / name).read_text().splitlines()
                         if 'seconds' not in line]
                        for path in (tmp_path / 'one', folder / 'first'))
        assert one == of_many
    page = (folder / 'first' / 'report.html').read_text()
    assert str(folder / 'first' / 'friction.yaml') in page and '.part' not in page
    assert 'empty' in values['empty']['reason'] and 'no bag' in values['empty']['reason']
    assert not (folder / 'empty').exists()


def test_processes_and_a_killed_run_say_what_a_plain_loop_says(bags, alone, tmp_path):
    """Kill a worker while results are written, then the whole run; begun again, it goes on."""
    out = tmp_path / 'out'
    run = run_in_process(bags, out)
    until(lambda: parts_in(out))
    os.kill(children(run.pid)[0], signal.SIGKILL)
    until(lambda: identified_in(out))
    workers = children(run.pid)
    run.kill()
    run.communicate()
    until(lambda: not any(Path(f'/proc/{pid}').exists() for pid in workers))  # they end as well
    times = {out / name / 'report.json': (out / name / 'report.json').stat().st_mtime_ns
             for name in identified_in(out)}
    again = run_in_process(bags, out, '--json')
    printed, told = again.communicate()
    assert (again.returncode, told) == (1, b'')
    assert printed.decode() == (out / 'summary.json').read_text()
    assert times == {path: path.stat().st_mtime_ns for path in times}
    assert_same(out, alone)


def test_all_bags_are_told_side_by_side(bags, alone, tmp_path, capsys):
    """The inertia over bags is the mean of what the bags say, the bad bag has its reason."""
    _, values = alone
    rows = {row.name: row for row in over_bags(
        {name: values[name] for name in INERTIAS})}
    inertia = rows['arm.swing.inertia']
    assert inertia.mean == pytest.approx(np.mean([*INERTIAS.values()]), rel=0.01)
    assert inertia.standard_deviation == pytest.approx(
        np.std([*INERTIAS.values()], ddof=1), rel=0.05)
    assert inertia.standard_deviation > 5.0 * inertia.foreseen
    out = tmp_path / 'out'
    assert main(arguments(bags[1:3], out, '--workers', '1')) == 1
    printed = capsys.readouterr().out
    assert '1 of 2 bags identified' in printed and 'NOT IDENTIFIED empty: ' in printed
    lines = list(csv.DictReader((out / 'summary.csv').open()))
    assert [line['bag'] for line in lines] == ['empty', 'second']
    assert 'no bag' in lines[0]['reason'] and lines[0]['arm.swing.inertia'] == ''
    assert float(lines[1]['arm.swing.inertia']) == pytest.approx(0.022, rel=0.01)


def test_results_of_other_options_are_replaced_and_made_again(bags, tmp_path, capsys):
    """The journal knows both, the folder holds those of the last; what else lies there stays."""
    out = tmp_path / 'out'
    for force in ([], ['--force']):
        assert main(arguments(bags[:1], out, '--workers', '1', *force)) == 0
        (out / 'first' / 'notes.txt').write_text('mine')
    made = (out / 'first' / each.MARK).read_text().splitlines()[0]
    assert made.endswith(json.loads((out / 'outcomes.jsonl').read_text().splitlines()[-1])[
        'sources'])
    assert len((out / 'outcomes.jsonl').read_text().splitlines()) == 2
    assert (out / 'first' / 'notes.txt').read_text() == 'mine'


def test_a_folder_of_somebody_else_is_not_written_into(bags, tmp_path, capsys):
    """Such as the bags themselves."""
    out = Path(bags[0]).parent
    assert main(arguments(bags, out)) == 2
    assert 'holds no results of --each: name another --out' in capsys.readouterr().err
    assert not (out / 'outcomes.jsonl').exists()


def test_bags_of_one_name_have_folders_of_their_own(tmp_path):
    """Folders above tell them apart; a bag that is named twice is told."""
    paths = [str(tmp_path / day / 'run') for day in ('monday', 'friday')] + [str(tmp_path / 'a')]
    assert list(each.names_of(paths)) == ['monday_run', 'friday_run', 'a']
    assert list(each.names_of(paths).values()) == paths
    with pytest.raises(ConfigError, match='given twice'):
        each.names_of([paths[0], f'{tmp_path}/friday/../monday/run'])
    (tmp_path / 'a.mcap').touch()
    with pytest.raises(ConfigError, match='would both write'):
        each.names_of([str(tmp_path / 'a.mcap'), str(tmp_path / 'a')])


def test_half_written_results_are_never_seen(tmp_path):
    """A folder appears at once, or not at all; one that is replaced says so meanwhile."""
    place = each.Place('bag', str(tmp_path), 'bag', 'whole')
    with pytest.raises(ZeroDivisionError), each.whole(place) as folder:
        (folder / 'report.json').write_text('half')
        raise ZeroDivisionError
    assert not any(tmp_path.iterdir())
    for text in ('first', 'second'):
        with each.whole(place) as folder:
            (folder / 'report.json').write_text(text)
            (folder / f'{text}.png').touch()
            assert place.is_done == (text == 'second')
        assert place.is_done and (place.folder / 'report.json').read_text() == text
    assert [path.name for path in tmp_path.iterdir()] == ['bag']
    assert {path.name for path in place.folder.iterdir()} == {
        each.MARK, 'report.json', 'second.png'}


def broken(_item):
    """Raise what no bag should raise."""
    raise ZeroDivisionError('of the program')


def test_an_error_of_the_program_costs_one_bag_and_a_folder_out_of_sight_all(tmp_path, capsys):
    """The folder is looked for before any work is done."""
    item = SimpleNamespace(place=each.Place('bag', str(tmp_path), 'bag', 'mark'))
    reason = each.reason_or(broken, item)['reason']
    assert 'please report it' in reason and 'of the program' in reason
    assert 'Traceback' in capsys.readouterr().err
    item.place = item.place._replace(out=str(tmp_path / 'elsewhere'))
    with pytest.raises(BatchError, match='does not see this folder'):
        each.reason_or(broken, item)


def test_outliers_are_those_that_neither_scatter_nor_their_own_error_explains():
    """Of six bags one is far off; with an interval as wide as that it is no outlier."""
    values, errors = np.array([1.0, 1.01, 0.99, 1.02, 0.98, 1.3]), np.full(6, 0.01)
    assert is_outlier(values, errors).tolist() == [False] * 5 + [True]
    assert not is_outlier(values, np.append(errors[:5], 0.2)).any()
    assert not is_outlier(values[[0, 1, 5]], errors[:3]).any()


def estimate(name, value, standing='well known'):
    """Return an estimate of `bag_values`."""
    return {'name': name, 'unit': '', 'value': value, 'low': value - 0.1, 'high': value + 0.1,
            'flags': [], 'standing': standing}


def test_only_what_is_comparable_and_told_is_counted():
    """Blocks of another number are other blocks, and what data do not tell is no measurement."""
    block = 'friction.a.stiffness[{}]'.format
    bags = {'one': {'estimates': [estimate(block(0), 2.0), estimate('friction.a.viscous', 1.0)]},
            'two': {'estimates': [estimate(block(0), 4.0), estimate(
                'friction.a.viscous', 9.0, 'not identifiable')]},
            'three': {'estimates': [estimate(block(0), 9.0), estimate(block(1), 9.0)]}}
    rows = {row.name: (row.bags, row.mean, row.standard_deviation) for row in over_bags(bags)}
    assert rows == {block(0): (2, 3.0, pytest.approx(np.sqrt(2.0))),
                    'friction.a.viscous': (1, 1.0, pytest.approx(np.nan, nan_ok=True))}
