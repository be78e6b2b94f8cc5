# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What plant or bridge says of itself on /diagnostics, as the page of a running loop shows it."""

from collections import deque

WINDOW = 3.0    # of counting late samples [s]
SILENCE = 3.5   # of the reports, upon which the state is not known [s]
# counters of a simulated robot and of a bridge: samples, and those without a command in time
_COUNTERS = (('samples', 'samples without a fresh command'),
             ('states out', 'states without a fresh command'))


class Status:
    """State, rate and late share of the robot, from its reports."""

    def __init__(self):
        self._said, self._heard = {}, None
        self._counts = deque()  # time [s], samples, late ones

    def report(self, values, time, now):
        """
        Take a report.

        Parameters
        ----------
        values : dict of str to str
            Of its DiagnosticStatus.
        time : float
            Its stamp [s].
        now : float
            Monotonic time [s].

        """
        self._said, self._heard = values, now
        for samples, late in _COUNTERS:
            numbers = values.get(samples, ''), values.get(late, '0')
            if all(map(str.isdecimal, numbers)):
                self._count(time, *map(int, numbers))

    def _count(self, time, samples, late):
        if self._counts and (time <= self._counts[-1][0] or samples < self._counts[-1][1]):
            self._counts.clear()  # another run
        self._counts.append((time, samples, late))
        while len(self._counts) > 2 and time - self._counts[1][0] >= WINDOW:
            self._counts.popleft()

    def as_dict(self, now):
        """
        Return what is known now, for JSON; None where no robot reports.

        Returns
        -------
        dict or None
            ``state`` and ``reason`` (str), ``rate`` of the samples [Hz] and ``late``, the share of
            them without a command in time (None until they are known).

        """
        if self._heard is None or now - self._heard > SILENCE:
            return None
        (begin, first, missed), (end, last, late) = (
            (self._counts[0], self._counts[-1]) if self._counts else ((0.0, 0, 0),) * 2)
        known = last > first
        return {'state': self._said.get('state', ''), 'reason': self._said.get('reason', ''),
                'rate': round((last - first) / (end - begin), 1) if known else None,
                'late': round((late - missed) / (last - first), 5) if known else None}
