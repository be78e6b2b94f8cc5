# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verb that tries all faults, and its soak: long runs of real nodes, judged by their trend."""

from bench.__main__ import main
from bench.faults.faults import is_permitted
import numpy as np
import pytest

pytest.importorskip('rclpy')
bench = pytest.importorskip('bench.faults.node_bench')
soak = pytest.importorskip('bench.faults.soak')


def test_the_verb_prints_the_table(capfd, tmp_path):
    assert main(['faults', '--short', '--only', 'mismatch', '--logs', str(tmp_path / 'logs')]) == 0
    lines = [line for line in capfd.readouterr().out.splitlines() if not line.startswith('[')]
    assert lines[0].split() == ['fault', 'tries', 'worst', 'figure', 'limit', 'verdict']
    assert lines[1].startswith('endpoints whose quality') and lines[1].endswith('held')
    assert lines[-1] == ('The nodes had realtime_priority 50.' if is_permitted(50) else
                         'The nodes had no realtime_priority: other programs make them late.')
    assert 'QoS mismatch' in (tmp_path / 'logs/mismatch/controller_node.log').read_text()


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


def test_a_soak_separates_growth_and_a_trend_from_noise():
    steady = [window(3, 100e6 + 1e4 * (k % 3)) for k in range(30)]
    assert soak.judged(steady) == []
    assert 'no growth of memory' in soak.table(steady)
    grows = soak.judged([window(3, 100e6 + 1e5 * k) for k in range(30)])
    assert len(grows) == 1 and grows[0].startswith('plant_node: memory grew from 100.3 to 102.0')
    later = soak.judged([window(k // 3, 100e6) for k in range(30)])
    assert len(later) == 1 and later[0].startswith('deadlines: ')
    ended = [*steady[:20], *[window(3, np.nan)] * 10]
    assert soak.judged(ended)
