# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""From a robot's names, units and clocks to joint angles, torques and one time, and back."""

from dataclasses import dataclass
import math

from gms_flex_control.compiled import compiled
from gms_flex_control.errors import GmsFlexError, ParameterError
from gms_flex_control.params.key import number, SMALLEST
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


def _require_sign(one):
    """Raise ParameterError unless the sign of a Reading or Actuation is 1 or -1."""
    if one.sign not in (-1.0, 1.0):
        raise ParameterError(f'{one.name}: sign must be 1 or -1, got {one.sign:g}')


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One encoder: angle of the joint = sign * reading / ratio + offset."""

    name: str             # in the robot's joint states
    sign: float = number('1, or -1 if the reading falls when the joint turns forward', '', 1.0,
                         -1.0, 1.0, default=1.0)
    ratio: float = number('turns of this encoder per turn of the joint', '', 1.0, SMALLEST, 1e6,
                          default=1.0)  # 1 if divided already
    offset: float = number('joint angle where it reads 0', 'rad', 0.0, default=0.0)
    __post_init__ = _require_sign


@dataclass(frozen=True, kw_only=True)
class Actuation:
    """One actuator: torque at the joint = sign * torque_constant * gear * effort."""

    name: str                     # in the robot's joint states and commands
    sign: float = 1.0             # 1 if positive effort drives the joint forward, else -1
    torque_constant: float = 1.0  # torque at the motor shaft per unit of effort [N m]
    gear: float = 1.0             # torque at the joint per torque that the effort stands for

    __post_init__ = _require_sign


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
        places = np.array([self.joints.index(name) for name in order])
        readings = [*links, *(motor for motor in motors if motor is not None)]
        self.names = tuple(reading.name for reading in readings)
        for what, where, called in (
                ('encoders', 'in the joint states', self.names),
                ('actuators', 'in the commands', tuple(a.name for a in actuators))):
            twice = [name for name in called if called.count(name) > 1]
            if twice:
                raise ParameterError(f'two {what} are both called {twice[0]!r} {where}')
        self.slope = np.array([r.sign / r.ratio for r in readings])  # angle per reading
        self.offset = np.array([r.offset for r in readings])
        n, flexible = len(self.joints), [motor is not None for motor in motors]
        motor_channel = np.arange(n)
        motor_channel[flexible] = n + np.arange(sum(flexible))
        scale = np.array([a.sign * a.torque_constant * a.gear for a in actuators])
        self.command_names = tuple(actuators[j].name for j in places)
        # some robots report an effort under a name that no encoder has
        self.effort_names = tuple(dict.fromkeys([*self.names, *(a.name for a in actuators)]))
        effort_channel = np.array([self.effort_names.index(a.name) for a in actuators])
        # channels of motors and of actuators, scale and order of the efforts
        self.arrays = motor_channel, effort_channel, scale, places

    def efforts(self, torque) -> np.ndarray:
        """Return efforts in the robot's units and order from torques (n_joints,) [N m]."""
        *_, scale, order = self.arrays
        return (torque / scale)[order] + 0.0  # never -0


@compiled
def sort(state, efforts, otherwise, motor, actuator, scale, sides, torque) -> None:
    """
    Sort what was measured by joints: into ``sides`` (4, n_joints) and ``torque`` (n_joints,).

    ``state`` (2, m) has angles and velocities by `JointMap.names`, ``sides`` gets those of the
    links, then of the motors. ``efforts`` are by `effort_names`; where the robot measures none
    (NaN) the torque is that of ``otherwise`` (n_joints,) [N m]. See `JointMap.arrays`.
    """
    for j in range(len(torque)):
        for k in range(2):
            sides[k, j], sides[2 + k, j] = state[k, j], state[k, motor[j]]
        measured = efforts[actuator[j]] * scale[j]
        torque[j] = measured if math.isfinite(measured) else otherwise[j]


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

    def read(self, stamp, now) -> int | None:
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

    def expected(self, stamp, now) -> int:
        """Return what `read` would of a sample that is like those before it; 0 of another."""
        if (stamp in (0, self._stamp) or self._offset is None
                or abs(now - stamp - self._offset) > _CALM):
            return 0
        return stamp + self._offset if stamp + self._offset > self._last else 0

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


