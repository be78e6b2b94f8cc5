# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A recording made ready: even samples, smoothed angles with their derivatives, held torques."""

from dataclasses import dataclass, field, replace

from gms_flex_control.data.signals import quantum
from gms_flex_control.discrepancy.unseen_links import link_angle, unseen_links
from gms_flex_control.errors import BagError
from gms_flex_control.identification.smoothing import derivatives, means_held
import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d, minimum_filter1d

WORKING_PERIOD = 4e-3  # sample at which the equations are formed, if the recording is finer [s]
_WINDOW = 0.034        # of the smoothing that velocities come from [s]
_KNOWN = 0.98          # share of samples a torque must cover
_STANDING = 0.2        # a link stands that its encoder does not see move for so long [s]
_ONE_COUNT = 1.5       # counts: the reading goes to and fro between two
_FINE = 20.0           # times a count's own noise: steps below are none of an encoder
_LONGEST_HOLE = 5.5    # samples: readings farther apart are not bridged
_SETTLED = 0.3         # after a hole, until friction is that of the motion seen [s]
_MOST_KEPT = 8         # torques along a motion that are kept
_DEVIATIONS = 6.0      # of noise: so far apart readings of a link at rest lie


@dataclass(frozen=True, eq=False)
class Motion:
    """
    One measured motion as the equations take it.

    The equations are formed at ``time``, every ``factor`` samples of the recording; readings and
    held torques reach them through one symmetric filter, so none is wasted.

    Parameters
    ----------
    joints : tuple of str
        Link names, n of them.
    fine_time, fine_period : ndarray, shape (T,), and float
        Of the recording, evenly spaced [s].
    readings : ndarray, shape (T, 2, n)
        Angles of link and motor as read [rad]; the motor's follow the link of a rigid joint.
    fine_motion : ndarray, shape (T, 6, n)
        Smoothed link angle, rate, acceleration, then those of the motor.
    command : ndarray, shape (T, n)
        Torque held from sample k to k + 1 [N m].
    supply : ndarray, shape (T,)
        Voltage of the drives' supply [V], 0 where it is not known.
    noise : ndarray, shape (2, n)
        Standard deviation of the readings [rad].
    factor : int
        Samples of the recording per sample of the equations.
    time, period : ndarray, shape (S,), and float
        Of the equations [s].
    motion : ndarray, shape (S, 6, n)
        Smoothed motion there.
    second : ndarray, shape (S, 2, n)
        Filtered second differences of the readings [rad/s^2].
    drive : ndarray, shape (S, n)
        The torque commands behind the same filter [N m].
    twist_rest : ndarray, shape (S, n)
        Twist as read behind the filter, less the smoothed one [rad].
    standing : ndarray, shape (S, n)
        Whether the link stands as far as its encoder tells, bool.
    known : ndarray, shape (S,)
        Whether all angles were read there, bool; elsewhere they are a straight line.
    commanded : bool
        Whether ``command`` is what was asked for; else it is torque as measured.
    source : str
        Where it came from.
    unseen : tuple of UnseenLink
        Links without encoder: their readings and motion are computed, as believed.
    pushed : ndarray, shape (T, n), or None
        Torque that held simulated links on their way from outside [N m]; see `null_simulation`.

    """

    joints: tuple
    fine_time: np.ndarray
    fine_period: float
    readings: np.ndarray
    fine_states: np.ndarray
    command: np.ndarray
    supply: np.ndarray
    noise: np.ndarray
    factor: int
    time: np.ndarray
    period: float
    states: np.ndarray
    second: np.ndarray
    drive: np.ndarray
    twist_rest: np.ndarray
    standing: np.ndarray
    known: np.ndarray
    commanded: bool
    source: str
    unseen: tuple = ()
    pushed: np.ndarray | None = None
    _kept: dict = field(init=False, repr=False, default_factory=dict)

    def once(self, key, make):
        """Return what ``make`` returns, of the last few keys without calling it again."""
        found = self._kept.pop(key, None)
        found = make() if found is None else found
        self._kept[key] = found  # the latest asked for is last
        for old in list(self._kept)[:-_MOST_KEPT]:
            self._kept.pop(old, None)
        return found

    def through_filter(self, torque):
        """Return torques (T, n) held over samples as the equations see them, shape (S, n)."""
        return thinned(held_triangle(torque), self.factor)

    def with_torque(self, command):
        """Return the Motion with other torques held from sample to sample, (T, n) [N m]."""
        return replace(self, command=command, drive=self.through_filter(command))


def second_difference(angle, period):
    """Return the central second difference of angles (T, ...), zero at both ends."""
    out = np.zeros_like(angle)
    out[1:-1] = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / period ** 2
    return out


def held_triangle(torque):
    """
    Return torques (T, n) held from sample k to k + 1 as a second difference sees them.

    Under a force held over each sample, ``q[k+1] - 2 q[k] + q[k-1]`` is exactly the mean of both
    samples' accelerations times the squared period.
    """
    out = torque.copy()
    out[1:] = 0.5 * (torque[1:] + torque[:-1])
    return out


