# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""One experiment as plain arrays, also at even times; its phases, and which topics hold it."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import stamped_amiss
from gms_flex_control.errors import BagError
from gms_flex_control.params.arm import Body
import numpy as np

COVERED = 0.98  # share of its samples that a torque, or a supply, must cover
# of a clock behind stamps
_EVEN = 1e-3       # of a period: times nearer than that to even ones are even
_EARLY = 0.3       # of a period by which a stamp may be before its sample; late ones fill the rest
_OFF = 0.02        # relative, by which the median step may miss the period
_FEWEST = 16       # samples that show a clock
_BEYOND = 1.0       # for how long the first and the last value are held outside a recording [s]
_BEGIN = 256       # samples in which the period is looked for first, then in four times as many
_STEP = 0.125      # periods by which candidates differ over all samples


class Phase(NamedTuple):
    """What an identification experiment was doing from a time on."""

    time_ns: int  # since the first sample of the recording [ns]
    phase: str    # constant_velocity, break_away, presliding, sliding, approach or idle
    joint: str    # '' in idle, as the step
    step: str     # its name
    value: float  # signed velocity [rad/s] or torque amplitude [N m] of the step


class Operation(NamedTuple):
    """Under which conditions a robot moved."""

    load: Body | None = None    # carried, in the frame at the end of the arm
    load_unknown: bool = False  # whether a load is to be found, all but ``load`` of it
    temperature: str = ''       # label; recordings of one label have the same friction


# what has a column for each joint
_OF_JOINTS = ('q_link', 'dq_link', 'q_motor', 'dq_motor', 'tau_motor', 'command', 'reference',
              'friction_hat', 'scale_sd')
NOT_SAMPLED = ('joints', 'source', 'operation', 'coupling')