class _Plan:
    """Where the encoders that one source measures stand in its messages."""

    def __init__(self, place, names, joint_map):
        if len(names) > _MOST_NAMES:
            raise ReadingError(f'{place} has {len(names)} names, more than any robot')
        wanted = [name for name in joint_map.names if name in names]
        for name in wanted:
            if names.count(name) > 1:
                raise ReadingError(f'{place} names {name!r} more than once')
        if not wanted:
            raise ReadingError(f"{place} has none of {', '.join(joint_map.names)} (it has "
                               f"{', '.join(names[:8]) or 'nothing'}); check mapping.<joint>")
        self.names = list(names)
        self.channel = np.array([joint_map.names.index(name) for name in wanted])
        self.index = np.array([names.index(name) for name in wanted])
        self.slope, self.offset = joint_map.slope[self.channel], joint_map.offset[self.channel]
        # efforts under names that no encoder has: where in those by `effort_names`, and here
        self.others = np.array([
            (c, names.index(name)) for c, name in enumerate(joint_map.effort_names)
            if c >= len(joint_map.names) and name in names], dtype=int).reshape(-1, 2)
        self.nothing = np.full(len(names), np.nan)

    def numbers(self, fields) -> list:
        """Return ``fields`` of a message as arrays, NaN for an empty one; check lengths."""
        found = []
        for what, values in zip(('positions', 'velocities', 'efforts'), fields, strict=True):
            if len(values) != len(self.names) and (len(values) or what == 'positions'):
                raise ReadingError(f'joint states have {len(self.names)} names and '
                                   f'{len(values)} {what}')
            found.append(np.asarray(values, dtype=float) if len(values) else self.nothing)
        return found


class StateMerger:
    """
    Joint states of one or several sources as angles, velocities and efforts of one time.

    ``cutoff`` [Hz] is of the low-pass of velocities that are estimated where none is sent;
    readings further apart than ``skew`` [s] make no state. ``sources`` are names for messages.
    """

    def __init__(self, joint_map, sources, *, cutoff, skew):
        self._map, self._sources = joint_map, tuple(sources)
        self._cutoff, self._skew = cutoff, round(skew * NANOSECONDS)
        m = len(joint_map.names)
        self._timelines = [Timeline() for _ in self._sources]
        self._plans = [None] * len(self._sources)
        self._owner = [None] * m
        self._latest, self._times = np.zeros((2, m)), np.full(m, -1, dtype=np.int64)
        self._fresh = np.zeros(m, dtype=bool)
        self.state = np.zeros((2, m))  # angles and velocities of the joints [rad, rad/s]
        # by the map's effort_names, in the robot's units; NaN where unknown
        self.effort = np.full(len(joint_map.effort_names), np.nan)
        self.time, self.estimated = 0, 0   # of the state [ns]; readings without a velocity

    @property
    def jumps(self) -> int:
        """Return how often the clock of any source jumped."""
        return sum(timeline.jumps for timeline in self._timelines)

    def absent(self) -> list:
        """Return the names of encoders that nothing has been heard of since the last state."""
        return [name for name, fresh in zip(self._map.names, self._fresh, strict=True)
                if not fresh]

    def take(self, source, names, position, velocity, effort, stamp, now) -> bool:
        """
        Take one message of one source; return whether there is a new state.

        It is one once every encoder has been heard of since the last, all within ``skew``; older
        readings are moved to the time of the newest with their velocity. ``velocity`` and
        ``effort`` may be empty, ``stamp`` and ``now`` are as of `Timeline.read`. Raises
        ReadingError, with nothing changed, if lengths, numbers or names make no sense.
        """
        plan = self._plan(source, names)
        q, dq, torque = plan.numbers((position, velocity, effort))
        bad = first_bad(q, dq, plan.index, plan.slope, plan.offset)
        if bad >= 0:
            k = plan.index[bad]
            raise ReadingError(f'joint states have position {q[k]:g} and velocity {dq[k]:g} for '
                               f'{self._map.names[plan.channel[bad]]!r}')
        self._keep(source, plan)
        time = self._timelines[source].read(stamp, now)
        if time is None:
            return False
        estimated, newest = merge(
            q, dq, torque, plan.index, plan.channel, plan.slope, plan.offset, plan.others, time,
            self._cutoff, self._skew, self._latest, self._times, self._fresh, self.state,
            self.effort)
        self.estimated += estimated
        self.time = max(newest, self.time)
        return newest > 0

    def expected(self, names, fields, stamp, now) -> tuple:
        """
        Return what `merge` takes, of a message of the only source as it always sends them.

        ``fields`` are position, velocity and effort; () for another message.
        """
        plan, time = self._plans[0], self._timelines[0].expected(stamp, now)
        if not time or len(self._plans) > 1 or plan is None or plan.names != names:
            return ()
        return (*plan.numbers(fields), plan.index, plan.channel, plan.slope, plan.offset,
                plan.others, time, self._cutoff, self._skew, self._latest, self._times,
                self._fresh, self.state, self.effort)

    def _plan(self, source, names):
        plan = self._plans[source]
        if plan is not None and plan.names == names:
            return plan
        place = self._sources[source]
        plan = _Plan(place, names, self._map)
        for c in plan.channel:
            if self._owner[c] not in (None, source):
                raise ReadingError(f'{self._map.names[c]!r} comes from '
                                   f'{self._sources[self._owner[c]]} and from {place}; leave it '
                                   'out of one, or one out of bridge.state_topics')
        return plan

    def _keep(self, source, plan):
        if plan is not self._plans[source]:
            self._plans[source] = plan
            for c in plan.channel:
                self._owner[c] = source


