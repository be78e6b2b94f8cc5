# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the real-time loop did: when each state left, when its command came, how many too late."""

import json
import time

from gms_flex_control.files import write_text
import numpy as np

NOTABLE = 0.1    # share of late samples from which on the arm is not what its gains make of it
LATE = ('the controller is late, and the arm does not move as its gains would have it; run fewer '
        'programs, set realtime_priority, lower the rate')
_WINDOW = 1.0    # over which that is counted [s]
_LONGEST = 3600  # seconds kept; later samples are not measured


class LoopTiming:
    """
    Times of the samples of one run, on the monotonic clock.

    Parameters
    ----------
    path : str
        JSON file for the result; '' measures nothing.
    period : int
        Nominal sample [ns].
    duration : int or None
        Of the run [ns]; None if it has no end.

    """

    def __init__(self, path, period, duration):
        self._path, self._period = path, period
        samples = round((duration or _LONGEST * 1_000_000_000) / period) + 2 if path else 0
        self._published = np.zeros(samples, dtype=np.int64)
        self._answered = np.zeros(samples, dtype=np.int64)
        self._count = 0

    def published(self):
        """Note that the next state leaves now."""
        if self._count < len(self._published):
            self._published[self._count] = time.monotonic_ns()
            self._count += 1

    def answered(self, sample, arrived):
        """Note that the command for state number ``sample`` came at ``arrived`` [ns]."""
        if 0 <= sample < self._count and self._answered[sample] == 0:
            self._answered[sample] = arrived

    def save(self):
        """
        Write the figures to the file, if one was named.

        A sample counts as answered in time if its command came before the next state left.
        """
        if not self._path or self._count < 3:
            return
        sent, came = self._published[:self._count], self._answered[:self._count]
        next_sent, sent_before = sent[1:], sent[:-1]
        came = came[:-1]
        in_time = (came > 0) & (came <= next_sent)
        trips = (came - sent_before)[came > 0] / 1e3
        interval_error = np.abs(np.diff(sent) - self._period) / 1e3
        result = {
            'samples': int(len(came)), 'rate': float(1e9 / np.mean(np.diff(sent))),
            'answered_in_time': float(np.mean(in_time)), 'lost': int(np.sum(came == 0)),
            'round_trip_median_us': float(np.median(trips)) if len(trips) else None,
            'round_trip_p99_us': float(np.percentile(trips, 99)) if len(trips) else None,
            'interval_error_p99_us': float(np.percentile(interval_error, 99))}
        write_text(self._path, json.dumps(result, indent=2) + '\n')


class LateSamples:
    """
    How many of the last second's samples had no command of their own.

    Parameters
    ----------
    period : int
        Nominal sample [ns].

    """

    def __init__(self, period):
        self._window = max(10, round(_WINDOW * 1e9 / period))
        self.restart()

    def restart(self):
        """Begin a second anew, as where no command is to be expected."""
        self._count = self._late = 0

    def add(self, late):
        """
        Count a sample.

        Parameters
        ----------
        late : bool
            Whether its command had not come when it ended.

        Returns
        -------
        str
            A sentence once a second is over in which too many were late; else ''.

        """
        self._count += 1
        self._late += late
        if self._count < self._window:
            return ''
        share, count = self._late / self._count, self._count
        self.restart()
        if share <= NOTABLE:
            return ''
        return (f'{100.0 * share:.0f} % of the last {count} samples had no fresh command: '
                f'{LATE}, or simulate with mode:=lockstep')