def thinned(values, factor):
    """Return every ``factor``-th of values (T, ...) behind two triangles of that length."""
    if factor == 1:
        return values
    triangle = np.convolve(np.ones(factor), np.ones(factor))
    kernel = np.convolve(triangle, triangle)
    return np.ascontiguousarray(
        convolve1d(values, kernel / kernel.sum(), axis=0, mode='nearest')[::factor])


def seen(torque, weight):
    """Return sampled torques (S, n) as filtered ones, ``weight`` on both neighbours."""
    out = torque.copy()
    out[1:-1] += weight * (torque[:-2] - 2.0 * torque[1:-1] + torque[2:])
    return out


def sampled_weight(factor):
    """Return the weight of both neighbours that makes sampled torques look as filtered ones."""
    return (1.0 / 6.0 + (factor ** 2 - 1.0) / 3.0) / (2.0 * factor ** 2)


def motion_of(recording, robot):
    """
    Return the Motion of a recording.

    Parameters
    ----------
    recording : Recording
        With all joints of the robot, in any order.
    robot : RobotParams
        Tells the order of joints, and which have a motor side.

    Returns
    -------
    Motion

    Raises
    ------
    BagError
        If a joint, angles or torques are missing.

    """
    recording = recording.of_joints(robot.joints)
    time, period = even_time(recording)
    readings = np.zeros((len(time), 2, recording.n_joints))
    known, unseen = np.ones(len(time), dtype=bool), unseen_links(recording, robot)
    for j, joint in enumerate(recording.joints):
        sides = [(0, 'link', recording.q_link)] if all(link.joint != j for link in unseen) else []
        if not robot.arm.rigid[j]:
            sides.append((1, 'motor', recording.q_motor))
        for side, name, angles in sides:
            readings[:, side, j] = _resampled(recording, angles[:, j], time,
                                              f'{name} angle of {joint!r}')
            known &= ~in_hole(recording.time[np.isfinite(angles[:, j])], time, period)
        if robot.arm.rigid[j]:
            readings[:, 1, j] = readings[:, 0, j]
    motion = make_motion(recording.joints, time, period, readings,
                         held_torque(recording, time, period), supply_voltage(recording, time),
                         has_commands(recording), recording.source, unseen)
    half = round(0.5 * _SETTLED / period)  # friction remembers the motion that nobody saw
    known = minimum_filter1d(known, 2 * half + 1, origin=half)
    known = minimum_filter1d(known, smoothing(period) + 4 * motion.factor)
    return replace(motion, known=known[::motion.factor])


def make_motion(joints, time, period, readings, command, supply, commanded, source, unseen=(),
                factor=None):
    """
    Return the Motion of even samples; arguments as its fields, those of ``fine_...``.

    The readings of links that are ``unseen`` are computed, in place. Without a ``factor`` the
    equations are formed every `WORKING_PERIOD`.
    """
    n, time = len(joints), np.array(time)  # kernels are compiled anew for a read-only one
    command = np.ascontiguousarray(command)
    bend, held = second_difference(readings, period), held_triangle(command)
    for link in unseen:
        j = link.joint
        readings[:, 0, j] = link_angle(readings[:, 1, j], held[:, j], bend[:, 1, j], link)
        bend[:, 0, j] = second_difference(readings[:, 0, j], period)
    noise = np.sqrt(np.mean(np.diff(readings, 3, axis=0) ** 2, axis=0) / 20.0)
    window = smoothing(period)
    states = np.stack(derivatives(readings, period, window), axis=2).reshape(len(time), 6, n)
    factor = factor or max(int(WORKING_PERIOD / period * (1.0 + 1e-6)), 1)
    thin = np.ascontiguousarray(states[::factor])
    twist = thinned(seen(readings[:, 1] - readings[:, 0], 1.0 / 12.0), factor)
    return Motion(
        joints=tuple(joints), fine_time=time, fine_period=period, readings=readings,
        fine_states=np.ascontiguousarray(states), command=command, supply=supply,
        noise=noise, factor=factor,
        time=np.ascontiguousarray(time[::factor]), period=period * factor,
        states=thin,
        second=thinned(bend, factor),
        drive=thinned(held, factor),
        twist_rest=twist - seen(thin[:, 3] - thin[:, 0], sampled_weight(factor)),
        standing=standing(readings[:, 0], noise[0], period)[::factor],
        known=np.ones(len(thin), dtype=bool),
        commanded=commanded, source=source, unseen=unseen)


def at_full_rate(motion):
    """Return a Motion with its equations formed at every sample of the recording."""
    fine = make_motion(motion.joints, motion.fine_time, motion.fine_period,
                       motion.readings.copy(), motion.command, motion.supply, motion.commanded,
                       motion.source, motion.unseen, factor=1)
    known = np.repeat(motion.known, motion.factor)[:len(motion.fine_time)]
    return replace(fine, known=known, pushed=motion.pushed)


