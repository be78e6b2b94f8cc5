# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A long run of the loop in real time: memory of each node, and commands that came late."""

from pathlib import Path
import time
from typing import NamedTuple

from bench.faults.node_bench import COMMANDS, config, default_files
from gms_flex_control.nodes.messages import NANOSECONDS
import numpy as np
from std_msgs.msg import Float64MultiArray

NODES = ('plant_node', 'controller_node', 'trajectory_node')
RATE = 500.0      # samples per second [Hz]
_PARAMETERS = {'plant_node': {'rate': RATE, 'wait_for_subscribers': 2},
               'trajectory_node': {'trajectory__autostart': True, 'trajectory__ramp_time': 3.0}}
WINDOW = 60.0     # over which commands are counted [s]
_LATE = 1.5       # periods between two commands: a longer gap is a missed deadline
_PAGE = 4096      # bytes, of /proc/PID/statm on Linux
_WARM = 0.1       # of the run, in which caches fill
_GROWTH = 0.01    # of the memory, over the rest of the run
_TREND = 3.0      # standard deviations by which the last third may miss more than the first


class Window(NamedTuple):
    """What a while of the run showed."""

    commands: int     # how many came
    missed: int       # gaps above _LATE periods
    p99: float        # of the time between two [s]
    longest: float    # [s]
    memory: tuple     # resident, of each of NODES [bytes]


class _Gaps:
    """Times between commands as they were published; those of a window are kept, no more."""

    def __init__(self):
        self._last, self._gaps = None, []

    def append(self, message):
        """Take a command (never used: the bench keeps the time of publishing)."""

    def take(self, _message, info):
        """Take a command and what DDS adds to it."""
        now = info['source_timestamp'] / NANOSECONDS
        if self._last is not None:
            self._gaps.append(now - self._last)
        self._last = now

    def __len__(self):
        return len(self._gaps)

    def pop(self):
        """Return the gaps since the last call, ndarray (G,) [s]."""
        gaps, self._gaps = np.array(self._gaps), []
        return gaps


def soak(bench, duration, *, window=WINDOW, say=lambda text: None):
    """
    Run plant, controller and trajectory in real time for ``duration`` [s]; return its Windows.

    Each is of ``window`` [s]; ``say`` is reported about it.
    """
    gaps, files = _Gaps(), [*default_files(), config('sinusoid.yaml')]
    bench.listen(Float64MultiArray, COMMANDS, gaps)
    nodes = [bench.start(name, files=files, **_PARAMETERS.get(name, {})) for name in NODES]
    bench.until(lambda: len(gaps) > RATE)
    gaps.pop()
    windows = []
    for _ in range(max(round(duration / window), 3)):
        end = time.monotonic() + window
        bench.until(lambda end=end: time.monotonic() > end, window + 60.0)
        windows.append(_window(gaps.pop(), nodes))
        say(f'{len(windows) * window:.0f} s: {sentence(windows[-1])}')
    return windows


def _window(gaps, nodes):
    late = int(np.sum(gaps > _LATE / RATE))
    p99, longest = (float(np.percentile(gaps, q)) if len(gaps) else np.inf for q in (99, 100))
    return Window(len(gaps), late, p99, longest, tuple(map(_resident, nodes)))


def _resident(node):
    """Return the resident memory of a process [bytes]; NaN where it has ended."""
    try:
        pages = Path(f'/proc/{node.process.pid}/statm').read_text().split()[1]
    except (OSError, IndexError):
        return np.nan
    return int(pages) * _PAGE


def sentence(window):
    """Return a Window in words."""
    memory = ', '.join(f'{part / 1e6:.1f}' for part in window.memory)
    return (f'{window.commands} commands, {window.missed} late, p99 {1e3 * window.p99:.3g} ms, '
            f'longest {1e3 * window.longest:.3g} ms; {memory} MB')


def judged(windows):
    """
    Return sentences on what of a run's ``windows``, three at least, is not as it should be.

    None where memory does not grow and deadlines are not missed more and more.
    """
    memory = np.array([window.memory for window in windows])
    warm, third, found = round(_WARM * len(windows)), len(windows) // 3, []
    for name, column in zip(NODES, memory.T, strict=True):
        begin, end = column[warm:warm + third].min(), column[-third:].min()
        if not end <= (1.0 + _GROWTH) * begin:
            found.append(f'{name}: memory grew from {begin / 1e6:.1f} to {end / 1e6:.1f} MB')
    first, last = (sum(window.missed for window in part)
                   for part in (windows[:third], windows[-third:]))
    if last > first + _TREND * np.sqrt(max(first, 1)) + _TREND:
        found.append(f'deadlines: {first} missed in the first third, {last} in the last')
    return found


def table(windows):
    """Return a run as lines of text."""
    third = max(len(windows) // 3, 1)
    lines = []
    for label, part in (('first third', windows[:third]), ('last third', windows[-third:])):
        whole = Window(sum(one.commands for one in part), sum(one.missed for one in part),
                       max(one.p99 for one in part), max(one.longest for one in part),
                       part[-1].memory)
        lines.append(f'{label:<12} {sentence(whole)}')
    return '\n'.join([f'memory: {", ".join(NODES)}', *lines,
                      *(judged(windows) or ['no growth of memory, no trend of missed deadlines'])])
