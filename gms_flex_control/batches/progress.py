# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A progress bar on a terminal, and nothing anywhere else."""

import sys
from time import monotonic

_WIDTH, _LEAST_GAP = 30, 0.1  # characters; seconds between two drawings


class Progress:
    """
    A bar of one line with count and time left.

    Parameters
    ----------
    total : int
        Items altogether.
    done : int
        Of these, finished before.
    label : str
        What they are.
    stream : file, optional
        Default standard error.

    """

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

    def step(self):
        """Count one more finished item."""
        self._done += 1
        if self._done == self._total or monotonic() - self._last >= _LEAST_GAP:
            self._draw()

    def _draw(self):
        if not self._shown:
            return
        self._last = monotonic()
        self._stream.write(f'\r\x1b[K{self.line(self._last - self._begin)}')
        self._stream.flush()

    def line(self, elapsed):
        """Return the bar as text after ``elapsed`` seconds."""
        share = self._done / self._total if self._total else 1.0
        full = int(_WIDTH * share)
        left = ''
        if self._done > self._first:
            rate = elapsed / (self._done - self._first)
            left = f', {rate * (self._total - self._done):.0f} s left'
        return (f'{self._label} [{"#" * full}{"-" * (_WIDTH - full)}] '
                f'{self._done}/{self._total}{left}')
