# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The loop over three ROS 2 processes in real time: rate, round trip, losses, processor time."""

from importlib.util import find_spec
import json
import os
from pathlib import Path
import tempfile
import time

from gms_flex_control.benchmarks.timing import Measurement
from gms_flex_control.experiment.driven import private_environment
from gms_flex_control.experiment.processes import executable, Processes, ros_arguments
from gms_flex_control.resources import share_path

_START_BOUND, _SETTLE = 120.0, 1.0  # [s]
_RATES = (500.0, 1000.0)
_NODES = ('plant', 'controller', 'trajectory')
# targets at 1 kHz on an idle machine of 2 cores
_TARGETS = {'answered_in_time': (99.9, True), 'lost': (0, False),
            'interval_error_p99_us': (100.0, False), 'round_trip_p99_us': (600.0, False),
            'processor': (80.0, False)}


def measure(robot, gains, quick=False):
    """
    Run the three nodes at 500 Hz and 1 kHz.

    Parameters
    ----------
    robot, gains : RobotParams, ControllerParams
        Not used: the nodes read the package's own files.
    quick : bool
        3 s per rate instead of 15 s.

    Returns
    -------
    list of Measurement
        Empty where ROS is not installed.

    """
    if find_spec('rclpy') is None:
        return []
    found = []
    for rate in _RATES:
        found += _measurements(rate, *run_loop(rate, 3.0 if quick else 15.0))
    return found


def run_loop(rate, duration):
    """
    Run the nodes in real time.

    Parameters
    ----------
    rate : float
        Joint states per second [Hz].
    duration : float
        How long [s].

    Returns
    -------
    timing : dict
        What the plant measured, see nodes.loop_timing.
    processor : dict of str to float
        Share of one core each node took while it ran [%].

    """
    config = share_path() / 'config'
    files = [config / 'robot.yaml', config / 'controller.yaml', config / 'sinusoid.yaml']
    with tempfile.TemporaryDirectory() as folder:
        timing = Path(folder) / 'timing.json'
        with Processes(private_environment(), Path(folder)) as processes:
            running = {
                'controller': processes.start('controller', [
                    *executable('controller_node'), *ros_arguments(files)]),
                'trajectory': processes.start('trajectory', [
                    *executable('trajectory_node'),
                    *ros_arguments(files, {'trajectory.autostart': True})])}
            for name in running:
                processes.wait_for_text(name, ['[INFO]'], _START_BOUND)
            running['plant'] = processes.start('plant', [
                *executable('plant_node'), *ros_arguments(files, {
                    'rate': rate, 'substeps': 10, 'duration': duration, 'timing_file': timing,
                    'wait_for_subscribers': 2})])
            processes.wait_for_text('plant', ['[INFO]'], _START_BOUND)
            time.sleep(_SETTLE)  # measures the loop, not its start
            begin = {name: cpu_time(process.pid) for name, process in running.items()}
            time.sleep(duration - 2.0 * _SETTLE)
            processor = {name: 100.0 * (cpu_time(process.pid) - begin[name])
                         / (duration - 2.0 * _SETTLE) for name, process in running.items()}
            processes.wait('plant', _START_BOUND)
            processes.stop('trajectory')
            processes.stop('controller')
        return json.loads(timing.read_text(encoding='utf-8')), processor


def cpu_time(pid):
    """Return the processor time of a process so far [s] (Linux)."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _measurements(rate, timing, processor):
    """Return what one run measured; the targets hold at 1 kHz."""
    def figure(name, key, value, unit, note=''):
        target, at_least = _TARGETS.get(key, (None, True)) if rate == 1000.0 else (None, True)
        return Measurement(suite='ros', name=f'{rate:g} Hz: {name}', value=value, unit=unit,
                           target=target, at_least=at_least, note=note)

    shares = ', '.join(f'{name} {processor[name]:.0f}' for name in _NODES)
    return [
        figure('achieved rate', 'rate', timing['rate'], 'Hz'),
        figure('answered in time', 'answered_in_time', 100.0 * timing['answered_in_time'], '%',
               f"of {timing['samples']} samples"),
        figure('never answered', 'lost', timing['lost'], 'samples'),
        figure('interval error p99', 'interval_error_p99_us', timing['interval_error_p99_us'],
               'us'),
        figure('round trip median', 'round_trip_median_us', timing['round_trip_median_us'],
               'us'),
        figure('round trip p99', 'round_trip_p99_us', timing['round_trip_p99_us'], 'us'),
        figure('processor, all nodes', 'processor', sum(processor.values()), '%', shares)]
