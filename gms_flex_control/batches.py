# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A function called for many items, in processes of this machine."""

from collections.abc import Callable
from concurrent.futures import as_completed, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
import os
import signal
import sys
import threading
from time import monotonic

from gms_flex_control.errors import BatchError

_WIDTH = 30  # of the progress bar, in characters


def run_batch(function: Callable, items: dict, workers: int = 2, label: str = '',
              keep: Callable = lambda key, value: None) -> dict:
    """
    Return what ``function``, of a module, makes of many items by their keys, in their order.

    ``label`` is that of the progress bar, which appears on a terminal only; ``keep(key, value)``
    is called as each item is finished. What an item raises comes through. BatchError is raised
    without workers, or where one of them is killed.
    """
    if workers < 1:
        raise BatchError(f'--workers {workers}: at least one is needed')
    if not items:
        return {}
    found, others = {}, set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(min(workers, len(items)), initializer=_end_with_parent,
                               mp_context=multiprocessing.get_context('spawn'))
    try:
        with _deaf_to_interrupts():
            futures = {pool.submit(function, item): key for key, item in items.items()}
        with Progress(len(items), label) as progress:
            for future in as_completed(futures):
                key = futures[future]
                found[key] = future.result()
                keep(key, found[key])
                progress.step()
    except BrokenProcessPool as error:
        raise BatchError('a worker process was killed; is there enough memory? Ask for fewer '
                         '--workers') from error
    except BaseException:  # interrupted, or nobody wants more: items take up to minutes
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
    return {key: found[key] for key in items}


def _end_with_parent():
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


class Progress:
    """A bar of one line with count and time left, drawn where ``stream`` is a terminal."""

    def __init__(self, total, label='', stream=None):
        self._total, self._done, self._label = total, 0, label
        self._stream = sys.stderr if stream is None else stream
        self._begin, self._last = monotonic(), 0.0

    def __enter__(self):
        """Draw the bar for the first time."""
        self._draw()
        return self

    def __exit__(self, *_):
        """Remove the bar."""
        self._write('\r\x1b[K')

    def step(self) -> None:
        """Count one more finished item."""
        self._done += 1
        if self._done == self._total or monotonic() - self._last >= 0.1:
            self._draw()

    def _draw(self):
        self._last = monotonic()
        full = int(_WIDTH * self._done / self._total)
        left = ''
        if self._done:
            seconds = (self._last - self._begin) / self._done * (self._total - self._done)
            left = f', {seconds:.0f} s left'
        self._write(f'\r\x1b[K{self._label} [{"#" * full}{"-" * (_WIDTH - full)}] '
                    f'{self._done}/{self._total}{left}')

    def _write(self, text):
        if self._stream.isatty():
            self._stream.write(text)
            self._stream.flush()
