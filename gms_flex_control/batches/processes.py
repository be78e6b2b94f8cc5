# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Items in processes of this machine; one that is killed costs no finished item."""

from concurrent.futures import as_completed, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
import os
import signal
import threading

from gms_flex_control.errors import LostItemError

_MOST_BREAKS = 3  # in a row without one finished item


def end_with_parent():
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
    """
    An Executor over processes; see executor.Executor.

    Parameters
    ----------
    workers : int
        How many, at least 1.

    """

    def __init__(self, workers):
        self._workers = workers

    def finished(self, function, items):
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
            futures, lost = {}, []
            for index in waiting:
                try:
                    with _deaf_to_interrupts():
                        futures[pool.submit(function, items[index])] = index
                except BrokenProcessPool as error:  # died while items are still being handed in
                    lost.append((index, _Broken(error)))
            yield from lost
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


class _Broken:
    """A future of a pool that took no more items."""

    def __init__(self, error):
        self._error = error

    def exception(self):
        """Return why nothing came of it."""
        return self._error