def with_links(recording, robot):
    """Return a Recording with the angles of links that only their motors tell, as computed."""
    unseen = unseen_links(recording, robot)
    if not unseen:
        return recording
    motion, q_link = motion_of(recording, robot), recording.q_link.copy()
    for link in unseen:
        q_link[:, link.joint] = np.interp(recording.time, motion.fine_time,
                                          motion.readings[:, 0, link.joint])
    return replace(recording, q_link=q_link)


def smoothing(period):
    """Return the samples of the smoothing that velocities come from."""
    return max(2 * round(0.5 * _WINDOW / period) + 1, 5)


def encoder_step(angle, noise):
    """Return the count of an encoder by its readings (T,) [rad], 0 if they have no steps."""
    step = quantum(angle)
    return step if noise < _FINE * step / np.sqrt(12.0) else 0.0


def standing(angle, noise, period):
    """
    Return when links stand as far as their encoders tell.

    Parameters
    ----------
    angle : ndarray, shape (T, n)
        As read [rad].
    noise : ndarray, shape (n,)
        Standard deviation of the readings [rad].
    period : float
        Sample [s].

    Returns
    -------
    ndarray of bool, shape (T, n)

    """
    window = max(round(_STANDING / period), 3)
    spread = (maximum_filter1d(angle, window, axis=0) - minimum_filter1d(angle, window, axis=0))
    step = np.array([encoder_step(column, own)
                     for column, own in zip(angle.T, noise, strict=True)])
    return spread <= np.maximum(_ONE_COUNT * step, _DEVIATIONS * noise)


def in_hole(read, time, period):
    """Return which times (T,) lie in holes between the times (K,) of readings [s], bool."""
    if len(read) == 0:
        return np.ones(len(time), dtype=bool)
    after = np.searchsorted(read, time, side='left')
    gap = read[np.minimum(after, len(read) - 1)] - read[np.maximum(after - 1, 0)]
    off = np.minimum(np.abs(time - read[np.maximum(after - 1, 0)]),
                     np.abs(time - read[np.minimum(after, len(read) - 1)]))
    return (np.maximum(gap, off) > _LONGEST_HOLE * period) & (off > 0.0)


def supply_voltage(recording, time):
    """Return the voltage of the supply at times (T,) [V], 0 if it was not recorded throughout."""
    known = np.isfinite(recording.supply)
    if known.mean() < _KNOWN:
        return np.zeros(len(time))
    return np.interp(time, recording.time[known], recording.supply[known])


def has_commands(recording):
    """Return whether torque commands cover a recording."""
    return bool(np.isfinite(recording.command).mean() > _KNOWN)


def held_torque(recording, time, period):
    """
    Return the torque held from each of even times on, shape (T, n) [N m].

    Commands if they cover the recording, else the efforts that the joint states report for the
    sample that ended. Where samples were uneven it is the mean of what was held.
    """
    if has_commands(recording):
        torque = held(recording.command)
    elif np.isfinite(recording.tau_motor).mean() > _KNOWN:
        torque = held(recording.tau_motor)
        torque = np.concatenate([torque[1:], torque[-1:]])
    else:
        raise BagError(f'{recording.source}: neither torque commands nor joint efforts cover the '
                       'recording; record /effort_controller/commands or the effort of '
                       '/joint_states too')
    return torque if time is recording.time else mean_held(torque, recording.time, time, period)


def mean_held(torque, since, time, period):
    """Return the mean from each of even times (T,) on of torques (K, n) held ``since`` (K,)."""
    until = np.append(since, max(since[-1], time[-1]) + 2.0 * period)
    return means_held(torque, until, np.append(time, time[-1] + period))


def held(values):
    """Return values (T, n) with the last one before in every gap, zero at first."""
    rows = np.where(np.isfinite(values), np.arange(len(values))[:, None], -1)
    rows = np.maximum.accumulate(rows, axis=0)
    return np.where(rows >= 0, np.take_along_axis(values, np.maximum(rows, 0), axis=0), 0.0)


def even_time(recording):
    """Return evenly spaced times (T,) over a recording, and their period [s]."""
    time, period = recording.time, recording.period
    steps = np.diff(time)
    if np.abs(steps - period).max() < 1e-3 * period:
        return time, float((time[-1] - time[0]) / (len(time) - 1))
    count = int((time[-1] - time[0]) / period * (1.0 + 1e-9)) + 1
    return time[0] + period * np.arange(count), period


def _resampled(recording, values, time, what):
    known = np.isfinite(values)
    if known.mean() < 0.5:
        raise BagError(f'{recording.source}: the {what} is missing; the equations of motion '
                       'need it')
    if time is recording.time and known.all():
        return values
    return np.interp(time, recording.time[known], values[known])
