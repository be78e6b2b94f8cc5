# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The commands of the tutorials do what the tutorials say, and the documents' links lead on."""

import os
from pathlib import Path
import re
import shutil
import subprocess
from time import monotonic, sleep

from gms_flex_control.data.reader import read_recording
import numpy as np
from processes import environment_of
import pytest
from tutorial import (
    is_as_documented,
    JUDGED,
    OWN,
    parts_of,
    PATIENCE,
    ROOT,
    Terminals,
    TUTORIALS,
    write_tool,
)

# what nodes say on a machine that is too busy for them; the bridge answers it with FAULT
LATE = 'too busy for this rate|no usable joint state|was silent for|jumped by'


def as_script(commands):
    """Return a shell script that keeps what each command prints, and its exit code."""
    return '\n'.join(f'{{ {command}\n}} > out{k} 2>&1; echo $? > code{k}'
                     for k, (command, _) in enumerate(commands))


@pytest.fixture
def environment(tmp_path):
    """Return an environment with the tool on PATH, from this source tree."""
    tools = tmp_path / 'tools'
    tools.mkdir()
    write_tool(tools / 'gms_flex', '-m gms_flex_control.cli.main')
    return {**environment_of(), 'CONFIG': str(ROOT / 'config'),
            'EXAMPLES': str(ROOT / 'examples'),
            'PATH': f'{tools}{os.pathsep}{os.environ["PATH"]}'}


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
        assert is_as_documented(printed, expected), (
            f'{command}\nprinted\n{printed}\ninstead of\n{expected}')
        assert int((here / f'code{k}').read_text()) in JUDGED, f'{command}\n{printed}'
    if commands[-1][0].startswith('rm '):  # so that the page can be followed a second time
        assert list(here.rglob('metadata.yaml')) == []


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
    with Terminals(here, with_ros) as terminals:
        for prose, commands in parts_of(TUTORIALS / 'with_a_robot.md'):
            if 'Ctrl-C' in prose:
                codes = terminals.interrupt()
                assert codes and not any(codes), terminals.shown()
            for command, expected in commands:
                if command.endswith(OWN):
                    terminals.start(command.removesuffix(OWN))
                else:
                    terminals.do(command, expected)
        assert terminals.interrupt() == []
        terminals.do('ros2 daemon stop', '...')
        angles = read_recording(here / 'first').q_link
        if not re.search(LATE, terminals.shown()):
            assert (np.ptp(angles, axis=0) > 0.5).all(), terminals.shown()  # of 0.6
        assert 'Traceback' not in terminals.shown()
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
