# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""From a robot's names, units and clocks to joint angles, torques and one time, and back."""

from dataclasses import dataclass
import math

from gms_flex_control.errors import GmsFlexError, ParameterError
import numpy as np

NANOSECONDS = 1_000_000_000
TOLERANCE = 20_000_000   # a stamp that far from its arrival is of another clock [ns]
_WAITED = 100_000_000    # a sample that had to wait comes so late at most [ns]
_BACKLOG = 200_000_000   # and after so long one is in time again [ns]
_CALM = 5_000_000        # nothing is corrected within that [ns]
_SLEW = 1e-3             # how fast a drifting clock is followed, beyond any quartz
LARGEST = 1e5            # no joint angle or velocity is beyond [rad, rad/s]
_MOST_NAMES = 1000
_LONGEST_STEP = 0.5      # after such a gap the velocity estimate begins anew [s]


class ReadingError(GmsFlexError):
    """A message that is not acted on; the sentence says why."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One encoder: angle of the joint = sign * reading / ratio + offset."""

    name: str             # in the robot's joint states
    sign: float = 1.0     # 1 if the reading grows with the joint angle, -1 if it falls
    ratio: float = 1.0    # turns of the encoder per turn of the joint; 1 if divided already
    offset: float = 0.0   # joint angle where the encoder reads 0 [rad]

    def __post_init__(self):
        if self.sign not in (-1.0, 1.0):
            raise ParameterError(f'{self.name}: sign must be 1 or -1, got {self.sign:g}')
        if not self.ratio > 0.0:
            raise ParameterError(f'{self.name}: ratio must be above 0, got {self.ratio:g}; '
                                 'a reversed encoder has sign -1')


@dataclass(frozen=True, kw_only=True)
class Actuation:
    """One actuator: torque at the joint = sign * torque_constant * gear * effort."""

    name: str                     # in the robot's joint states and commands
    sign: float = 1.0             # 1 if positive effort drives the joint forward, else -1
    torque_constant: float = 1.0  # torque at the motor shaft per unit of effort [N m]
    gear: float = 1.0             # torque at the joint per torque that the effort stands for

    def __post_init__(self):
        if self.sign not in (-1.0, 1.0):
            raise ParameterError(f'{self.name}: sign must be 1 or -1, got {self.sign:g}')
        for name in ('torque_constant', 'gear'):
            if not getattr(self, name) > 0.0:
                raise ParameterError(f'{self.name}: {name} must be above 0, '
                                     f'got {getattr(self, name):g}')


class JointMap:
    """
    Mapping of a whole robot.

    ``links`` and ``motors`` are Readings, None for the motor of a rigid joint; ``actuators`` are
    Actuations; ``order`` names the joints as the robot takes its efforts, empty for ``joints``.
    Raises ParameterError if names repeat or ``order`` is no order of the joints.
    """

    def __init__(self, joints, links, motors, actuators, order=()):
        self.joints = tuple(joints)
        order = tuple(order) or self.joints
        if sorted(order) != sorted(self.joints):
            raise ParameterError(f'the order of the commands {list(order)} must name each of '
                                 f'{list(self.joints)} once')
        self._order = np.array([self.joints.index(name) for name in order])
        readings = [*links, *(motor for motor in motors if motor is not None)]
        self.names = tuple(reading.name for reading in readings)
        for what, where, called in (
                ('encoders', 'in the joint states', self.names),
                ('actuators', 'in the commands', tuple(a.name for a in actuators))):
            twice = [name for name in called if called.count(name) > 1]
            if twice:
                raise ParameterError(f'two {what} are both called {twice[0]!r} {where}')
        self._sign_over_ratio = np.array([r.sign / r.ratio for r in readings])
        self._offset = np.array([r.offset for r in readings])
        n, flexible = len(self.joints), [motor is not None for motor in motors]
        self._motor_channel = np.arange(n)
        self._motor_channel[flexible] = n + np.arange(sum(flexible))
        self._scale = np.array([a.sign * a.torque_constant * a.gear for a in actuators])
        self.command_names = tuple(actuators[j].name for j in self._order)
        # some robots tell an effort under a name that no encoder has
        self.effort_names = tuple(dict.fromkeys([*self.names, *(a.name for a in actuators)]))
        self._effort_channel = [self.effort_names.index(a.name) for a in actuators]

    def angle(self, reading, channel):
        """Return joint angles [rad] of ``reading`` (k,) of the encoders ``channel`` (k,)."""
        return reading * self._sign_over_ratio[channel] + self._offset[channel]

    def rate(self, reading, channel):
        """Return joint velocities [rad/s] of what the encoders ``channel`` (k,) report."""
        return reading * self._sign_over_ratio[channel]

    def sides(self, values):
        """Return values of link and motor side (n_joints,) from those of all encoders."""
        return values[:len(self.joints)], values[self._motor_channel]

    def efforts(self, torque):
        """Return efforts in the robot's units and order from torques (n_joints,) [N m]."""
        return (torque / self._scale)[self._order] + 0.0  # never -0

    def torques(self, efforts, otherwise):
        """
        Turn efforts by `effort_names`, NaN where unknown, into torques of the joints [N m].

        ``otherwise`` (n_joints,) stands in where the robot measures none.
        """
        torque = efforts[self._effort_channel] * self._scale
        return np.where(np.isfinite(torque), torque, otherwise)


