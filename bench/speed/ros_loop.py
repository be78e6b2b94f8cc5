# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The loop in real time beside its floor: rate, round trip, losses, processor time.

The floor is an echo of two processes: joint states out, an array back, nothing computed. Figures
of one run are to be compared with each other; every loop has an echo of its own right before it.
"""

from contextlib import suppress
from importlib.util import find_spec
import json
import os
from pathlib import Path
import sys
import tempfile
import time

from bench.speed.timing import Measurement
from gms_flex_control.experiment.driven import (
    executable,
    private_environment,
    Processes,
    ros_arguments,
)
from gms_flex_control.file_io import share_path

_START_BOUND, _SETTLE = 120.0, 1.0  # [s]
_RATES = (500.0, 1000.0)
_ECHO, _TIMED = ([sys.executable, '-m', f'bench.speed.{name}'] for name in ('echo', 'timed_node'))
_TOPICS = ('joint_states', 'effort_controller/commands', 'reference', 'cascade_controller/state',
           'cascade_controller/blocks', 'cascade_controller/sticking')
# targets at 1 kHz on an idle machine of 2 cores: loop, figure -> value and whether at least
_TARGETS = {('three processes', 'round trip p99 / echo'): (1.5, False),
            ('one process', 'answered in time'): (99.95, True),
            ('one process', 'interval error p99 / echo'): (1.0, False),
            ('one process', 'processor'): (45.0, False),
            ('bridge in one process', 'round trip p99 / echo'): (1.2, False)}


def measure(robot, gains, quick=False):
    """
    Run echo, three nodes, one process and bridge at 500 Hz and 1 kHz, where ROS is installed.

    The nodes read the package's own files; ``quick``: 4 s per run instead of 15 s.
    """
    if find_spec('rclpy') is None:
        return []
    found, duration = [], 4.0 if quick else 15.0
    for rate in _RATES:
        for name, run in _LOOPS.items():
            found += _measurements(rate, name, run(rate, duration), run_echo(rate, duration))
    return found


def run_echo(rate, duration):
    """Run the echo; see `run_loop`."""
    with Run() as run:
        run.start('echo', [*_ECHO, 'echo'])
        return run.paced(rate, duration, ['echo', 'pacer'])


def run_bridge(rate, duration):
    """Run loop_node as a bridge to a robot that is the pacer of the echo; see `run_loop`."""
    with Run() as run:
        run.start_node('loop_node', [_config('bridge.yaml')], {'realtime_priority': 0})
        return run.paced(rate, duration, ['loop_node'], '/plant/enable')


def run_loop(rate, duration, *, composed=False, beside=None, **parameters):
    """
    Run the nodes with a simulated robot at a ``rate`` [Hz] for ``duration`` [s].

    ``composed`` is in one process, of which all topics are recorded; ``beside`` starts further
    processes of the Run before the loop, of which one hears the joint states, and returns their
    names. Return what the plant measured (dict, see `timed_node.LoopTiming`), and the share of one
    core each process took while it ran [%].
    """
    moves = {'trajectory.autostart': True}
    with Run() as run:
        timing = run.folder / 'timing.json'
        plant = {'rate': rate, 'substeps': 10, 'duration': duration,
                 'wait_for_subscribers': 2 + composed + (beside is not None)}
        others = [] if beside is None else beside(run)
        if composed:
            names = ['loop_node']
            run.start('recorder', [*executable('gms_flex'), 'record', '--topics', *_TOPICS,
                                   '--out', str(run.folder / 'bag')])
            run.start_node('loop_node', [], {**plant, **moves, **parameters}, timing)
        else:
            names = ['plant_node', 'controller_node', 'trajectory_node']
            run.start_node('controller_node', [], parameters)
            run.start_node('trajectory_node', [], {**moves, **parameters})
            run.start_node('plant_node', [], {**plant, **parameters}, timing)
        run.processes.wait_for_text(names[0], ['ACTIVE'], _START_BOUND)
        processor = run.processor([*names, *others], duration - 2.0 * _SETTLE)
        run.processes.wait(names[0], _START_BOUND)
        return json.loads(timing.read_text(encoding='utf-8')), processor


_LOOPS = {
    'three processes': run_loop,
    'one process': lambda rate, duration: run_loop(rate, duration, composed=True),
    'one process, state_every 10': lambda rate, duration: run_loop(
        rate, duration, composed=True, state_every=10),
    'bridge in one process': run_bridge}


class Run:
    """Processes of one measurement in a domain and a folder of their own."""

    def __enter__(self):
        self._folder = tempfile.TemporaryDirectory()
        self.folder, self._running = Path(self._folder.name), {}
        self.processes = Processes(private_environment(), self.folder)
        return self

    def __exit__(self, *_):
        for name, process in self._running.items():
            if process.poll() is None:
                self.processes.stop(name)
        self.processes.__exit__()
        self._folder.cleanup()

    def start(self, name, command):
        """Start a process."""
        self._running[name] = self.processes.start(name, command)

    def start_node(self, name, files, parameters, timing=None):
        """Start a node, measured into the file ``timing`` if given, and wait until it is there."""
        files = [_config(f'{file}.yaml') for file in ('robot', 'controller', 'sinusoid')] + files
        command = executable(name) if timing is None else [*_TIMED, name, str(timing)]
        self.start(name, [*command, *ros_arguments(files, parameters)])
        reported = '[plant]' if name == 'loop_node' else '[INFO]'
        self.processes.wait_for_text(name, [reported], _START_BOUND)

    def paced(self, rate, duration, names, *service):
        """Run the pacer until it has measured; return its timing and the processor time."""
        timing = self.folder / 'timing.json'
        self.start('pacer', [*_ECHO, 'pacer', str(rate), str(duration), str(timing), *service])
        self.processes.wait_for_text('pacer', ['measures'], _START_BOUND)
        processor = self.processor(names, duration - 2.0 * _SETTLE)
        self.processes.wait('pacer', _START_BOUND)
        return json.loads(timing.read_text(encoding='utf-8')), processor

    def processor(self, names, duration):
        """Return the share of one core that processes take over some time [%]."""
        time.sleep(_SETTLE)  # measures the loop, not its start
        begin = {name: cpu_time(self._running[name].pid) for name in names}
        time.sleep(duration)
        return {name: 100.0 * (cpu_time(self._running[name].pid) - begin[name]) / duration
                for name in names}


def _config(name):
    return share_path() / 'config' / name


def cpu_time(pid):
    """Return the processor time of a process and of those it has started, so far [s] (Linux)."""
    started, taken = {}, {}
    for stat in Path('/proc').glob('[0-9]*/stat'):
        with suppress(OSError):  # it has just ended
            fields = stat.read_text(encoding='utf-8').rpartition(')')[2].split()
            number = int(stat.parent.name)
            taken[number] = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
            started.setdefault(int(fields[1]), []).append(number)
    family, waiting = [], [pid]
    while waiting:
        family.append(waiting.pop())
        waiting += started.get(family[-1], [])
    return sum(taken.get(one, 0.0) for one in family)


def _measurements(rate, loop, ours, echo):
    """Return what one loop and its echo measured; the targets hold at 1 kHz."""
    (timing, processor), (floor, floor_processor) = ours, echo

    def figure(what, value, unit, note=''):
        target, at_least = _TARGETS.get((loop, what), (None, True)) if rate == 1000.0 else (
            None, True)
        return Measurement(suite='ros', name=f'{rate:g} Hz, {loop}: {what}', value=value,
                           unit=unit, target=target, at_least=at_least, note=note)

    def beside(what, key):
        return [figure(what, timing[key], 'us', f'echo {floor[key]:.0f}'),
                figure(f'{what} / echo', timing[key] / floor[key], 'times')]

    shares = ', '.join(f'{name} {share:.0f}' for name, share in processor.items())
    return [
        figure('achieved rate', timing['rate'], 'Hz', f"echo {floor['rate']:.1f}"),
        figure('answered in time', 100.0 * timing['answered_in_time'], '%',
               f"of {timing['samples']} samples, echo {100.0 * floor['answered_in_time']:.2f}"),
        *beside('interval error p99', 'interval_error_p99_us'),
        *beside('round trip median', 'round_trip_median_us'),
        *beside('round trip p99', 'round_trip_p99_us'),
        figure('processor', sum(processor.values()), '%',
               f'{shares}; echo {sum(floor_processor.values()):.0f}')]
