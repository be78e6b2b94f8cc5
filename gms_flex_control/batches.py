# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A function called for many items, in processes or on a Dask cluster, with a journal."""

from collections.abc import Generator, Iterator
from concurrent.futures import as_completed, CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import hashlib
import json
import multiprocessing
import os
from pathlib import Path
import pickle
import signal
import sys
import threading
from time import monotonic
from typing import Protocol

import gms_flex_control
from gms_flex_control.errors import BatchError, ConfigError, LostItemError

ROOT = Path(gms_flex_control.__file__).parent


class Journal:
    """
    The outcomes so far, in ``folder`` / outcomes.jsonl; the folder is made if need be.

    Outcomes of other ``sources``, a hash of all they depend on beside their key, are not taken.
    ConfigError is raised if the folder cannot be written.
    """

    def __init__(self, folder, sources):
        self.path, self._sources = Path(folder) / 'outcomes.jsonl', sources
        self.outcomes, self.stale = {}, 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            lines = self.path.read_text('utf-8').splitlines() if self.path.exists() else []
        except OSError as error:
            raise ConfigError(f'--out {folder}: {error.strerror}; name a folder that can be '
                              'written') from error
        for line in lines:
            self._take(line)

    def _take(self, line):
        try:
            outcome = json.loads(line)
            key, sources = outcome['key'], outcome['sources']
        except (ValueError, KeyError, TypeError):
            return  # the line a killed run did not finish
        if sources != self._sources:
            self.stale += 1
            return
        self.outcomes[key] = outcome

    def add(self, outcome) -> None:
        """Keep an outcome (dict with 'key'), on disk at once."""
        outcome = outcome | {'sources': self._sources}
        self.outcomes[outcome['key']] = outcome
        text = json.dumps(outcome, allow_nan=False) + '\n'
        with self.path.open('ab+') as file:
            if file.tell():
                file.seek(-1, 2)
                text = text if file.read(1) == b'\n' else '\n' + text
            file.write(text.encode())


def fingerprint(parts=('.',), root: Path = ROOT) -> str:
    """Return a hash (16 digits) of folders or modules within ``root``, by default all."""
    digest = hashlib.sha256()
    for part in parts:
        path = root / part
        for source in [path] if path.is_file() else sorted(path.rglob('*.py')):
            digest.update(source.relative_to(root).as_posix().encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def content_of(bag) -> list:
    """Return names, sizes and times of a bag's files: another recording is not taken for it."""
    path = Path(bag)
    files = [path] if path.is_file() else sorted(one for one in path.rglob('*') if one.is_file())
    return [(one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in files]


def digest_of(values) -> str:
    """Return 16 hexadecimal digits that stand for plain values, distinguished by their repr."""
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]


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


_WIDTH = 30  # characters


def run_batch(function, items: dict, *, executor: Executor, journal: Journal | None = None,
              label: str = '', lost=None) -> dict:
    """
    Return what a function makes of many items by their keys, in the order of the items.

    All of it goes through JSON, so that it is the same whether it was kept or just found:
    ``function``, of a module, takes one of ``items`` and returns plain values without NaN. Items
    that the Journal has are not done again; what is finished stays in it whatever ends the batch.
    ``label`` is that of the progress bar, which appears on a terminal only. ``lost`` makes of a
    LostItemError what stands for an item that kills its workers; that is not kept, so that the
    item is tried again another time. By default the error ends the batch.
    """
    kept = {} if journal is None else journal.outcomes
    found = {key: kept[key]['value'] for key in items if key in kept}
    missing = [key for key in items if key not in found]
    with Progress(len(items), len(found), label) as progress:
        for index, result in executor.finished(function, [items[key] for key in missing]):
            key = missing[index]
            try:
                found[key] = json.loads(json.dumps(result(), allow_nan=False))
            except LostItemError as error:
                if lost is None:
                    raise
                found[key] = lost(error)
            else:
                if journal is not None:
                    journal.add({'key': key, 'value': found[key]})
            progress.step()
    return {key: found[key] for key in items}


def run_kept(function, items: dict, args, sources: str, label: str) -> dict:
    """
    Call a function for many items as `run_batch` does, with the options of a verb.

    ``args`` has ``workers``, ``scheduler`` and ``out``, a folder whose journal keeps outcomes of
    the same ``sources``, see Journal.
    """
    journal = Journal(args.out, sources)
    with open_executor(args.workers, args.scheduler) as executor:
        return run_batch(function, items, executor=executor, journal=journal, label=label)


class Progress:
    """A bar of one line with count and time left, drawn where ``stream`` is a terminal."""

    def __init__(self, total, done=0, label='', stream=None):
        self._total, self._first, self._done, self._label = total, done, done, label
        self._stream = sys.stderr if stream is None else stream
        self._shown = self._stream.isatty()
        self._begin, self._last = monotonic(), 0.0

    def __enter__(self):
        """Draw the bar for the first time."""
        self._draw()
        return self

    def __exit__(self, *_):
        """Remove the bar."""
        if self._shown:
            self._stream.write('\r\x1b[K')
            self._stream.flush()

    def step(self) -> None:
        """Count one more finished item."""
        self._done += 1
        if self._done == self._total or monotonic() - self._last >= 0.1:
            self._draw()

    def _draw(self):
        if not self._shown:
            return
        self._last = monotonic()
        self._stream.write(f'\r\x1b[K{self.line(self._last - self._begin)}')
        self._stream.flush()

    def line(self, elapsed) -> str:
        """Return the bar as text after ``elapsed`` seconds."""
        share = self._done / self._total if self._total else 1.0
        full = int(_WIDTH * share)
        left = ''
        if self._done > self._first:
            rate = elapsed / (self._done - self._first)
            left = f', {rate * (self._total - self._done):.0f} s left'
        return (f'{self._label} [{"#" * full}{"-" * (_WIDTH - full)}] '
                f'{self._done}/{self._total}{left}')