class Timeline:
    """
    Map stamps to a time that never jumps and never runs backwards.

    A stamp near the time of arrival is taken as it is, so that recordings of robot and bridge
    agree. One of another clock is shifted by a constant, which follows slow drift and is chosen
    anew when that clock jumps. Samples that come late because they had to wait are no jump: the
    next ones are in time again. A source without stamps has the time of arrival.
    """

    def __init__(self):
        self._stamp = self._offset = self._last = None
        self._arrival = 0
        self._in_time = None       # when a sample last came as its stamp has it
        self.jumps = 0             # of the clock of the source

    def read(self, stamp, now):
        """
        Return the time of a sample [ns], above all before; None if it is no new one.

        ``stamp`` is as sent [ns], 0 if the source has no clock; ``now`` when it arrived, by a
        steady clock. A repeated stamp is no new sample, nor is one that was overtaken.
        """
        if stamp == 0:
            return self._keep(now, now)
        if stamp == self._stamp:
            return None
        if self._offset is None or self._is_of_another_clock(stamp, now):
            self.jumps += self._offset is not None
            self._offset = 0 if abs(stamp - now) <= TOLERANCE else now - stamp
        if abs(stamp + self._offset - now) <= TOLERANCE:
            self._in_time = now
        self._stamp = stamp
        self._follow(stamp, now)
        return self._keep(stamp + self._offset, now)

    def _is_of_another_clock(self, stamp, now):
        late = now - stamp - self._offset
        if abs(late) <= TOLERANCE:
            return False
        waited = 0 < late <= _WAITED and stamp > self._stamp
        return not waited or now - self._in_time > _BACKLOG

    def _follow(self, stamp, now):
        behind = now - stamp - self._offset
        if abs(behind) > _CALM and self._last is not None:
            most = round(_SLEW * (now - self._arrival))
            self._offset += max(-most, min(most, behind))

    def _keep(self, time, now):
        self._arrival = now
        if self._last is not None and time <= self._last:
            return None
        self._last = time
        return time


class StateMerger:
    """
    Joint states of one or several sources as angles, velocities and efforts of one time.

    ``cutoff`` [Hz] is of the low-pass of velocities that are estimated where none is sent;
    readings further apart than ``skew`` [s] make no state. ``sources`` are names for messages.
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
        self.position, self.velocity = np.zeros(m), np.zeros(m)  # of the joints [rad, rad/s]
        # by the map's effort_names, in the robot's units; NaN where unknown
        self.effort = np.full(len(joint_map.effort_names), np.nan)
        self.time, self.estimated = 0, 0   # of the state [ns]; readings without a velocity

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
        Take one message of one source; return whether there is a new state.

        It is one once every encoder has been heard of since the last, all within ``skew``; older
        readings are moved to the time of the newest with their velocity. ``velocity`` and
        ``effort`` may be empty, ``stamp`` and ``now`` are as of `Timeline.read`. Raises
        ReadingError, with nothing changed, if lengths, numbers or names make no sense.
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
