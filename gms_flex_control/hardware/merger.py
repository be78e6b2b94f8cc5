# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Several sources of joint states become one, by name and by time."""

import math

from gms_flex_control.errors import GmsFlexError
from gms_flex_control.hardware.timeline import Timeline
import numpy as np

NANOSECONDS = 1_000_000_000
LARGEST = 1e5             # no joint angle or velocity is beyond [rad, rad/s]
_MOST_NAMES = 1000
_LONGEST_STEP = 0.5       # after such a gap the velocity estimate begins anew [s]


class ReadingError(GmsFlexError):
    """A message that is not acted on; the sentence says why."""


class StateMerger:
    """
    Joint states of one or several sources as angles, velocities and efforts of one time.

    Parameters
    ----------
    joint_map : JointMap
        Names and units.
    sources : sequence of str
        Names of the sources, for messages.
    cutoff : float
        Low-pass of the velocity that is estimated where none is sent [Hz].
    skew : float
        Readings further apart than this make no state [s].

    Attributes
    ----------
    position, velocity : ndarray, shape (n_encoders,)
        Of the joints [rad, rad/s].
    effort : ndarray, shape (n_names,)
        By the map's ``effort_names``, in the robot's units; NaN where unknown.
    time : int
        Of the state [ns].
    estimated : int
        How many readings came without a velocity.

    """

    def __init__(self, joint_map, sources, *, cutoff, skew):
        self._map, self._sources = joint_map, tuple(sources)
        self._cutoff, self._skew = cutoff, skew * NANOSECONDS
        m = len(joint_map.names)
        self._timelines = [Timeline() for _ in self._sources]
        self._plans = [None] * len(self._sources)
        self._owner = [None] * m
        self._q, self._dq = np.zeros(m), np.zeros(m)
        self._times = np.full(m, -1, dtype=np.int64)
        self._fresh = np.zeros(m, dtype=bool)
        self.position, self.velocity = np.zeros(m), np.zeros(m)
        self.effort = np.full(len(joint_map.effort_names), np.nan)
        self.time, self.estimated = 0, 0

    @property
    def jumps(self):
        """Return how often the clock of any source jumped."""
        return sum(timeline.jumps for timeline in self._timelines)

    def absent(self):
        """Return the names of encoders that nothing has been heard of since the last state."""
        return [name for name, fresh in zip(self._map.names, self._fresh, strict=True)
                if not fresh]

    def take(self, source, names, position, velocity, effort, stamp, now):
        """
        Take one message of one source.

        Parameters
        ----------
        source : int
            Which one.
        names : sequence of str
            In any order, others among them.
        position, velocity, effort : sequence of float
            As long as ``names``; the last two may be empty.
        stamp, now : int
            As of `Timeline.read` [ns].

        Returns
        -------
        bool
            Whether ``position``, ``velocity``, ``effort`` and ``time`` are a new state: every
            encoder has been heard of since the last, all within ``skew``. Older readings are
            moved to the time of the newest with their velocity.

        Raises
        ------
        ReadingError
            If lengths or numbers make no sense or a name comes twice; nothing has changed then.

        """
        plan = self._plan(source, names)
        _, index, channel, told = plan
        q, dq, torque = self._values(names, (position, velocity, effort), index, channel)
        self._keep(source, plan)
        time = self._timelines[source].read(stamp, now)
        if time is None:
            return False
        if not self._fresh.any():  # a new state begins
            self.effort[len(self._map.names):] = np.nan
        self._move(channel, q, dq, time)
        self.effort[channel] = torque
        for c, k in told if len(effort) else ():
            self.effort[c] = effort[k]
        self._fresh[channel] = True
        newest = int(self._times.max())
        if not self._fresh.all() or newest - int(self._times.min()) > self._skew:
            return False
        self._fresh[:] = False
        self.time = newest
        age = (self.time - self._times) / NANOSECONDS
        self.position[:] = self._q + self._dq * age
        self.velocity[:] = self._dq
        return True

    def _plan(self, source, names):
        plan = self._plans[source]
        if plan is None or plan[0] != names:
            plan = list(names), *self._make_plan(source, names)
        return plan

    def _keep(self, source, plan):
        if plan is not self._plans[source]:
            self._plans[source] = plan
            for c in plan[2]:
                self._owner[c] = source

    def _make_plan(self, source, names):
        place = self._sources[source]
        if len(names) > _MOST_NAMES:
            raise ReadingError(f'{place} has {len(names)} names, more than any robot')
        wanted = [name for name in self._map.names if name in names]
        for name in wanted:
            if names.count(name) > 1:
                raise ReadingError(f'{place} names {name!r} more than once')
        if not wanted:
            raise ReadingError(f"{place} has none of {', '.join(self._map.names)} (it has "
                               f"{', '.join(names[:8]) or 'nothing'}); check mapping.<joint>")
        channel = [self._map.names.index(name) for name in wanted]
        for name, c in zip(wanted, channel, strict=True):
            if self._owner[c] not in (None, source):
                raise ReadingError(f'{name!r} comes from {self._sources[self._owner[c]]} and from '
                                   f'{place}; leave it out of one, or one out of '
                                   'bridge.state_topics')
        told = [(c, names.index(name)) for c, name in enumerate(self._map.effort_names)
                if c >= len(self._map.names) and name in names]
        return [names.index(name) for name in wanted], np.array(channel), told

    def _values(self, names, fields, index, channel):
        """Return joint angle, velocity (NaN: none) and raw effort of the encoders ``channel``."""
        columns = []
        for what, values in zip(('positions', 'velocities', 'efforts'), fields, strict=True):
            if len(values) != len(names) and (len(values) or what == 'positions'):
                raise ReadingError(f'joint states have {len(names)} names and {len(values)} '
                                   f'{what}')
            columns.append(np.array([values[i] for i in index]) if len(values)
                           else np.full(len(index), np.nan))
        q = self._map.angle(columns[0], channel)
        dq = self._map.rate(columns[1], channel)
        bad = ~(np.abs(q) <= LARGEST) | (np.abs(dq) > LARGEST)
        if bad.any():
            k = int(np.argmax(bad))
            raise ReadingError(f'joint states have position {columns[0][k]:g} and velocity '
                               f'{columns[1][k]:g} for {self._map.names[channel[k]]!r}')
        return q, dq, columns[2]

    def _move(self, channel, q, dq, time):
        """Take the angles ``q``; estimate the velocities that are NaN."""
        unknown = np.isnan(dq)
        if unknown.any():
            elapsed = (time - self._times[channel]) / NANOSECONDS
            known = (self._times[channel] >= 0) & (elapsed > 0.0) & (elapsed < _LONGEST_STEP)
            elapsed = np.where(known, elapsed, 1.0)
            gain = 1.0 - np.exp(-2.0 * math.pi * self._cutoff * elapsed)
            before = self._dq[channel]
            estimate = before + gain * ((q - self._q[channel]) / elapsed - before)
            dq = np.where(unknown, np.where(known, estimate, 0.0), dq)
            self.estimated += int(unknown.sum())
        self._q[channel], self._dq[channel], self._times[channel] = q, dq, time
