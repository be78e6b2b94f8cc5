# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Experiments over DDS: node processes in lockstep, started, watched and ended."""

from contextlib import ExitStack
from dataclasses import dataclass
import os
from pathlib import Path
import random
import shutil
import signal
import subprocess
import sys
import time

from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.recording import Recording, Topics
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.simulation.loop import count_samples, NANOSECONDS
import numpy as np

_STOP_BOUND = 10.0    # a process has so long to end after SIGINT [s]
TOPICS = Topics()[:4]  # all but the voltage of the supply
LISTENERS = 3        # controller, trajectory and recorder or identification
SLOWEST_STEPS = 100  # simulated samples per second on the slowest machine we wait for
START_BOUND = 120.0  # for processes to start, compiling included [s]


class ProcessError(GmsFlexError):
    """A node process ended when it should not have, or did not end."""


def executable(name: str) -> list[str]:
    """Return the command (list) that starts ``plant_node`` or the like, script or `module_of`."""
    beside = Path(sys.executable).parent / name
    found = str(beside) if beside.is_file() else shutil.which(name)
    return [found] if found else module_of(name)


def module_of(name: str) -> list[str]:
    """Return the command that starts an executable from its sources."""
    words = ['cli.main'] if name == 'gms_flex' else ['nodes.start', name]
    return [sys.executable, '-m', f'gms_flex_control.{words[0]}', *words[1:]]


def ros_arguments(files=(), parameters: dict | None = None) -> list[str]:
    """Return ``--ros-args`` with parameter files and single parameters (dict)."""
    arguments = ['--ros-args']
    for file in files:
        arguments += ['--params-file', str(file)]
    for name, value in (parameters or {}).items():
        text = str(value).lower() if isinstance(value, bool) else str(value) or "''"
        arguments += ['-p', f'{name}:={text}']
    return arguments


class Processes:
    """
    A group of processes that ends with the ``with`` block, however that ends.

    All have the same environment (dict of str); what one prints goes to <log>/<name>.log.
    """

    def __init__(self, environment: dict, log: Path):
        self._environment, self._log = environment, log
        self._running = {}
        self._files = ExitStack()

    def start(self, name: str, command: list) -> subprocess.Popen:
        """Start ``command`` (list of str) under ``name``."""
        self._log.mkdir(parents=True, exist_ok=True)
        output = self._files.enter_context(self._path(name).open('wb'))
        self._running[name] = subprocess.Popen(
            command, env=self._environment, stdin=subprocess.DEVNULL, stdout=output,
            stderr=subprocess.STDOUT)
        return self._running[name]

    def start_node(self, name: str, files, parameters: dict | None = None) -> None:
        """Start ``<name>_node`` in lockstep with parameter files, and single parameters."""
        self.start(name, [*executable(f'{name}_node'), *ros_arguments(
            files, {'mode': 'lockstep', **(parameters or {})})])

    def stop_all(self, *names: str) -> None:
        """Stop several processes, one after the other."""
        for name in names:
            self.stop(name)

    def _path(self, name):
        return self._log / f'{name}.log'

    def printed(self, name: str) -> str:
        """Return what ``name`` has printed so far."""
        return self._path(name).read_text(encoding='utf-8', errors='replace')

    def wait_for_text(self, name: str, texts, bound: float) -> None:
        """Wait until ``name`` printed all ``texts``; ProcessError after ``bound`` s or an end."""
        self._wait(name, lambda: all(text in self.printed(name) for text in texts), bound,
                   f'print {texts}', lambda other, code: code is not None)

    def wait(self, name: str, bound: float, meanwhile=lambda: None) -> None:
        """Wait until ``name`` ends with exit code 0 while others run, or raise ProcessError."""
        def done():
            ended = self._running[name].poll() is not None
            meanwhile()
            return ended

        self._wait(name, done, bound, 'end',
                   lambda other, code: other != name and code not in (None, 0))
        if self._running[name].returncode != 0:
            raise ProcessError(self._ended(name))

    def _wait(self, name, done, bound, what, failed):
        end = time.monotonic() + bound
        while not done():
            for other, process in self._running.items():
                if failed(other, process.poll()):
                    raise ProcessError(self._ended(other))
            if time.monotonic() > end:
                raise ProcessError(f'{name} did not {what} within {bound:g} s'
                                   f'{self._where(name)}')
            time.sleep(0.02)

    def stop(self, name: str, bound: float = _STOP_BOUND) -> int:
        """Send SIGINT and return the exit code; SIGKILL if it does not end within ``bound`` s."""
        process = self._running[name]
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            return process.wait(timeout=bound)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise ProcessError(f'{name} did not end within {bound:g} s of SIGINT'
                               f'{self._where(name)}') from None

    def _ended(self, name):
        last = self.printed(name).strip().splitlines()[-1:]
        said = f' ({last[0]})' if last else ''
        return (f'{name} ended with exit code {self._running[name].returncode}{said}'
                f'{self._where(name)}')

    def _where(self, name):
        return f'; see {self._path(name)}'

    def __enter__(self):
        """Return the processes, none of them started yet."""
        return self

    def __exit__(self, *_):
        """Kill what still runs, and close the logs."""
        for process in self._running.values():
            if process.poll() is None:
                process.kill()
                process.wait()
        self._files.close()


