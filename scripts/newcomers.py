#!/usr/bin/env python3
# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Write docs/newcomers.md: how long three newcomers take, from a clone to the end of their tutorial.

    PYTHONPATH=test:. .venv/bin/python scripts/newcomers.py     # or: make newcomers

Each begins in an empty home without any Python package and follows one tutorial to the letter.
"""

import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from gms_flex_control.file_io import write_text
from node_harness import DISCOVERY, take_domain
from tutorial import JUDGED, OWN, parts_of, ROOT, Terminals, TUTORIALS, write_tool

PAGE = ROOT / 'docs' / 'newcomers.md'
USERS = (('without_ros', 'neither ROS nor a robot', '.'),
         ('with_a_bag', 'a bag', '.'),
         ('with_a_robot', 'ROS and a robot', "'.[ros]'"))
HEAD = """# How long does it take?

`make newcomers` follows the tutorials in fresh clones, on {cores} cores with a package registry
nearby and a simulated robot. Seconds since the clone began:

| you have | installed | the longest command ends | the last ends |
|---|---|---|---|
"""


def main():
    """Write the page; return 0."""
    rows = []
    for name, title, extras in USERS:
        print(title, flush=True)
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            rows.append(row(Path(folder), name, title, extras))
    head = HEAD.format(cores=os.cpu_count())
    write_text(PAGE, '\n'.join([head + rows[0], *rows[1:], '']))
    print(PAGE)
    return 0


class Watch:
    """Knows when each command began and ended."""

    def __init__(self):
        self.ended, self._begin = [], time.monotonic()

    @property
    def seconds(self):
        """Return how long it has taken so far [s]."""
        return time.monotonic() - self._begin

    def note(self, begun, command):
        """Note a command that was given at ``begun`` [s] and has ended."""
        self.ended.append((begun, self.seconds, command))

    def run(self, command, folder, environment):
        """Give a command that must succeed."""
        begun = self.seconds
        done = subprocess.run(['bash', '-c', command], cwd=folder, env=environment, text=True,
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, check=False)
        if done.returncode:
            sys.exit(f'newcomers.py: {command}: exit code {done.returncode}\n{done.stdout}')
        self.note(begun, command)


def row(folder, name, title, extras):
    """Return the row of one newcomer, who works in an empty folder."""
    environment = {'HOME': str(folder), 'PATH': '/usr/bin:/bin', 'LANG': 'C.UTF-8'}
    clone, here, watch = folder / 'gms_flex_control', folder / 'here', Watch()
    here.mkdir()
    watch.run(f'git clone --quiet {ROOT} gms_flex_control', folder, environment)
    watch.run('python3 -m venv .venv && .venv/bin/pip install --quiet --use-pep517 '
              f'--disable-pip-version-check -c constraints.txt {extras}', clone, environment)
    environment |= {'PATH': f'{clone}/.venv/bin:/usr/bin:/bin', 'CONFIG': f'{clone}/config',
                    'EXAMPLES': f'{clone}/examples', 'ROS_LOG_DIR': str(folder / 'log')}
    number, lock = take_domain()
    with lock:
        if 'ros' in extras:
            environment |= {'ROS_DOMAIN_ID': str(number), DISCOVERY: 'LOCALHOST',
                            'PYTHONUNBUFFERED': '1'}
            write_tool(clone / '.venv' / 'bin' / 'ros2', clone / 'test' / 'ros2_stand_in.py',
                       clone / '.venv' / 'bin' / 'python')
        follow(name, here, environment, watch)
    (_, installed, _), *given = watch.ended[1:]
    seconds, end, command = max((end - begun, end, command) for begun, end, command in given
                                if not command.startswith('sleep'))
    verb = ' '.join(command.split()[:2])
    return (f'| [{title}](tutorials/{name}.md) | {installed:.0f} s | `{verb}` ({seconds:.0f} s): '
            f'{end:.0f} s | {given[-1][1]:.0f} s |')


def follow(name, here, environment, watch):
    """Give all commands of a tutorial."""
    with Terminals(here, environment) as terminals:
        for prose, commands in parts_of(TUTORIALS / f'{name}.md'):
            if 'Ctrl-C' in prose:
                terminals.interrupt()
            for command, expected in commands:
                begun = watch.seconds
                if command.endswith(OWN):
                    terminals.start(command.removesuffix(OWN))
                else:
                    terminals.do(command, expected, JUDGED)
                watch.note(begun, command)


if __name__ == '__main__':
    sys.exit(main())
