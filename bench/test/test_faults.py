# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Rows of the fault table on real node processes; and the table shows a bad node."""

from importlib import import_module
from operator import attrgetter
import os
import sys

from bench.__main__ import main
from bench.faults.faults import is_permitted
import pytest

pytest.importorskip('rclpy')
bench = pytest.importorskip('bench.faults.node_bench')
exceptions = pytest.importorskip('bench.faults.exceptions')
table = pytest.importorskip('bench.faults.table')
soak = pytest.importorskip('bench.faults.soak')

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
    code = ('from gms_flex_control.nodes import controller_node, start; '
            'controller_node.ControllerNode._watch = lambda self: None; '
            'start.run("controller_node")')
    monkeypatch.setattr(bench, 'executable', lambda node: (
        [sys.executable, '-c', code] if node == 'controller_node' else sound(node)))
    row = table.try_fault(table.FAULTS['silence'], 1, tmp_path)
    assert row.verdict == table.FAILED
    assert any('no zero was commanded' in problem for problem in row.problems), row.problems


def test_a_priority_that_is_not_permitted_is_not_taken(monkeypatch, capsys):
    def refuse(*_):
        raise PermissionError(1, 'Operation not permitted')
    monkeypatch.setattr(os, 'sched_setscheduler', refuse)
    assert main(['faults', '--priority', '20']) == 2
    assert 'limits.conf' in capsys.readouterr().err


def test_asking_for_a_priority_leaves_this_process_as_it_is():
    is_permitted(50)
    assert {os.sched_getscheduler(int(thread)) for thread in os.listdir('/proc/self/task')} == {
        os.SCHED_OTHER}
