# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Where the items of a batch are worked on: processes of this machine, or a Dask cluster."""

from collections.abc import Generator, Iterator
from concurrent.futures import as_completed, CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
import os
import pickle
import signal
import threading
from typing import Protocol

from gms_flex_control.batches.journal import fingerprint
from gms_flex_control.errors import BatchError, LostItemError

_MOST_BREAKS = 3  # in a row without one finished item
_PATIENCE = '10s'  # for the scheduler to answer
MISSING = ("--scheduler needs Dask: pip install '.[dask]' in the clone, or leave it out for "
           'processes of this machine')


class Executor(Protocol):
    """Something that calls a function for many items, somewhere else."""

    def finished(self, function, items) -> Iterator:
        """
        Yield (index, result) of each item as it comes, in any order.

        ``function`` of a module takes one item, a value that can be pickled. ``result()`` returns
        what it returned or raises what it raised, LostItemError if the item killed whatever worked
        on it. BatchError if workers cannot be reached any more.
        """


@contextmanager
def open_executor(workers: int = 2, scheduler: str | None = None) -> Generator:
    """
    Yield an Executor, and end what belongs to it afterwards.

    It has ``workers`` processes, or those of the Dask cluster whose scheduler has the address
    ``scheduler``, such as tcp://host:8786. BatchError is raised if there are no workers, Dask is
    not installed, or the scheduler does not answer.
    """
    if scheduler is not None:
        with Cluster(scheduler) as executor:
            yield executor
        return
    if workers < 1:
        raise BatchError(f'--workers {workers}: at least one is needed')
    yield Processes(workers)


def end_with_parent() -> None:
    """Let this process end when the one that started it is killed; else it would wait for ever."""
    def wait():
        multiprocessing.parent_process().join()
        os._exit(1)
    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _deaf_to_interrupts():
    """Let processes that are started meanwhile see no Ctrl-C: the one that waits ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Processes:
    """An Executor over processes of this machine."""

    def __init__(self, workers):
        self._workers = workers

    def finished(self, function, items) -> Iterator:
        """Yield index and result of each item; what a killed process leaves is done again."""
        waiting, breaks = list(range(len(items))), 0
        while waiting:
            left = []
            for index, future in self._round(function, items, waiting):
                if isinstance(future.exception(), BrokenProcessPool):
                    left.append(index)
                else:
                    yield index, future.result
            breaks = breaks + 1 if len(left) == len(waiting) else 0
            waiting = sorted(left)
            if breaks == _MOST_BREAKS:
                # a pool hands out one more than it has workers: one of the first it is
                first = 2 * self._workers + 1
                suspects, waiting, breaks = waiting[:first], waiting[first:], 0
                for index in suspects:
                    for _, future in self._round(function, items, [index]):
                        broken = isinstance(future.exception(), BrokenProcessPool)
                        yield index, _lost if broken else future.result

    def _round(self, function, items, waiting):
        """Yield (index, future) of the items ``waiting``, in one pool."""
        others = set(multiprocessing.active_children())  # of whoever calls
        pool = ProcessPoolExecutor(min(self._workers, len(waiting)), initializer=end_with_parent,
                                   mp_context=multiprocessing.get_context('spawn'))
        try:
            futures = {}
            for index in waiting:
                try:
                    with _deaf_to_interrupts():
                        future = pool.submit(function, items[index])
                except BrokenProcessPool as error:  # died while items are still being handed in
                    future = Future()
                    future.set_exception(error)
                futures[future] = index
            for future in as_completed(futures):
                yield futures[future], future
        except BaseException:  # interrupted, or nobody wants more: items take up to minutes
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _lost():
    raise LostItemError(f'a worker process was killed {_MOST_BREAKS + 1} times by one item, the '
                        'last time alone; is there enough memory? Ask for fewer --workers')


def call_packed(item, function) -> object:
    """Return what ``function`` returns for a pickled item."""
    return function(pickle.loads(item))


class Cluster:
    """
    An Executor over the workers of the Dask scheduler at an address.

    BatchError is raised if Dask is not installed, or the scheduler does not answer, has no
    workers, or one of them runs other sources of this package.
    """

    def __init__(self, address):
        try:
            from distributed import Client
        except ImportError as error:
            raise BatchError(MISSING) from error
        self._address = address
        try:
            self._client = Client(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise BatchError(f'--scheduler {address}: does not answer ({error}); start it with '
                             'dask scheduler, or leave the option out') from error
        try:
            self._require_workers()
        except BaseException:
            self._client.close()
            raise

    def __enter__(self):
        """Return the executor itself."""
        return self

    def __exit__(self, *_):
        """Leave the cluster; what it was still doing for this run is given up."""
        self._client.close()

    def _require_workers(self):
        try:
            found = self._client.run(fingerprint)
        except ModuleNotFoundError as error:
            raise BatchError(f'--scheduler {self._address}: its workers lack {error.name}; '
                             'install this package where they run') from error
        if not found:
            raise BatchError(f'--scheduler {self._address}: has no workers; start some with '
                             f'dask worker {self._address}')
        own = fingerprint()
        for worker, sources in found.items():
            if sources != own:
                raise BatchError(f'--scheduler {self._address}: worker {worker} runs other '
                                 'sources of this package; install the same version there and '
                                 'start it anew')

    def finished(self, function, items) -> Iterator:
        """Yield index and result of each item; the scheduler repeats what a dead worker had."""
        from distributed import as_completed, KilledWorker

        # every item is a task of its own, even where another run asked for an equal one; packed,
        # because Dask looks through tuples and lists for tasks, at many times the cost
        futures = self._client.map(call_packed, [pickle.dumps(item) for item in items],
                                   function=function, pure=False)
        places = {future.key: index for index, future in enumerate(futures)}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                if future.cancelled():
                    raise CancelledError
                killed = isinstance(future.exception(), KilledWorker)
                yield places[future.key], self._lost if killed else future.result
        except (CancelledError, OSError) as error:
            raise BatchError(f'--scheduler {self._address}: the connection was lost; what is '
                             'finished is kept, start again to go on') from error

    def _lost(self):
        raise LostItemError(f'--scheduler {self._address}: one item killed every worker that took '
                            'it; is there enough memory?')
