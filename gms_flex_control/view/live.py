# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A running loop: its messages as rows by the stamp of their joint state, and its status."""

from collections import deque
import threading

from gms_flex_control.data.series import carried_on, N_DERIVATIVES
from gms_flex_control.hardware.supervision import BRIDGED, SIMULATED
from gms_flex_control.view.recorded import column_names, PER_JOINT
import numpy as np

WAIT = 0.08          # a row waits so long for what belongs to it [s]
KEPT = 15_000        # rows that a page which opens late still gets
SPACING = 4_000_000  # of rows: what lies between is left out, nobody would see it [ns]
WINDOW = 3.0         # of counting late samples [s]
SILENCE = 3.5        # of the reports, upon which the state is not known [s]
_REACH = 20_000_000    # a reference further away is not used [ns]
_JUMP = 1_000_000_000  # stamps that go back or ahead by more are another run [ns]


class JointStateTable:
    """The rows of a table, one per joint state, ``spacing`` [ns] apart, filled by messages."""

    def __init__(self, n, blocks, spacing=1):
        self.names = column_names(n, blocks)
        self._n, self._blocks, self._spacing = n, blocks, spacing
        self._place = {'block': 1 + len(PER_JOINT) * n}
        self._place |= {signal: 1 + PER_JOINT.index(signal) * n for signal in PER_JOINT}
        self._place['stick'] = self._place['block'] + n * blocks
        self._waiting = {}  # stamp [ns]: (when it came [s], row)
        self._references = deque(maxlen=64)  # stamp, angles of those that came ahead
        self._newest = self._origin = None
        self.restarted = False

    def put_state(self, stamp, now, link, motor) -> None:
        """Begin a row: stamp [ns], monotonic time [s], angles of link and motor [rad] or NaN."""
        if not self.wants(stamp):
            return
        if self._newest is not None and abs(stamp - self._newest) > _JUMP:
            self._waiting.clear()
            self._origin, self.restarted = None, True
        if self._origin is None:
            self._origin = stamp
        self._newest = stamp
        row = np.full(len(self.names), np.nan)
        row[0] = (stamp - self._origin) * 1e-9
        self._write(row, 'link', link)
        self._write(row, 'motor', motor)
        if len(self._waiting) < 2000:
            self._waiting[stamp] = now, row

    def wants(self, stamp) -> bool:
        """Return whether a joint state of a stamp [ns] begins a row: none again or between."""
        if self._newest is None:
            return True
        ahead = stamp - self._newest
        return ahead >= self._spacing or ahead < -_JUMP

    def wants_more(self, signal, stamp) -> bool:
        """Return whether values of a signal, of a stamp [ns] or None, may belong to a row."""
        if stamp is None:
            return True
        if signal != 'reference':
            return stamp in self._waiting
        last = self._references[-1][0] if self._references else None
        return last is None or not 0 <= stamp - last < self._spacing

    def put(self, signal, stamp, values) -> None:
        """Add a signal's values to the row of a stamp [ns], of the newest if it is None."""
        stamp = self._newest if stamp is None else stamp
        if signal == 'reference' and stamp is not None:  # stamped ahead of the state it is for
            self._references.append((stamp, list(values)))
        elif stamp in self._waiting:
            self._write(self._waiting[stamp][1], signal, values)

    def _write(self, row, signal, values):
        room = self._n * (self._blocks if signal in ('block', 'stick') else 1)
        if len(values) == room:
            start = self._place[signal]
            row[start:start + room] = values

    def take(self, now) -> np.ndarray:
        """Return the rows that have waited long enough, shape (rows, columns)."""
        ready = []
        for stamp, (came, row) in list(self._waiting.items()):
            if now - came < WAIT:
                break
            self._add_reference(stamp, row)
            ready.append(row)
            del self._waiting[stamp]
        if not ready:
            return np.empty((0, len(self.names)))
        table = np.stack(ready)
        link, motor, reference, error, torsion = (
            table[:, self._place[name]:self._place[name] + self._n]
            for name in ('link', 'motor', 'reference', 'error', 'torsion'))
        torsion[:] = motor - link
        error[:] = np.where(np.isfinite(error), error, link - reference)
        reference[:] = link - error
        return table

    def _add_reference(self, stamp, row):
        """Write the nearest reference, carried on by its own derivatives."""
        label, values = min(self._references, default=(None, ()), key=lambda item: abs(
            item[0] - stamp))
        count = min(len(values) // self._n, N_DERIVATIVES)
        if label is None or abs(label - stamp) > _REACH or not count:
            return
        rows = np.reshape(values[:count * self._n], (1, count, self._n))
        shift = np.array([stamp - label]) * 1e-9
        self._write(row, 'reference', carried_on(rows, shift)[0, 0])


class Feed:
    """Rows for any number of pages, each at its own pace: threads wait for what is new."""

    def __init__(self):
        self._condition = threading.Condition()
        self._rows, self._count = deque(maxlen=KEPT), 0
        self.version, self._state = 0, None

    def begin_anew(self) -> None:
        """Forget all rows: names or meaning of the columns have changed."""
        with self._condition:
            self._rows.clear()
            self.version += 1
            self._condition.notify_all()

    def add(self, rows, state) -> None:
        """Add rows (T, columns), and say how the loop is, as a dict for JSON."""
        with self._condition:
            changed = state != self._state
            self._rows.extend(rows)
            self._count += len(rows)
            self._state = state
            if changed or len(rows):
                self._condition.notify_all()

    def since(self, number, wait) -> tuple:
        """
        Return the rows behind a number (0 for all), as soon as there are any, within ``wait`` [s].

        The number for the next call, the version (grows when the columns change), the state as a
        dict and the rows (T, columns).
        """
        with self._condition:
            version, state = self.version, self._state
            self._condition.wait_for(lambda: self._count > number or self.version != version
                                     or self._state != state, wait)
            fresh = min(self._count - number, len(self._rows))
            skipped = len(self._rows) - fresh
            taken = min(fresh, 4000)  # in one event
            rows = [self._rows[k] for k in range(skipped, skipped + taken)]
            number = self._count - fresh + taken
            return number, self.version, self._state, np.array(rows)


class Status:
    """State, rate and late share of the robot, from its reports."""

    def __init__(self):
        self._said, self._heard = {}, None
        self._counts = deque()  # time [s], samples, late ones, those left out

    def report(self, values, time, now) -> None:
        """Take the values (dict of str) of a DiagnosticStatus stamped ``time``, ``now`` [s]."""
        self._said, self._heard = values, now
        for samples, *others in (SIMULATED, BRIDGED):
            numbers = values.get(samples, ''), *(values.get(name, '0') for name in others)
            if all(map(str.isdecimal, numbers)):
                self._count(time, *map(int, numbers))

    def _count(self, time, samples, *others):
        if self._counts and (time <= self._counts[-1][0] or samples < self._counts[-1][1]):
            self._counts.clear()  # another run
        self._counts.append((time, samples, *others))
        while len(self._counts) > 2 and time - self._counts[1][0] >= WINDOW:
            self._counts.popleft()

    def as_dict(self, now) -> dict | None:
        """
        Return what is known now, for JSON; None where no robot reports.

        ``state`` and ``reason`` (str), ``rate`` of the samples [Hz] and ``late``, the share of
        those that should have been without a command in time (None until they are known).
        """
        if self._heard is None or now - self._heard > SILENCE:
            return None
        elapsed, samples, late, left_out = (
            np.subtract(self._counts[-1], self._counts[0]).tolist() if self._counts else (0,) * 4)
        known = samples > 0
        return {'state': self._said.get('state', ''), 'reason': self._said.get('reason', ''),
                'rate': round(samples / elapsed, 1) if known else None,
                'late': round((late + left_out) / (samples + left_out), 5) if known else None}
