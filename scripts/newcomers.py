#!/usr/bin/env python3
# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Write docs/newcomers.md: when three newcomers give each command of their tutorial, from a clone on.

    PYTHONPATH=test .venv/bin/python scripts/newcomers.py     # or: make newcomers

Each begins in an empty home without any Python package and follows one tutorial to the letter.
"""

import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from gms_flex_control.files import write_text
from node_harness import DISCOVERY, take_domain
from tutorial import JUDGED, OWN, parts_of, ROOT, Terminals, TUTORIALS, write_tool

PAGE = ROOT / 'docs' / 'newcomers.md'
USERS = (('without_ros', 'Has neither ROS nor a robot', '.'),
         ('with_a_bag', 'Has a bag', '.'),
         ('with_a_robot', 'Has ROS and a robot', "'.[ros]'"))
HEAD = """# How long does it take?

`make newcomers` follows the tutorials in fresh clones with an empty home. The time on the left is
since the clone began; the tutorials show what each command prints. The machine had {cores}
cores{cpu}, a package registry nearby, and no ROS: `ros2` is the stand-in of the tests
(`test/ros2_stand_in.py`), which starts the real nodes. The robot is simulated.
"""


def main():
    """Write the page; return 0."""
    sections = [HEAD.format(cores=os.cpu_count(), cpu=processor())]
    for name, title, extras in USERS:
        print(title, flush=True)
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            sections.append(transcript(Path(folder), name, title, extras))
    write_text(PAGE, '\n'.join(sections))
    print(PAGE)
    return 0


def processor():
    """Return the name of the processor as words to be added; '' if it is not known."""
    with open('/proc/cpuinfo', encoding='utf-8') as lines:
        return next((f" ({line.split(':')[1].strip()})" for line in lines
                     if line.startswith('model name')), '')


class Scribe:
    """Writes down what is typed, and when."""

    def __init__(self):
        self.lines, self._begin = [], time.monotonic()

    @property
    def seconds(self):
        """Return how long it has taken so far [s]."""
        return time.monotonic() - self._begin

    def note(self, begun, command):
        """Note a command that was given at ``begun`` [s]."""
        self.lines.append(f'{begun:6.1f} s  $ {command}')

    def run(self, command, folder, environment):
        """Give a command that must succeed."""
        begun = self.seconds
        done = subprocess.run(['bash', '-c', command], cwd=folder, env=environment, text=True,
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, check=False)
        if done.returncode:
            sys.exit(f'newcomers.py: {command}: exit code {done.returncode}\n{done.stdout}')
        self.note(begun, command)


def transcript(folder, name, title, extras):
    """Return the section of one newcomer, who works in an empty folder."""
    environment = {'HOME': str(folder), 'PATH': '/usr/bin:/bin', 'LANG': 'C.UTF-8'}
    clone, here, scribe = folder / 'gms_flex_control', folder / 'here', Scribe()
    here.mkdir()
    scribe.run(f'git clone --quiet {ROOT} gms_flex_control', folder, environment)
    scribe.lines[-1] = scribe.lines[-1].replace(str(ROOT), 'URL_OF_THIS_REPOSITORY')
    scribe.run('python3 -m venv .venv && .venv/bin/pip install --quiet --use-pep517 '
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
        follow(name, here, environment, scribe)
    text = '\n'.join(scribe.lines).replace(str(folder), '~')
    return (f'## {title}: {scribe.seconds:.0f} s\n\n[The tutorial](tutorials/{name}.md)\n\n'
            f'```text\n{text}\n```\n')


def follow(name, here, environment, scribe):
    """Give all commands of a tutorial."""
    with Terminals(here, environment) as terminals:
        for prose, commands in parts_of(TUTORIALS / f'{name}.md'):
            if 'Ctrl-C' in prose and terminals.interrupt():
                scribe.note(scribe.seconds, '^C')
            for command, expected in commands:
                begun = scribe.seconds
                if command.endswith(OWN):
                    terminals.start(command.removesuffix(OWN))
                else:
                    terminals.do(command, expected, JUDGED)
                scribe.note(begun, command)


if __name__ == '__main__':
    sys.exit(main())
