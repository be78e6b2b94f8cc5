# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Start the nodes as processes of their own, as ``ros2 run`` does, and end them in order."""

from contextlib import ExitStack
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from gms_flex_control.errors import GmsFlexError

NODES = ('plant_node', 'controller_node', 'trajectory_node')
_STOP_BOUND = 10.0  # a process has so long to end after SIGINT [s]


class ProcessError(GmsFlexError):
    """A node process ended when it should not have, or did not end."""


def executable(name):
    """
    Return the command that starts an installed executable.

    Parameters
    ----------
    name : str
        Such as ``plant_node`` or ``gms_flex``.

    Returns
    -------
    list of str
        The console script beside this Python or on PATH; else its module.

    """
    beside = Path(sys.executable).parent / name
    found = str(beside) if beside.is_file() else shutil.which(name)
    if found:
        return [found]
    module = 'cli.main' if name == 'gms_flex' else f'nodes.{name}'
    return [sys.executable, '-m', f'gms_flex_control.{module}']


def ros_arguments(files=(), parameters=None):
    """Return ``--ros-args`` with parameter files and single parameters (dict)."""
    arguments = ['--ros-args']
    for file in files:
        arguments += ['--params-file', str(file)]
    for name, value in (parameters or {}).items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ['-p', f'{name}:={text}']
    return arguments


class Processes:
    """
    A group of processes that ends with the ``with`` block, however that ends.

    Parameters
    ----------
    environment : dict of str
        Of all processes, with ROS_DOMAIN_ID and the like.
    log : Path
        Folder for what they print, ``<name>.log``.

    """

    def __init__(self, environment, log):
        self._environment, self._log = environment, log
        self._running = {}
        self._files = ExitStack()

    def start(self, name, command):
        """Start ``command`` (list of str) under ``name`` and return its Popen."""
        self._log.mkdir(parents=True, exist_ok=True)
        output = self._files.enter_context(self._path(name).open('wb'))
        self._running[name] = subprocess.Popen(
            command, env=self._environment, stdin=subprocess.DEVNULL, stdout=output,
            stderr=subprocess.STDOUT)
        return self._running[name]

    def _path(self, name):
        return self._log / f'{name}.log'

    def printed(self, name):
        """Return what ``name`` has printed so far (str)."""
        return self._path(name).read_text(encoding='utf-8', errors='replace')

    def wait_for_text(self, name, texts, bound):
        """
        Wait until ``name`` has printed every one of ``texts`` while all processes run.

        Raises
        ------
        ProcessError
            If it does not within ``bound`` seconds, or any process ends.

        """
        end = time.monotonic() + bound
        while not all(text in self.printed(name) for text in texts):
            for other, process in self._running.items():
                if process.poll() is not None:
                    raise ProcessError(self._ended(other))
            if time.monotonic() > end:
                raise ProcessError(f'{name} did not print {texts} within {bound:g} s'
                                   f'{self._where(name)}')
            time.sleep(0.02)

    def wait(self, name, bound, meanwhile=None):
        """
        Wait until ``name`` ends by itself with exit code 0 while the others run.

        Parameters
        ----------
        name : str
            The process.
        bound : float
            How long to wait [s].
        meanwhile : callable, optional
            Called without arguments now and then, and once in the end.

        Raises
        ------
        ProcessError
            If it does not within ``bound`` seconds, or any of them fails.

        """
        end = time.monotonic() + bound
        meanwhile = meanwhile or (lambda: None)
        while self._running[name].poll() is None:
            meanwhile()
            for other, process in self._running.items():
                if other != name and process.poll() not in (None, 0):
                    raise ProcessError(self._ended(other))
            if time.monotonic() > end:
                raise ProcessError(f'{name} did not end within {bound:g} s{self._where(name)}')
            time.sleep(0.02)
        meanwhile()
        if self._running[name].returncode != 0:
            raise ProcessError(self._ended(name))

    def stop(self, name):
        """Send SIGINT and return the exit code; SIGKILL if it does not end."""
        process = self._running[name]
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            return process.wait(timeout=_STOP_BOUND)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise ProcessError(f'{name} did not end within {_STOP_BOUND:g} s of SIGINT'
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
