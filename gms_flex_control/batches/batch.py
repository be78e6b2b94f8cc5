# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A function called for many items elsewhere, with a journal of what is finished."""

import json
import sys
from time import monotonic

from gms_flex_control.batches.journal import Journal
from gms_flex_control.batches.workers import Executor, open_executor
from gms_flex_control.errors import LostItemError

_WIDTH = 30  # characters


def run_batch(function, items: dict, *, executor: Executor, journal: Journal | None = None,
              label: str = '', lost=None) -> dict:
    """
    Return what a function makes of many items by their keys, in the order of the items.

    All of it goes through JSON, so that it is the same whether it was kept or just found.

    Parameters
    ----------
    function : callable
        Of a module; takes one item and returns plain values without NaN.
    items : dict of str to object
        By a key of their own.
    executor : Executor
        From `workers.open_executor`.
    journal : Journal, optional
        Of finished items; these are not done again, and stay in it whatever ends the batch.
    label : str
        Of the progress bar, which appears on a terminal only.
    lost : callable, optional
        LostItemError -> what stands for an item that kills its workers; such a value is not kept,
        so that the item is tried again another time. Default: the error ends the batch.

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
