# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Rows of the fault table on real node processes; and the table shows a bad node."""

from importlib import import_module
import json
from operator import attrgetter
import os
import sys

from bench.__main__ import main
import numpy as np
import pytest

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)

pytest.importorskip('rclpy')
bench = pytest.importorskip('bench.faults.node_bench')
exceptions = pytest.importorskip('bench.faults.exceptions')
table = pytest.importorskip('bench.faults.table')
soak = pytest.importorskip('bench.faults.soak')
scheduling = pytest.importorskip('gms_flex_control.nodes.process')

# rows that no other test tries on processes, with the fewest tries; the verb has all of them
ROWS = {'dead-controller': 1, 'silence': 1, 'clocks': 1, 'numbers': 2, 'two-trajectories': 1,
        'lost-reference': 1, 'bags': 2}
SLACK = 2.0  # times their limits that a shared machine may take


@pytest.mark.parametrize('name', ROWS)
def test_a_fault_never_moves_the_arm(name, tmp_path):
    fault = table.FAULTS[name]
    row = table.try_fault(fault, ROWS[name], tmp_path)
    assert not [problem for problem in row.problems if not problem.startswith(fault.figure)]
    assert row.tries >= ROWS[name] and row.worst <= SLACK * fault.limit


@pytest.mark.parametrize('place', [place[2] for place in exceptions.PLACES])
def test_where_the_bench_raises_there_is_a_function(place):
    module, _, path = place.partition(':')
    assert callable(attrgetter(path)(import_module(module)))


def test_a_node_that_lacks_a_guard_fails_its_row(tmp_path, monkeypatch):
    """It never notices that the states have stopped."""
    sound = bench.executable
    code = ('from gms_flex_control.nodes.controller_node import ControllerNode, main; '
            'ControllerNode._watch = lambda self: None; main()')
    monkeypatch.setattr(bench, 'executable', lambda node: (
        [sys.executable, '-c', code] if node == 'controller_node' else sound(node)))
    row = table.try_fault(table.FAULTS['silence'], 1, tmp_path)
    assert row.verdict == table.FAILED
    assert any('no zero was commanded' in problem for problem in row.problems), row.problems


def test_the_verb_prints_the_table(capfd, tmp_path):
    assert main(['faults', '--short', '--only', 'mismatch', '--logs', str(tmp_path / 'logs')]) == 0
    lines = [line for line in capfd.readouterr().out.splitlines() if not line.startswith('[')]
    assert lines[0].split() == ['fault', 'tries', 'worst', 'figure', 'limit', 'verdict']
    assert lines[1].startswith('endpoints whose quality') and lines[1].endswith('held')
    assert lines[-1] == ('The nodes had realtime_priority 50.' if scheduling.is_permitted(50) else
                         'The nodes had no realtime_priority: other programs make them late.')
    assert 'QoS mismatch' in (tmp_path / 'logs/mismatch/controller_node.log').read_text()


def test_json_has_every_row_and_a_failed_row_says_why():
    fault = table.FAULTS['silence']
    tally = table.Tally(tries=3, problems=['the arm fell'])
    tally.figure(60.0)
    row = table.judged(fault, tally, 1.5)
    read, = json.loads(table.as_json([row]))
    assert read['verdict'] == 'FAILED' and read['worst'] == 60.0 and read['tries'] == 3
    assert read['problems'] == ['the arm fell', 'zero commanded after 60 ms, the limit is 50 ms']
    assert 'silence: the arm fell' in table.table([row])
    assert not table.all_held([row])


def window(missed, memory):
    """Return a Window of a run."""
    return soak.Window(30_000, missed, 2.2e-3, 5e-3, (memory, 90e6, 80e6))


def test_a_soak_counts_each_command_and_sees_each_process(tmp_path):
    with bench.Bench(tmp_path) as place:
        windows = soak.soak(place, 2.0, window=1.0)
    assert len(windows) in (2, 3)
    assert all(0 < one.commands <= 1.2 * soak.RATE for one in windows)
    assert all(20e6 < part < 2e9 for one in windows for part in one.memory)
    assert 0.9 / soak.RATE < windows[-1].p99 <= windows[-1].longest


def test_a_soak_tells_growth_and_a_trend_from_noise():
    steady = [window(3, 100e6 + 1e4 * (k % 3)) for k in range(30)]
    assert soak.judged(steady) == []
    assert 'no growth of memory' in soak.table(steady)
    grows = soak.judged([window(3, 100e6 + 1e5 * k) for k in range(30)])
    assert len(grows) == 1 and grows[0].startswith('plant_node: memory grew from 100.3 to 102.0')
    later = soak.judged([window(k // 3, 100e6) for k in range(30)])
    assert len(later) == 1 and later[0].startswith('deadlines: ')
    ended = [*steady[:20], *[window(3, np.nan)] * 10]
    assert soak.judged(ended)


def test_a_priority_that_is_not_permitted_is_not_taken(monkeypatch, capsys):
    def refuse(*_):
        raise PermissionError(1, 'Operation not permitted')
    monkeypatch.setattr(scheduling.os, 'sched_setscheduler', refuse)
    assert main(['faults', '--priority', '20']) == 2
    assert 'limits.conf' in capsys.readouterr().err


def test_asking_for_a_priority_leaves_this_process_as_it_is():
    scheduling.is_permitted(50)
    assert {os.sched_getscheduler(int(thread)) for thread in os.listdir('/proc/self/task')} == {
        os.SCHED_OTHER}
