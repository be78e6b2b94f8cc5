# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What the tutorials say, and somebody who does it."""

from contextlib import suppress
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from time import monotonic
from uuid import uuid4

from processes import environment_of

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / 'docs' / 'tutorials'
JUDGED = (0, 1, 2)  # exit codes of the tool; what is printed is compared all the same
OWN = '   # a terminal of its own'
PATIENCE = 180.0    # for nodes to come and to end [s]


def parts_of(path):
    """Return (prose before it, its commands) of every console block of a tutorial."""
    pieces = re.split(r'```console\n(.*?)```', path.read_text(encoding='utf-8'), flags=re.DOTALL)
    return [(prose, commands_in(block))
            for prose, block in zip(pieces[::2], pieces[1::2], strict=False)]


def commands_in(block):
    """Return (command, what it is to print) of a console block."""
    found = []
    for line in block.splitlines():
        if line.startswith('$ '):
            found.append([line[2:], []])
        else:
            found[-1][1].append(line)
    return [(command, '\n'.join(lines)) for command, lines in found]


def is_as_documented(printed, expected):
    """Return whether a command printed what the tutorial says."""
    return OutputChecker().check_output(f'{expected}\n', printed or '\n',
                                        ELLIPSIS | NORMALIZE_WHITESPACE)


def write_tool(path, words, python=sys.executable):
    """Write an executable that runs Python with some words before its own."""
    path.write_text(f'#!/bin/sh\nexec {python} {words} "$@"\n')
    path.chmod(0o755)


class Terminals:
    """Somebody who follows a tutorial, with a terminal for each command that wants one."""

    def __init__(self, here, environment):
        self._here, self._mark = here, f'TUTORIAL={uuid4()}'
        self._environment = environment | dict([self._mark.split('=')])
        self._open, self._printed = [], []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self._open:
            process.kill()
            process.wait()
        for number in self.left():
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)

    def start(self, command):
        """Give a command in a terminal of its own."""
        self._printed.append(self._here / f'terminal{len(self._printed)}')
        with self._printed[-1].open('wb') as output:
            self._open.append(subprocess.Popen(
                ['bash', '-c', command], cwd=self._here, env=self._environment, stdout=output,
                stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True))

    def do(self, command, expected, codes=(0,)):
        """Give a command until it prints what is expected; return that. Nodes need a while."""
        end = monotonic() + PATIENCE
        while True:
            done = subprocess.run(['bash', '-c', command], cwd=self._here, timeout=300,
                                  env=self._environment, stdin=subprocess.DEVNULL, text=True,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
            if done.returncode in codes and is_as_documented(done.stdout, expected):
                return done.stdout
            assert command.startswith('ros2 ') and monotonic() < end, (
                f'{command}\nprinted\n{done.stdout}\ninstead of\n{expected}\n{self.shown()}')

    def interrupt(self):
        """Press Ctrl-C in every terminal; return the exit codes."""
        for process in self._open:
            os.killpg(process.pid, signal.SIGINT)
        codes = [process.wait(timeout=PATIENCE) for process in self._open]
        self._open.clear()
        return codes

    def shown(self):
        """Return what the terminals show."""
        return ''.join(path.read_text(errors='replace') for path in self._printed)

    def left(self):
        """Return the processes that still run of all that were started here."""
        found = []
        for path in Path('/proc').glob('[0-9]*/environ'):
            with suppress(OSError):
                if self._mark.encode() in path.read_bytes():
                    found.append(int(path.parent.name))
        return found


def place_of(folder):
    """Return an empty folder to work in, and an environment with this tool on PATH."""
    tools, here = folder / 'tools', folder / 'here'
    tools.mkdir()
    here.mkdir()
    write_tool(tools / 'gms_flex', '-m gms_flex_control.cli.main')
    return here, {**environment_of(), 'CONFIG': str(ROOT / 'config'),
                  'EXAMPLES': str(ROOT / 'examples'),
                  'PATH': f'{tools}{os.pathsep}{os.environ["PATH"]}'}