def _unknown():
    return field(default_factory=lambda: np.array(np.nan))


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """
    One experiment on one robot, sampled at the joint states; NaN stands for what is unknown.

    A column that is not given is unknown, a single number is that of all samples and joints.
    BagError if a shape does not fit or time does not increase.
    """

    joints: tuple             # link names, n of them
    time: np.ndarray          # (T,), strictly increasing, from the first sample [s]
    source: str               # where it came from, for messages and titles
    q_link: np.ndarray = _unknown()        # (T, n), measured as the next three [rad]
    dq_link: np.ndarray = _unknown()       # (T, n) [rad/s]
    q_motor: np.ndarray = _unknown()       # (T, n) [rad]
    dq_motor: np.ndarray = _unknown()      # (T, n) [rad/s]
    tau_motor: np.ndarray = _unknown()     # (T, n), applied over the sample up to time[k] [N m]
    command: np.ndarray = _unknown()       # (T, n), torque that answers the state at time[k] [N m]
    reference: np.ndarray = _unknown()     # (T, 5, n), desired link angle and derivatives 1 to 4
    friction_hat: np.ndarray = _unknown()  # (T, n), the observer's estimate [N m]
    supply: np.ndarray = _unknown()        # (T,), voltage of the drives' supply [V]
    operation: Operation = Operation()
    scale_sd: np.ndarray = 0.0  # (n,), relative, of torques whose scale is not known
    coupling: np.ndarray | None = None  # (n, n), angles of motors by those of joints; None: alone

    def __post_init__(self):
        n, samples = len(self.joints), len(self.time)
        for one in fields(self):
            if one.name in NOT_SAMPLED:
                continue
            shape = {'time': (samples,), 'supply': (samples,), 'scale_sd': (n,),
                     'reference': (samples, 5, n)}.get(one.name, (samples, n))
            value = np.array(getattr(self, one.name), dtype=float)
            value = np.full(shape, value) if value.ndim == 0 else value
            value.setflags(write=False)
            object.__setattr__(self, one.name, value)
            if value.shape != shape:
                raise BagError(f'{self.source}: {one.name} has shape {value.shape}, '
                               f'expected {shape} for {n} joints and {samples} samples')
        steps = np.diff(self.time)
        if samples < 2 or not np.all(steps > 0):
            where = f' at sample {int(np.argmin(steps)) + 1}' if samples > 1 else ''
            raise BagError(f'{self.source}: time must increase over at least 2 samples, '
                           f'it does not{where}; sort or repair the recording first')

    @property
    def n_joints(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    @property
    def identity(self) -> str:
        """Return by what a recording is known again: its name, and its duration [s]."""
        return f'{Path(self.source).name}, {self.time[-1] - self.time[0]:.3f} s'

    @property
    def has_currents(self) -> bool:
        """Return whether the torques of all joints are currents of unknown torque constant."""
        return bool(np.isinf(self.scale_sd).all())

    def of_joints(self, joints) -> 'Recording':
        """Return the Recording of some joints, in that order; BagError if it lacks one."""
        if tuple(joints) == tuple(self.joints):
            return self
        absent = [joint for joint in joints if joint not in self.joints]
        if absent:
            raise BagError(f'{self.source}: has no joint {absent[0]!r}, it has '
                           f'{", ".join(self.joints)}')
        columns = [self.joints.index(joint) for joint in joints]
        coupling = self.coupling if self.coupling is None else self.coupling[
            np.ix_(columns, columns)]
        return replace(self, joints=tuple(joints), coupling=coupling, **{
            name: getattr(self, name)[..., columns] for name in _OF_JOINTS})

    @property
    def links_seen(self) -> np.ndarray:
        """Return of which joints the link angle was read at all, bool (n,)."""
        return np.isfinite(self.q_link).any(axis=0)

    @property
    def motors_alone(self) -> np.ndarray:
        """Return of which joints the motor angle was read, and the link never, bool (n,)."""
        return np.isfinite(self.q_motor).any(axis=0) & ~self.links_seen

    @property
    def has_commands(self) -> bool:
        """Return whether torque commands cover the recording."""
        return bool(np.isfinite(self.command).mean() > COVERED)

    def commanded(self) -> np.ndarray:
        """
        Return the torque that answers each sample (T, n) [N m], zero where none was known before.

        In a gap the last one goes on. Where commands do not cover the recording, efforts are
        taken for them, each for the sample before it.
        """
        if self.has_commands:
            return held(self.command)
        torque = held(self.tau_motor)
        return np.concatenate([torque[1:], torque[-1:]])

    def supply_at(self, time) -> np.ndarray:
        """Return the voltage of the supply at times (T,) [V], 0 if it is not always known."""
        known = np.isfinite(self.supply)
        if known.mean() < COVERED:
            return np.zeros(len(time))
        return np.interp(time, self.time[known], self.supply[known])

    def by_motors(self) -> 'Recording':
        """Return the Recording with a motor in its joint's place where nobody sees the link."""
        seen = self.links_seen
        return replace(
            self, q_link=np.where(seen, self.q_link, self.q_motor),
            dq_link=np.where(seen, self.dq_link, self.dq_motor),
            q_motor=np.where(seen, self.q_motor, np.nan),
            dq_motor=np.where(seen, self.dq_motor, np.nan))

    def of_samples(self, rows) -> 'Recording':
        """Return the Recording of some samples (T,), a mask, or numbers that increase."""
        return self.with_channels(lambda channel: channel[rows])

    def with_channels(self, change: Callable[[np.ndarray], np.ndarray]) -> 'Recording':
        """Return the Recording with all that is sampled, (T, ...), time as well, changed."""
        return replace(self, **{one.name: change(getattr(self, one.name)) for one in fields(self)
                                if one.name not in (*NOT_SAMPLED, 'scale_sd')})

    @property
    def period(self) -> float:
        """Return the median sample period [s]."""
        return float(np.median(np.diff(self.time)))


def held(values: np.ndarray) -> np.ndarray:
    """Return values (T, n) with the last one before in every gap, zero at first."""
    rows = np.where(np.isfinite(values), np.arange(len(values))[:, None], -1)
    rows = np.maximum.accumulate(rows, axis=0)
    return np.where(rows >= 0, np.take_along_axis(values, np.maximum(rows, 0), axis=0), 0.0)


def means_held(values: np.ndarray, ends: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return means (T, ...) between ``edges`` (T + 1,) of ``values`` held from ``ends`` on [s]."""
    held = (np.asarray(values).T * np.diff(ends)).T
    impulse = np.concatenate([np.zeros((1, *held.shape[1:])), np.cumsum(held, axis=0)])
    impulse = np.apply_along_axis(lambda one: np.interp(edges, ends, one), 0, impulse)
    return (np.diff(impulse, axis=0).T / np.diff(edges)).T


def later(values: np.ndarray, edges: np.ndarray, delay: float) -> np.ndarray:
    """
    Return means between ``edges`` (T + 1,) [s] of values (T, ...) held there, ``delay`` [s] later.

    The first and the last are held beyond the edges.
    """
    ends = np.concatenate([[edges[0] - _BEYOND], edges, [edges[-1] + _BEYOND]])
    return means_held(np.concatenate([values[:1], values, values[-1:]]), ends, edges - delay)


def on_even_clock(recording: Recording) -> Recording:
    """
    Return a Recording with its samples at even times if its angles are smoother so.

    A drive samples at even times; its driver stamps late, by what the operating system makes of
    it. A late stamp puts a moving joint where it was not, by speed times lateness: far more than
    encoders do. Times of lost samples stay free. Stamps that are the true times of uneven samples
    stay, as those do of angles too coarse or too still to show the difference.
    """
    stamps, period = recording.time, recording.period
    if len(stamps) < _FEWEST or _is_even(stamps, period):
        return recording
    slots, period = _slots(stamps)
    even = period * slots
    if np.ptp(stamps - even) < _EVEN * period:
        return recording
    angles = [one for one in (*recording.q_link.T, *recording.q_motor.T)
              if np.isfinite(one).sum() > _FEWEST]
    if sum(_roughness(angle, even, period) - _roughness(angle, stamps, period)
           for angle in angles) >= 0.0:
        return recording
    return replace(recording, time=even)


def with_own_stamps(recording: Recording) -> tuple[Recording, list[str]]:
    """
    Return a Recording without samples whose stamps are not theirs, and a sentence on them if any.

    A moving angle seems to jump there, and to make up for it in the gap beside.
    """
    amiss = np.zeros(len(recording.time), dtype=bool)
    for angle in (*recording.q_link.T, *recording.q_motor.T):
        known = np.flatnonzero(np.isfinite(angle))
        amiss[known[stamped_amiss(recording.time[known], angle[known], recording.period)]] = True
    if not amiss.any():
        return recording, []
    first = recording.time[np.argmax(amiss)]
    return recording.of_samples(~amiss), [
        f'{recording.source}: {amiss.sum()} samples were stamped too early or too late, the first '
        f'at {first:.3f} s: left out']


def _slots(stamps):
    """Return at which even time each sample was taken (T,), increasing from 0, and the period."""
    period = _period(stamps)
    turns = (stamps - stamps[0]) / period
    turns -= np.angle(np.sum(np.exp(2j * np.pi * turns))) / (2.0 * np.pi)
    order = np.arange(len(stamps))
    slots = np.floor(turns + _EARLY).astype(int) - order
    slots = np.minimum.accumulate(slots[::-1])[::-1] + order  # later than a period: the one before
    slots -= slots[0]
    return slots, float(np.polyfit(slots, stamps, 1)[0])


def _period(stamps):
    """Return the period with which stamps (T,) agree best in phase, that of a clock [s]."""
    period, off, count = float(np.median(np.diff(stamps))), _OFF, _BEGIN
    while True:
        time = stamps[:count] - stamps[0]
        step = _STEP * period / time[-1]
        rates = (1.0 + step * np.arange(-int(off / step) - 1, int(off / step) + 2)) / period
        period = 1.0 / max(rates, key=lambda rate: abs(np.sum(np.exp(2j * np.pi * rate * time))))
        if count >= len(stamps):
            return period
        off, count = 4.0 * step, 4 * count


def _roughness(angle, time, period):
    """Return the logarithm of the mean squared third difference of an angle at even times."""
    known = np.isfinite(angle)
    squares = np.diff(np.interp(even_grid(time, period), time[known], angle[known]), 3) ** 2
    return float(np.log(max(np.mean(squares), 1e-300)))


def even_time(recording: Recording) -> tuple[np.ndarray, float]:
    """Return evenly spaced times (T,) over a recording, and their period [s]."""
    time, period = recording.time, recording.period
    if _is_even(time, period):
        return time, float((time[-1] - time[0]) / (len(time) - 1))
    return even_grid(time, period), period


def _is_even(time, period):
    return np.abs(np.diff(time) - period).max() < _EVEN * period


def even_grid(time: np.ndarray, period: float) -> np.ndarray:
    """Return times a ``period`` apart from the first of ``time`` (T,) to the last [s]."""
    return time[0] + period * np.arange(int((time[-1] - time[0]) / period * (1.0 + 1e-9)) + 1)


def resampled(recording: Recording, values: np.ndarray, time: np.ndarray, what: str) -> np.ndarray:
    """Return values at even times; raise BagError where most are missing."""
    known = np.isfinite(values)
    if known.mean() < 0.5:
        raise BagError(f'{recording.source}: the {what} is missing; the equations of motion '
                       'need it: record it, or describe the joint as rigid (stiffness: .inf)')
    if time is recording.time and known.all():
        return values
    return np.interp(time, recording.time[known], values[known])


def held_torque(recording: Recording, time: np.ndarray, period: float) -> np.ndarray:
    """Return the torque held from even times on (T, n) [N m]: commands, or efforts reported."""
    if not recording.has_commands and np.isfinite(recording.tau_motor).mean() <= COVERED:
        raise BagError(f'{recording.source}: neither torque commands nor joint efforts cover the '
                       'recording; record /effort_controller/commands or the effort of '
                       '/joint_states too')
    torque = recording.commanded()
    return (torque if time is recording.time
            else resample_held(torque, recording.time, time, period))


def resample_held(torque: np.ndarray, since: np.ndarray, time: np.ndarray,
                  period: float) -> np.ndarray:
    """Return the mean from each of even times (T,) on of torques (K, n) held ``since`` (K,)."""
    until = np.append(since, max(since[-1], time[-1]) + 2.0 * period)
    return means_held(torque, until, np.append(time, time[-1] + period))


MOTOR_SUFFIX = '_motor'


class Topics(NamedTuple):
    """Where a recording is found in a bag."""

    joint_states: str = '/joint_states'
    command: str = '/effort_controller/commands'
    reference: str = '/reference'
    controller_state: str = '/cascade_controller/state'
    supply: str = '/supply_voltage'

    def within(self, namespace) -> 'Topics':
        """Return these topics in a namespace (str), such as '/left'."""
        return Topics(*(namespace + topic for topic in self))


def link_names(names) -> list[str]:
    """Return the names that are not the motor of another, in order."""
    return [name for name in names
            if not (name.endswith(MOTOR_SUFFIX) and name[:-len(MOTOR_SUFFIX)] in names)]