@dataclass(frozen=True, kw_only=True)
class DrivenPlan:
    """One experiment over DDS in lockstep."""

    files: tuple        # of Path: robot, controller and trajectory parameters
    model: Path         # robot file the controller believes in
    compensation: str
    duration: float     # simulated [s]
    rate: float         # joint states per simulated second [Hz]
    plant: Path | None = None  # robot file of the plant alone; default the robot of ``files``


def private_environment() -> dict:
    """Return this environment with a ROS domain of its own on this machine alone."""
    # ids up to 101 keep the ports below Linux's ephemeral range
    domain = os.environ.get('ROS_DOMAIN_ID') or str(random.SystemRandom().randint(1, 101))
    return {**os.environ, 'ROS_DOMAIN_ID': domain,
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PYTHONUNBUFFERED': '1'}


def drive_recorded(plan: DrivenPlan, bag: Path, *, log: Path) -> Recording:
    """Run plant, controller, trajectory and recorder; return the Recording, or ProcessError."""
    bag.parent.mkdir(parents=True, exist_ok=True)
    bound = START_BOUND + plan.duration * plan.rate / SLOWEST_STEPS
    with Processes(private_environment(), log / bag.name) as processes:
        processes.start('recorder', [*executable('gms_flex'), 'record', '--topics', *TOPICS,
                                     '--out', str(bag)])
        # the model last: what the controller believes; both answer once the recorder hears them
        processes.start_node('controller', [*plan.files, plan.model],
                             {'compensation': plan.compensation, 'recorders': 1})
        processes.start_node('trajectory', plan.files,
                             {'trajectory.autostart': True, 'recorders': 1})
        processes.wait_for_text('recorder', [f'subscribed to {topic} ' for topic in TOPICS[1:]],
                                START_BOUND)
        processes.start_node(
            'plant', plan.files if plan.plant is None else [*plan.files, plan.plant],
            {'rate': plan.rate, 'duration': plan.duration, 'wait_for_subscribers': LISTENERS})
        processes.wait('plant', bound)
        processes.stop_all('trajectory', 'controller')
        processes.stop('recorder', START_BOUND)  # it writes first what waits
    return _require_whole(read_recording(bag), plan)


def _require_whole(recording, plan):
    """Return the Recording; raise ProcessError if a sample of the plan lacks anything."""
    planned = count_samples(plan.duration, round(NANOSECONDS / plan.rate))
    known = [np.isfinite(values).any(axis=tuple(range(1, values.ndim))) for values in (
        recording.command, recording.reference, recording.friction_hat)]
    lost = planned - int(np.all(known, axis=0).sum())
    if lost > 0:
        raise ProcessError(f'{recording.source}: {lost} of {planned} samples lack their state or '
                           'an answer, lost on the way to the recorder, which stood still or was '
                           'stopped; repeat the command')
    return recording
