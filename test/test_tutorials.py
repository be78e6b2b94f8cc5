# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The commands of the tutorials do what the tutorials say, and the documents' links lead on."""

from contextlib import suppress
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
from time import monotonic, sleep
from uuid import uuid4

from gms_flex_control.bags.reader import read_recording
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / 'docs' / 'tutorials'
JUDGED = (0, 1, 2)  # exit codes of the tool; what is printed is compared all the same
PATIENCE = 180.0    # for nodes to come and to end [s]
# what nodes say on a machine that is too busy for them; the bridge answers it with FAULT
LATE = 'too busy for this rate|no usable joint state|was silent for|jumped by'


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


def as_script(commands):
    """Return a shell script that keeps what each command prints, and its exit code."""
    return '\n'.join(f'{{ {command}\n}} > out{k} 2>&1; echo $? > code{k}'
                     for k, (command, _) in enumerate(commands))


def is_as_told(printed, expected):
    """Return whether a command printed what the tutorial says."""
    return OutputChecker().check_output(f'{expected}\n', printed or '\n',
                                        ELLIPSIS | NORMALIZE_WHITESPACE)


@pytest.fixture
def environment(tmp_path):
    """Return an environment with the tool on PATH, from this source tree."""
    tools = tmp_path / 'tools'
    tools.mkdir()
    write_tool(tools / 'gms_flex', '-m gms_flex_control.cli.main')
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
    return {**os.environ, 'PYTHONPATH': path, 'CONFIG': str(ROOT / 'config'),
            'EXAMPLES': str(ROOT / 'examples'),
            'PATH': f'{tools}{os.pathsep}{os.environ["PATH"]}'}


def write_tool(path, words):
    """Write an executable that runs Python with some words before its own."""
    path.write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n')
    path.chmod(0o755)


@pytest.fixture
def here(tmp_path):
    """Return an empty folder to work in."""
    (tmp_path / 'here').mkdir()
    return tmp_path / 'here'


@pytest.mark.parametrize('name', ['without_ros', 'with_a_bag'])
def test_the_commands_print_what_the_tutorial_says(name, environment, here):
    commands = [one for _, block in parts_of(TUTORIALS / f'{name}.md') for one in block]
    subprocess.run(['bash', '-c', as_script(commands)], cwd=here, env=environment, timeout=900,
                   check=False, stdin=subprocess.DEVNULL)
    for k, (command, expected) in enumerate(commands):
        printed = (here / f'out{k}').read_text()
        assert is_as_told(printed, expected), (
            f'{command}\nprinted\n{printed}\ninstead of\n{expected}')
        assert int((here / f'code{k}').read_text()) in JUDGED, f'{command}\n{printed}'


class Terminals:
    """
    Somebody who follows a tutorial, with a terminal for each command that wants one of its own.

    Parameters
    ----------
    here : Path
        Where the commands are given.
    environment : dict of str
        For them.

    """

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

    def do(self, command, expected):
        """Give a command until it does what is expected: nodes need a while to be there."""
        end = monotonic() + PATIENCE
        while True:
            done = subprocess.run(['bash', '-c', command], cwd=self._here, timeout=300,
                                  env=self._environment, stdin=subprocess.DEVNULL, text=True,
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
            if done.returncode == 0 and is_as_told(done.stdout, expected):
                return
            assert command.startswith('ros2 ') and monotonic() < end, (
                f'{command}\nprinted\n{done.stdout}\ninstead of\n{expected}\n{self.told()}')

    def interrupt(self):
        """Press Ctrl-C in every terminal; return the exit codes."""
        for process in self._open:
            os.killpg(process.pid, signal.SIGINT)
        codes = [process.wait(timeout=PATIENCE) for process in self._open]
        self._open.clear()
        return codes

    def told(self):
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


@pytest.fixture
def with_ros(environment, tmp_path):
    """Yield that environment with ``ros2`` and a domain of its own."""
    harness = pytest.importorskip('node_harness')
    number, lock = harness.take_domain()
    environment |= {'ROS_DOMAIN_ID': str(number), harness.DISCOVERY: 'LOCALHOST',
                    'PYTHONUNBUFFERED': '1', 'ROS_LOG_DIR': str(tmp_path / 'log')}
    if not shutil.which('ros2', path=environment['PATH']):
        write_tool(Path(environment['PATH'].split(os.pathsep)[0]) / 'ros2',
                   ROOT / 'test' / 'ros2_stand_in.py')
    with lock:
        yield environment


@pytest.mark.flaky(reruns=2)  # other processes of the machine can delay real nodes
def test_the_arm_moves_as_the_tutorial_says_and_everything_ends(with_ros, here):
    """Where the prose says Ctrl-C every terminal gets it, ends well and leaves nothing behind."""
    own = '   # a terminal of its own'
    with Terminals(here, with_ros) as terminals:
        for prose, commands in parts_of(TUTORIALS / 'with_a_robot.md'):
            if 'Ctrl-C' in prose:
                codes = terminals.interrupt()
                assert codes and not any(codes), terminals.told()
            for command, expected in commands:
                if command.endswith(own):
                    terminals.start(command.removesuffix(own))
                else:
                    terminals.do(command, expected)
        assert terminals.interrupt() == []
        terminals.do('ros2 daemon stop', '...')
        angles = read_recording(here / 'first').q_link
        if not re.search(LATE, terminals.told()):
            assert (np.ptp(angles, axis=0) > 0.5).all(), terminals.told()  # of 0.6
        assert 'Traceback' not in terminals.told()
        end = monotonic() + PATIENCE
        while terminals.left() and monotonic() < end:
            sleep(0.1)
        assert terminals.left() == []


@pytest.mark.parametrize('path', [
    path.relative_to(ROOT).as_posix() for path in (*ROOT.glob('*.md'), *ROOT.glob('docs/**/*.md'))
    if '_' not in path.parent.name])
def test_links_to_files_lead_somewhere(path):
    text = re.sub(r'```.*?```', '', (ROOT / path).read_text(encoding='utf-8'), flags=re.DOTALL)
    for target in re.findall(r'\]\(([^)#\s]+)', text):
        if '://' not in target:
            assert ((ROOT / path).parent / target).exists(), f'{path}: {target}'


def test_every_document_stands_in_the_contents():
    listed = (ROOT / 'docs' / 'index.md').read_text(encoding='utf-8').split()
    there = {path.relative_to(ROOT / 'docs').with_suffix('').as_posix()
             for path in (ROOT / 'docs').glob('**/*.md') if '_' not in path.parts[-2]}
    assert there - {'index'} <= set(listed)
