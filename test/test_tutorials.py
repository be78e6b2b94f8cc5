# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The commands of the tutorials do what the tutorials say, and the documents' links lead on."""

from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = ROOT / 'docs' / 'tutorials'
JUDGED = (0, 1, 2)  # exit codes of the tool; what is printed is compared all the same


def commands_of(path):
    """Return (command, what it is to print) of every console block of a tutorial."""
    blocks = re.findall(r'```console\n(.*?)```', path.read_text(encoding='utf-8'), re.DOTALL)
    found = []
    for line in ''.join(blocks).splitlines():
        if line.startswith('$ '):
            found.append([line[2:], []])
        else:
            found[-1][1].append(line)
    return [(command, '\n'.join(lines)) for command, lines in found]


def as_script(commands):
    """Return a shell script that keeps what each command prints, and its exit code."""
    return '\n'.join(f'{{ {command}\n}} > out{k} 2>&1; echo $? > code{k}'
                     for k, (command, _) in enumerate(commands))


@pytest.fixture
def workplace(tmp_path):
    """Return a function that runs a script with the tool on PATH."""
    tools = tmp_path / 'tools'
    tools.mkdir()
    tool = tools / 'gms_flex'
    tool.write_text(f'#!/bin/sh\nexec {sys.executable} -m gms_flex_control.cli.main "$@"\n')
    tool.chmod(0o755)
    here = tmp_path / 'here'
    here.mkdir()
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
    environment = {**os.environ, 'PYTHONPATH': path, 'CONFIG': str(ROOT / 'config'),
                   'EXAMPLES': str(ROOT / 'examples'),
                   'PATH': f'{tools}{os.pathsep}{os.environ["PATH"]}'}

    def run(script):
        subprocess.run(['bash', '-c', script], cwd=here, env=environment, timeout=900,
                       check=False, stdin=subprocess.DEVNULL)
        return here
    return run


@pytest.mark.parametrize('name', ['without_ros', 'with_a_bag'])
def test_the_commands_print_what_the_tutorial_says(name, workplace):
    commands = commands_of(TUTORIALS / f'{name}.md')
    here = workplace(as_script(commands))
    for k, (command, expected) in enumerate(commands):
        printed = (here / f'out{k}').read_text()
        assert OutputChecker().check_output(
            f'{expected}\n', printed or '\n', ELLIPSIS | NORMALIZE_WHITESPACE), (
            f'{command}\nprinted\n{printed}\ninstead of\n{expected}')
        assert int((here / f'code{k}').read_text()) in JUDGED, f'{command}\n{printed}'


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
