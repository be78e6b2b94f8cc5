# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Functions that the tests' batches call in other processes."""

import os
from pathlib import Path
import signal
import time

from gms_flex_control.errors import SimulationError
import numpy as np


def walk(seed):
    """Return plain values that only come out equal where they are computed equally."""
    steps = np.random.default_rng(seed).standard_normal(1000)
    return {'end': float(np.cumsum(steps)[-1]), 'largest': [float(np.abs(steps).max()), seed]}


def noted_walk(item):
    """Return `walk` of (seed, folder), and leave a file for each call."""
    seed, folder = item
    number = len(list(Path(folder).glob(f'{seed}_*')))
    (Path(folder) / f'{seed}_{number}').write_text(str(os.getpid()))
    return walk(seed)


def deadly_walk(item):
    """Return `walk` of (seed, folder, victim); the victim's first call kills its process."""
    seed, folder, victim = item
    mark = Path(folder) / 'killed'
    if seed == victim and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return walk(seed)


def slow_walk(item):
    """Return `walk` of (seed, folder) once the test allows it by a file ``go``."""
    seed, folder = item
    (Path(folder) / f'begun_{seed}_{os.getpid()}').touch()
    while not (Path(folder) / 'go').exists():
        time.sleep(0.01)
    return walk(seed)


def soon_deadly_walk(item):
    """Return `walk` of (seed, victim) after a while; the victim always kills its process."""
    seed, victim = item
    if seed == victim:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(1.0)
    return walk(seed)


def always_deadly(_):
    """Kill the process that works on this."""
    os.kill(os.getpid(), signal.SIGKILL)


def fail(seed):
    """Raise for one of the items."""
    if seed == 1:
        raise SimulationError('diverged')
    return seed
