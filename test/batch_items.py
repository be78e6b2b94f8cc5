# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Functions that the tests' batches call in other processes."""

import os
import signal

from gms_flex_control.errors import SimulationError
import numpy as np


def walk(seed):
    """Return plain values that only come out equal where they are computed equally."""
    steps = np.random.default_rng(seed).standard_normal(1000)
    return {'end': float(np.cumsum(steps)[-1]), 'largest': [float(np.abs(steps).max()), seed]}


def always_deadly(_):
    """Kill the process that works on this."""
    os.kill(os.getpid(), signal.SIGKILL)


def fail(seed):
    """Raise for one of the items."""
    if seed == 1:
        raise SimulationError('diverged')
    return seed
