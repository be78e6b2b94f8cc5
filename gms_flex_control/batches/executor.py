# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Where the items of a batch are worked on: processes of this machine, or a Dask cluster."""

from contextlib import contextmanager
from typing import Protocol

from gms_flex_control.errors import BatchError


class Executor(Protocol):
    """Something that calls a function for many items, somewhere else."""

    def finished(self, function, items):
        """
        Yield each item's outcome as it comes, in any order.

        Parameters
        ----------
        function : callable
            Of a module, so that another process can import it; takes one item.
        items : sequence
            Arguments, each a value that can be pickled.

        Yields
        ------
        index : int
            Place of the item.
        result : callable
            Returns what the function returned, or raises what it raised; LostItemError if the
            item killed whatever worked on it.

        Raises
        ------
        BatchError
            If workers cannot be reached any more.

        """


@contextmanager
def open_executor(workers=2, scheduler=None):
    """
    Yield an Executor, and end what belongs to it afterwards.

    Parameters
    ----------
    workers : int
        Processes, where there is no scheduler.
    scheduler : str, optional
        Address of the scheduler of a running Dask cluster, ``tcp://host:8786``.

    Yields
    ------
    Executor

    Raises
    ------
    BatchError
        If there are no workers, Dask is not installed, or the scheduler does not answer.

    """
    if scheduler is not None:
        from gms_flex_control.batches.cluster import Cluster
        with Cluster(scheduler) as executor:
            yield executor
        return
    if workers < 1:
        raise BatchError(f'--workers {workers}: at least one is needed')
    from gms_flex_control.batches.processes import Processes
    yield Processes(workers)
