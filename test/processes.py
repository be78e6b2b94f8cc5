# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The tool as a process of its own, of this clone, on a ROS domain of its own where nodes run."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
TOOL = [sys.executable, '-m', 'gms_flex_control.cli.main']
BENCH = [sys.executable, '-m', 'bench']


def environment_of(**further):
    """Return the environment of a process that finds the package."""
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
    return {**os.environ, 'PYTHONPATH': path, **further}


def run_tool(*words, timeout=200, **environment):
    """Return the finished process of ``gms_flex``, or of the bench for a demonstration of it."""
    tool = BENCH if str(words[0]).startswith('demo-') else TOOL
    return subprocess.run([*tool, *map(str, words)], text=True, capture_output=True,
                          timeout=timeout, check=False, env=environment_of(**environment))


def run_with_nodes(*words, timeout=600):
    """Return the finished process of a verb that starts nodes and succeeds, ``--out`` in words."""
    domain, lock = pytest.importorskip('node_harness').take_domain()
    with lock:
        done = run_tool(*words, timeout=timeout, ROS_DOMAIN_ID=str(domain))
    assert done.returncode == 0, done.stdout + done.stderr
    logs = Path(words[words.index('--out') + 1]).rglob('*.log')
    assert not [log for log in logs if 'Traceback' in log.read_text()]
    return done
