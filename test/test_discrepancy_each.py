# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a model lacks, asked of many bags each by itself; test_cli_each_bag has more."""

from contextlib import redirect_stdout
from dataclasses import replace
import json

from bench.hidden_robots.cases import make_case
from bench.hidden_robots.hide import write_case
from gms_flex_control.cli.main import main
from gms_flex_control.data.writer import write_recording
from gms_flex_control.effects import registry
import pytest

NAMES = ('bag', 'reversed')
LOOKED_FOR = {'backlash', 'coulomb_error', 'spring_cubic', 'stiffness_error', 'torque_ripple'}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder of a bag of a robot with backlash, and of one with reversed torque."""
    path = tmp_path_factory.mktemp('hidden') / 'case'
    case = make_case('single', 3, effect='backlash', plant='soft', duration=12.0)
    write_case(case, path)
    write_recording(path / 'reversed', replace(
        case.recording, tau_motor=-case.recording.tau_motor, command=-case.recording.command),
        case.nominal.motors)
    return path


def arguments(folder, out, *further):
    """Return the words of the verb."""
    return ['discrepancy', *(str(folder / name) for name in NAMES), '--each', '--robot',
            str(folder / 'robot.yaml'), '--max-effects', '1', '--without',
            *sorted(set(registry.names()) - LOOKED_FOR), '--out', str(out), *further]


@pytest.fixture(scope='module')
def out(folder, tmp_path_factory):
    """Return the folder of results that two processes made; in it what was printed."""
    out = tmp_path_factory.mktemp('results')
    with (out / 'printed').open('w') as file, redirect_stdout(file):
        assert main(arguments(folder, out, '--workers', '2')) == 1
    return out


def test_the_good_bag_names_what_is_hidden_and_the_bad_one_its_fault(folder, out):
    printed = (out / 'printed').read_text()
    assert '1 of 2 bags answered, effects_found 1' in printed
    assert 'BAD DATA reversed: ' in printed and 'backlash' in printed
    bags = json.loads((out / 'summary.json').read_text())['bags']
    assert [one['bag'] for one in bags] == list(NAMES)
    good, bad = bags
    hidden = json.loads((folder / 'truth.json').read_text())['effects'][0]
    assert good['reason'] is None
    assert f'{hidden["effect"]} of {hidden["joint"]}' in good['effects']
    assert 'wrong sign' in bad['reason']
    page = (out / 'bag' / 'report.html').read_text()
    assert str(out / 'bag' / 'robot.yaml') in page


def test_the_model_that_was_asked_with_is_not_replaced(folder, out, capsys):
    """Results of one bag may be the model of the next run, but not of one over them."""
    own = out / 'bag' / 'robot.yaml'
    before = own.read_bytes()
    args = arguments(folder, out)
    args[args.index('--robot') + 1] = str(own)
    assert main(args) == 1
    assert 'would be overwritten' in ' '.join(capsys.readouterr().out.split())
    assert own.read_bytes() == before
