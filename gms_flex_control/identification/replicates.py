# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Replicates of the bootstrap, here or where an executor has them made.

All blocks are drawn before the work is divided, and each replicate is computed by itself: the
numbers are the same to the last bit wherever and in however many parts they are made.
"""

from concurrent.futures import ThreadPoolExecutor

from gms_flex_control.batches.batch import run_batch
from gms_flex_control.blas import alone_in_one_thread
from gms_flex_control.identification.uncertainty import steps_of
import numpy as np

_PART = 100  # replicates of an item


def make_steps(draws, executor=None):
    """
    Return the steps of all replicates of fits.

    Parameters
    ----------
    draws : sequence of Drawn
        One of each fit.
    executor : Executor, optional
        From batches.executor; default: in this process, a thread for each fit.

    Returns
    -------
    list of ndarray, shape (R, P)

    Raises
    ------
    BatchError
        See Executor.

    """
    if not draws:
        return []
    if executor is None:
        with alone_in_one_thread(), ThreadPoolExecutor(max_workers=len(draws)) as pool:
            return list(pool.map(steps_of, draws))
    items = {f'{place} {first}': drawn._replace(times=drawn.times[first:first + _PART])
             for place, drawn in enumerate(draws)
             for first in range(0, len(drawn.times), _PART)}
    found = run_batch(make_part, items, executor=executor, label='replicates')
    return [np.concatenate([np.array(found[key]) for key in items if key.split()[0] == str(place)])
            for place in range(len(draws))]


def make_part(drawn):
    """Return the steps of a Drawn as lists, made as they are in one process."""
    with alone_in_one_thread():
        return steps_of(drawn).tolist()
