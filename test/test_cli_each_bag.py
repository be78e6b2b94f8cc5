# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Many bags, each identified by itself: then side by side."""

import json
from pathlib import Path
from types import SimpleNamespace

from gms_flex_control.cli import each_bag as each
from gms_flex_control.cli.main import main
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import ConfigError
from gms_flex_control.identification.output import over_bags
from identified_axis import pendulum
import numpy as np
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


def test_each_bag_is_identified_as_if_it_were_alone(bags, tmp_path, capsys):
    """One bag by the plain verb has the very same files, but for how long it took."""
    out = tmp_path / 'out'
    assert main(arguments(bags, out, '--json')) == 1
    printed = capsys.readouterr().out
    assert printed == (out / 'summary.json').read_text()
    told = {one['bag']: one for one in json.loads(printed)['bags']}
    assert list(told) == list(NAMES)
    assert 'empty' in told['empty']['reason'] and 'no bag' in told['empty']['reason']
    assert sorted(path.name for path in out.iterdir()) == sorted([*INERTIAS, 'summary.json'])
    assert main(['identify', bags[0], '--blocks', '1', '--out', str(tmp_path / 'one')]) == 0
    for name in ('report.json', 'friction.yaml'):
        one, of_many = ([line for line in (path / name).read_text().splitlines()
                         if 'seconds' not in line]
                        for path in (tmp_path / 'one', out / 'first'))
        assert one == of_many
    assert str(out / 'first' / 'friction.yaml') in (out / 'first' / 'report.html').read_text()


def test_all_bags_are_told_side_by_side(bags, tmp_path, capsys):
    """The inertia over bags is the mean of what the bags say, the bad bag has its reason."""
    out = tmp_path / 'out'
    assert main(arguments(bags, out, '--workers', '1')) == 1
    printed = capsys.readouterr().out
    assert '3 of 4 bags identified' in printed and 'NOT IDENTIFIED empty: ' in printed
    rows = {row['name']: row
            for row in json.loads((out / 'summary.json').read_text())['parameters']}
    inertia = rows['arm.swing.inertia']
    assert inertia['mean'] == pytest.approx(np.mean([*INERTIAS.values()]), rel=0.01)
    assert inertia['standard_deviation'] == pytest.approx(
        np.std([*INERTIAS.values()], ddof=1), rel=0.05)
    assert inertia['standard_deviation'] > 5.0 * inertia['foreseen']


def test_results_are_not_written_into_the_bags(bags, capsys):
    out = Path(bags[0]).parent
    assert main(arguments(bags, out)) == 2
    assert 'would be written into the bag' in capsys.readouterr().err
    assert not (out / 'summary.json').exists()


def test_bags_of_one_name_have_folders_of_their_own(tmp_path):
    """Folders above tell them apart; a bag that is named twice is told."""
    paths = [str(tmp_path / day / 'run') for day in ('monday', 'friday')] + [str(tmp_path / 'a')]
    assert each.names_of(paths) == dict(zip(('monday_run', 'friday_run', 'a'), paths, strict=True))
    with pytest.raises(ConfigError, match='two bags would both write'):
        each.names_of([paths[0], f'{tmp_path}/friday/../monday/run'])


def broken(_args):
    """Raise what no bag should raise."""
    raise ZeroDivisionError('of the program')


def test_an_error_of_the_program_costs_one_bag(capsys):
    reason = each.reason_or(broken, SimpleNamespace(bags=['bag']))['reason']
    assert 'please report it' in reason and 'of the program' in reason
    assert 'Traceback' in capsys.readouterr().err


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
