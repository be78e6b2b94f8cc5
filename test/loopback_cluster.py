# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A real Dask scheduler with two workers on loopback."""

from contextlib import contextmanager
import os
from pathlib import Path
import re
import subprocess
import sys
import time

import pytest

ROOT = Path(__file__).parents[1]
PATIENCE = 60.0  # s


def until(condition):
    """Wait for a condition to hold, and return what it returned."""
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return value


@contextmanager
def cluster(folder, allowed_failures=3):
    """Yield address and worker processes of a real scheduler with two workers on loopback."""
    pytest.importorskip('distributed', reason="Dask is not installed (extra 'dask')")
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), str(ROOT / 'test')]),
                   'DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES': str(allowed_failures)}
    started = []

    def start(name, *arguments):
        log = folder / f'{name}.log'
        with log.open('w') as file:
            started.append(subprocess.Popen(
                [sys.executable, '-m', *arguments], env=environment, stdout=file, stderr=file,
                cwd=folder))
        return log

    try:
        log = start('scheduler', 'distributed.cli.dask_scheduler', '--host', '127.0.0.1',
                    '--port', '0', '--no-dashboard')
        address = until(lambda: re.search(r'Scheduler at: +(tcp://[\d.:]+)', log.read_text()))[1]
        logs = [start(f'worker_{i}', 'distributed.cli.dask_worker', address, '--nthreads', '1',
                      '--no-nanny', '--no-dashboard', '--host', '127.0.0.1') for i in range(2)]
        until(lambda: all('Registered to' in log.read_text() for log in logs))
        yield address, started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()