@compiled
def first_bad(position, velocity, index, slope, offset) -> int:
    """Return which reading makes no angle, or too fast a one; -1 if none does."""
    for k in range(len(index)):
        angle = position[index[k]] * slope[k] + offset[k]
        rate = velocity[index[k]] * slope[k]
        if not abs(angle) <= LARGEST or abs(rate) > LARGEST:  # NaN is no velocity, but no angle
            return k
    return -1


@compiled
def merge(position, velocity, effort, index, channel, slope, offset, others, time, cutoff, skew,
          latest, times, fresh, state, efforts) -> tuple[int, int]:
    """
    Take readings at a ``time`` [ns] into the ``latest`` (2, m); make a ``state`` (2, m) of them.

    Return how many velocities were estimated, and the time of the state, 0 if absent.
    """
    estimated = 0
    if not fresh.any():  # a new state begins
        efforts[len(times):] = np.nan
    for k in range(len(others)):
        if not math.isnan(effort[others[k, 1]]):
            efforts[others[k, 0]] = effort[others[k, 1]]
    for k in range(len(index)):
        c, i = channel[k], index[k]
        angle, rate = position[i] * slope[k] + offset[k], velocity[i] * slope[k]
        if math.isnan(rate):
            estimated += 1
            elapsed = (time - times[c]) / NANOSECONDS
            rate = 0.0
            if times[c] >= 0 and 0.0 < elapsed < _LONGEST_STEP:
                before = latest[1, c]
                rate = before + (1.0 - math.exp(-2.0 * math.pi * cutoff * elapsed)) * (
                    (angle - latest[0, c]) / elapsed - before)
        latest[0, c], latest[1, c], times[c], fresh[c] = angle, rate, time, True
        efforts[c] = effort[i]
    newest = times.max()
    if not fresh.all() or newest - times.min() > skew:
        return estimated, 0
    fresh[:] = False
    for c in range(len(times)):
        state[0, c] = latest[0, c] + latest[1, c] * ((newest - times[c]) / NANOSECONDS)
        state[1, c] = latest[1, c]
    return estimated, newest
