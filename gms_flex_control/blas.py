# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Linear algebra in one thread.

Our matrices are small and our own threads and processes keep all cores busy; threads of BLAS
would wait for a core of their own while others spin.
"""

from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from threading import RLock

try:
    from threadpoolctl import threadpool_limits
except ImportError:  # no rosdep key; without it all is as right, and slower on a busy machine
    threadpool_limits = None


def in_one_thread() -> AbstractContextManager:
    """Return a context: until it is left, BLAS uses one thread, then as many as before."""
    return threadpool_limits(1, 'blas') if threadpool_limits else nullcontext()


_ALONE = RLock()


@contextmanager
def alone_in_one_thread() -> Generator[None, None, None]:
    """
    Let one caller of this process in at a time, with BLAS in one thread.

    How many threads BLAS has belongs to the whole process and decides the last bits of its sums:
    two items that a worker has taken into two threads would set it for each other.
    """
    with _ALONE, in_one_thread():
        yield
