# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
A recording made ready: even samples, smoothed angles with their derivatives, held torques.

Where a flexible joint has no link encoder, the motor equation gives the spring's torque and so
the link: ``q_link = q_motor - (u - J ddq_motor) / K``, corrected for each model by what its motor
equation leaves. One equation per joint remains, that of link and motor together.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

from gms_flex_control import records
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import (
    derivatives,
    low_pass,
    low_pass_window,
    means_held,
    noise_of,
    quantum,
)
from gms_flex_control.dynamics import chain
from gms_flex_control.dynamics.chain import own_inertia
from gms_flex_control.effects.guess import Scales, Travel
from gms_flex_control.errors import BagError
from gms_flex_control.params.arm import at_last_link, Body, why_not_carried
from gms_flex_control.simulation import plant
import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d, minimum_filter1d

WORKING_PERIOD = 4e-3  # sample at which the equations are formed, if the recording is finer [s]
_WINDOW = 0.034        # of the smoothing that velocities come from [s]
_KNOWN = 0.98          # share of samples a torque must cover
_STANDING = 0.2        # a link stands that its encoder does not see move for so long [s]
_ONE_COUNT = 1.5       # counts: the reading goes to and fro between two
_FINE = 20.0           # times a count's own noise: smaller steps are not those of an encoder
_LONGEST_HOLE = 5.5    # samples: readings farther apart are not bridged
_SETTLED = 0.3         # after a hole, until friction is that of the motion seen [s]
_MOST_KEPT = 12        # torques along a motion that are kept
_DEVIATIONS = 6.0      # of noise: so far apart readings of a link at rest lie
_INERTIA_NOISE = 0.05  # of the usual torque: noise of an unseen link's inertia torque
_BAND = (1.0, 20.0)    # of the low-pass that limits it [Hz]


class UnseenLink(NamedTuple):
    """A link without encoder."""

    joint: int
    stiffness: float  # as believed [N m/rad]
    inertia: float    # of the motor, as believed [kg m^2]
    window: int       # of the low-pass its angle is seen through, samples


@dataclass(frozen=True, eq=False)
class Motion:
    """
    One measured motion of n joints as the equations take it.

    The equations are formed at S samples, every ``factor`` of the T samples of the recording;
    readings and held torques reach them through one symmetric filter, so none is wasted.
    """

    joints: tuple              # of str, names of the links
    fine_time: np.ndarray      # (T,) of the recording, evenly spaced [s]
    fine_period: float         # [s]
    readings: np.ndarray       # (T, 2, n) of link and motor [rad]; rigid: both the link's
    fine_states: np.ndarray    # (T, 6, n) smoothed link angle, rate, acceleration; the motor's
    command: np.ndarray        # (T, n) torque held from sample k to k + 1 [N m]
    supply: np.ndarray         # (T,) voltage of the drives [V], 0 where it is not known
    noise: np.ndarray          # (2, n) standard deviation of the readings [rad]
    factor: int                # samples of the recording per sample of the equations
    time: np.ndarray           # (S,) of the equations [s]
    period: float              # [s]
    states: np.ndarray         # (S, 6, n) smoothed motion there
    second: np.ndarray         # (S, 2, n) filtered second differences of readings [rad/s^2]
    drive: np.ndarray          # (S, n) the torque commands behind the same filter [N m]
    torsion_rest: np.ndarray   # (S, n) torsion as read, filtered, less the smoothed one [rad]
    standing: np.ndarray       # (S, n) whether the encoder sees the link stand, bool
    known: np.ndarray          # (S,) whether all angles were read, bool; else a straight line
    commanded: bool            # ``command`` is what was asked for; else torque as measured
    source: str                # where it came from
    unseen: tuple = ()         # of UnseenLink: readings and motion are computed, as believed
    pushed: np.ndarray | None = None  # (T, n) on the links of a null simulation [N m]
    load: Body | None = None   # that was carried, in the frame of the last link
    _kept: dict = field(init=False, repr=False, default_factory=dict)

    def once(self, key, make) -> Any:
        """Return what ``make`` returns, of the last few keys without calling it again."""
        found = self._kept.pop(key, None)
        found = make() if found is None else found
        self._kept[key] = found  # the latest one asked for is last
        for old in list(self._kept)[:-_MOST_KEPT]:
            self._kept.pop(old, None)
        return found

    def carrying(self, constants) -> np.record:
        """Return the kernels' record of a model with the load that was carried."""
        if self.load is None:
            return constants
        boxed = records.boxed(constants)
        boxed['chain'][0] = chain.carrying(constants.chain, self.load)
        return boxed[0]

    def through_filter(self, torque) -> np.ndarray:
        """Return torques (T, n) held over samples as the equations see them, shape (S, n)."""
        return thinned(_held_triangle(torque), self.factor)

    @cached_property
    def push(self) -> np.ndarray:
        """Return ``pushed`` as the equations see it (S, n) [N m]."""
        return self.through_filter(self.pushed)

    def with_torque(self, command) -> Self:
        """Return the Motion with other torques held from sample to sample, (T, n) [N m]."""
        return replace(self, command=command, drive=self.through_filter(command))


def second_difference(angle, period) -> np.ndarray:
    """Return the central second difference of angles (T, ...), zero at both ends."""
    out = np.zeros_like(angle)
    out[1:-1] = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / period ** 2
    return out


def _held_triangle(torque):
    """
    Return torques (T, n) held from sample k to k + 1 as a second difference sees them.

    Under a force held over each sample, ``q[k+1] - 2 q[k] + q[k-1]`` is exactly the mean of both
    samples' accelerations times the squared period.
    """
    out = torque.copy()
    out[1:] = 0.5 * (torque[1:] + torque[:-1])
    return out


def thinned(values, factor) -> np.ndarray:
    """Return every ``factor``-th of values (T, ...) behind two triangles of that length."""
    if factor == 1:
        return values
    triangle = np.convolve(np.ones(factor), np.ones(factor))
    kernel = np.convolve(triangle, triangle)
    return np.ascontiguousarray(
        convolve1d(values, kernel / kernel.sum(), axis=0, mode='nearest')[::factor])


def filtered_alike(torque, weight) -> np.ndarray:
    """Return sampled torques (S, n) as filtered ones, ``weight`` on both neighbours."""
    out = torque.copy()
    out[1:-1] += weight * (torque[:-2] - 2.0 * torque[1:-1] + torque[2:])
    return out


def weight_of_neighbours(factor) -> float:
    """Return the weight with which `filtered_alike` is the filter of `Motion`."""
    return (1.0 / 6.0 + (factor ** 2 - 1.0) / 3.0) / (2.0 * factor ** 2)


def motion_of(recording, robot) -> Motion:
    """
    Return the Motion of a Recording with the joints of a robot, in any order.

    Raises
    ------
    BagError
        If a joint, angles or torques are missing.

    """
    recording = recording.of_joints(robot.joints)
    require_known(recording, robot)
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
            known &= ~_in_hole(recording.time[np.isfinite(angles[:, j])], time, period)
        if robot.arm.rigid[j]:
            readings[:, 1, j] = readings[:, 0, j]
    motion = make_motion(recording.joints, time, period, readings,
                         held_torque(recording, time, period), supply_voltage(recording, time),
                         has_commands(recording), recording.source, unseen)
    half = round(0.5 * _SETTLED / period)  # friction remembers the motion that nobody saw
    known = minimum_filter1d(known, 2 * half + 1, origin=half)
    known = minimum_filter1d(known, smoothing(period) + 4 * motion.factor)
    load = recording.operation.load
    load = load and at_last_link(load, robot.arm)
    return replace(motion, known=known[::motion.factor], load=load)


def require_known(recording, robot) -> None:
    """Raise BagError where a recording has a load or torques that the robot's model cannot use."""
    if recording.operation.load_unknown:
        raise BagError(f'{recording.source}: its load is unknown; gms_flex identify finds it '
                       '(recordings.1.load), then state it in recording.yaml')
    load = recording.operation.load
    why_not = load and why_not_carried(load, robot.arm)
    if why_not:
        raise BagError(f'{recording.source}: {why_not}')
    loose = np.flatnonzero(~np.isfinite(recording.scale_sd))
    if len(loose):
        raise BagError(f'{recording.source}: the torque constant of {recording.joints[loose[0]]} '
                       "is 'unknown': state it in its recording.yaml; 'gms_flex identify "
                       "--estimate all' finds it where another constant or a load is known")


def make_motion(joints, time, period, readings, command, supply, commanded, source, unseen=(),
                factor=None) -> Motion:
    """
    Return the Motion of even samples; arguments as its fields, those of ``fine_...``.

    The readings of links that are ``unseen`` are computed, in place. Without a ``factor`` the
    equations are formed every `WORKING_PERIOD`.
    """
    n, time = len(joints), np.array(time)  # kernels are compiled anew for a read-only one
    command = np.ascontiguousarray(command)
    bend, held = second_difference(readings, period), _held_triangle(command)
    for link in unseen:
        j, motor = link.joint, readings[:, 1, link.joint]
        readings[:, 0, j] = low_pass(
            motor - (held[:, j] - link.inertia * bend[:, 1, j]) / link.stiffness, link.window)
        bend[:, 0, j] = second_difference(readings[:, 0, j], period)
    noise = np.sqrt(np.mean(np.diff(readings, 3, axis=0) ** 2, axis=0) / 20.0)
    states = np.stack(derivatives(readings, period, smoothing(period)), axis=2).reshape(
        len(time), 6, n)
    factor = factor or max(int(WORKING_PERIOD / period * (1.0 + 1e-6)), 1)
    thin = np.ascontiguousarray(states[::factor])
    torsion = thinned(filtered_alike(readings[:, 1] - readings[:, 0], 1.0 / 12.0), factor)
    return Motion(
        joints=tuple(joints), fine_time=time, fine_period=period, readings=readings,
        fine_states=np.ascontiguousarray(states), command=command, supply=supply, noise=noise,
        factor=factor, time=np.ascontiguousarray(time[::factor]), period=period * factor,
        states=thin, second=thinned(bend, factor), drive=thinned(held, factor),
        torsion_rest=torsion - filtered_alike(
            thin[:, 3] - thin[:, 0], weight_of_neighbours(factor)),
        standing=standing(readings[:, 0], noise[0], period)[::factor],
        known=np.ones(len(thin), dtype=bool), commanded=commanded, source=source, unseen=unseen)


def at_full_rate(motion) -> Motion:
    """Return a Motion with its equations formed at every sample of the recording."""
    fine = make_motion(motion.joints, motion.fine_time, motion.fine_period,
                       motion.readings.copy(), motion.command, motion.supply, motion.commanded,
                       motion.source, motion.unseen, factor=1)
    known = np.repeat(motion.known, motion.factor)[:len(motion.fine_time)]
    return replace(fine, known=known, pushed=motion.pushed, load=motion.load)


def smoothing(period) -> int:
    """Return the samples of the smoothing that velocities come from."""
    return max(2 * round(0.5 * _WINDOW / period) + 1, 5)


def encoder_step(angle, noise) -> float:
    """Return the count of an encoder by its readings (T,) [rad], 0 if they have no steps."""
    step = quantum(angle)
    return step if noise < _FINE * step / np.sqrt(12.0) else 0.0


def standing(angle, noise, period) -> np.ndarray:
    """Return when encoders of noise (n,) see links (T, n) stand, bool (T, n) [rad]."""
    window = max(round(_STANDING / period), 3)
    spread = (maximum_filter1d(angle, window, axis=0) - minimum_filter1d(angle, window, axis=0))
    step = np.array([encoder_step(column, own)
                     for column, own in zip(angle.T, noise, strict=True)])
    return spread <= np.maximum(_ONE_COUNT * step, _DEVIATIONS * noise)


def scales_of(motions, robot) -> list:
    """Return the Scales of each joint over all recordings."""
    arm, found = robot.arm, []
    for j in range(robot.n_joints):
        link, rate, motor = (np.concatenate([one.states[:, row, j] for one in motions])
                             for row in (0, 1, 3))
        torque = np.concatenate([one.command[:, j] for one in motions])
        torsion = 0.0 if arm.rigid[j] else float(np.std(motor - link))  # without the offset
        spring = float(arm.stiffness[j] * torsion) if torsion > 0.0 else float(np.std(torque))
        speed = max(float(np.sqrt(np.mean(rate ** 2))), 1e-6)
        found.append(Scales(
            friction=float(np.mean([side.static[j] + side.viscous[j] * speed for side in (
                robot.friction.forward, robot.friction.backward)])),
            torque=float(np.abs(torque).max()), spring=spring, torsion=torsion, speed=speed,
            inertia=float(arm.motor_inertia[j]), link_inertia=float(arm.link_inertia[j]),
            mass=float(arm.mass.sum()), travel=Travel(float(link.min()), float(link.max())),
            turned=float(np.ptp(motor)),
            duration=float(max(one.time[-1] - one.time[0] for one in motions)),
            supply=min(float(one.supply.mean()) for one in motions),
            count=max(encoder_step(one.readings[:, 0, j], one.noise[0, j]) for one in motions),
            presliding=float(np.max(robot.friction.weight[j] * robot.friction.forward.coulomb[j]
                                    / robot.friction.stiffness[j])),
            in_space=arm.frames is not None))
    return found


# --- links without encoder ----------------------------------------------------------------------


def unseen_links(recording, robot) -> tuple:
    """Return the flexible joints of which only the motor was recorded, tuple of UnseenLink."""
    arm, found, inertias = robot.arm, [], own_inertia(plant.constants_of(robot).chain)[0]
    for j in range(robot.n_joints):
        if (arm.rigid[j] or np.isfinite(recording.q_link[:, j]).any()
                or not np.isfinite(recording.q_motor[:, j]).any()):
            continue
        stiffness, inertia = float(arm.stiffness[j]), float(arm.motor_inertia[j])
        # the fourth derivative of white noise of density 2 noise^2 period reaches the equation
        carried = inertias[j] * inertia / stiffness * (2.0 * np.pi) ** 4
        density = 2.0 * noise_of(recording.q_motor[:, j]) ** 2 * recording.period * carried ** 2
        band = (9.0 * (_INERTIA_NOISE * _usual_torque(recording, j)) ** 2 / density) ** (1.0 / 9.0)
        found.append(UnseenLink(j, stiffness, inertia, low_pass_window(
            np.clip(band, *_BAND), recording.period)))
    return tuple(found)


def _usual_torque(recording, j):
    """Return the usual torque of a joint [N m]; its command, if that was recorded."""
    known = next((torque[np.isfinite(torque)] for torque in (
        recording.command[:, j], recording.tau_motor[:, j]) if np.isfinite(torque).any()), None)
    return 1.0 if known is None else max(float(np.std(known)), 1e-12)


def with_links(recording, robot) -> Recording:
    """Return a Recording with the computed angles of links that have no encoder."""
    unseen = unseen_links(recording, robot)
    if not unseen:
        return recording
    motion, q_link = motion_of(recording, robot), recording.q_link.copy()
    for link in unseen:
        q_link[:, link.joint] = np.interp(recording.time, motion.fine_time,
                                          motion.readings[:, 0, link.joint])
    return replace(recording, q_link=q_link)


# --- even samples -------------------------------------------------------------------------------


def _in_hole(read, time, period):
    """Return which times (T,) lie in holes between the times (K,) of readings [s], bool."""
    if len(read) == 0:
        return np.ones(len(time), dtype=bool)
    after = np.searchsorted(read, time, side='left')
    before, after = read[np.maximum(after - 1, 0)], read[np.minimum(after, len(read) - 1)]
    off = np.minimum(np.abs(time - before), np.abs(time - after))
    return (np.maximum(after - before, off) > _LONGEST_HOLE * period) & (off > 0.0)


def supply_voltage(recording, time) -> np.ndarray:
    """Return the voltage of the supply at times (T,) [V], 0 if it was not recorded throughout."""
    known = np.isfinite(recording.supply)
    if known.mean() < _KNOWN:
        return np.zeros(len(time))
    return np.interp(time, recording.time[known], recording.supply[known])


def has_commands(recording) -> bool:
    """Return whether torque commands cover a recording."""
    return bool(np.isfinite(recording.command).mean() > _KNOWN)


def held_torque(recording, time, period) -> np.ndarray:
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


def mean_held(torque, since, time, period) -> np.ndarray:
    """Return the mean from each of even times (T,) on of torques (K, n) held ``since`` (K,)."""
    until = np.append(since, max(since[-1], time[-1]) + 2.0 * period)
    return means_held(torque, until, np.append(time, time[-1] + period))


def held(values) -> np.ndarray:
    """Return values (T, n) with the last one before in every gap, zero at first."""
    rows = np.where(np.isfinite(values), np.arange(len(values))[:, None], -1)
    rows = np.maximum.accumulate(rows, axis=0)
    return np.where(rows >= 0, np.take_along_axis(values, np.maximum(rows, 0), axis=0), 0.0)


def even_time(recording) -> tuple:
    """Return evenly spaced times (T,) over a recording, and their period [s]."""
    time, period = recording.time, recording.period
    steps = np.diff(time)
    if np.abs(steps - period).max() < 1e-3 * period:
        return time, float((time[-1] - time[0]) / (len(time) - 1))
    count = int((time[-1] - time[0]) / period * (1.0 + 1e-9)) + 1
    return time[0] + period * np.arange(count), period


def _resampled(recording, values, time, what):
    """Return values at even times; raise BagError where most are missing."""
    known = np.isfinite(values)
    if known.mean() < 0.5:
        raise BagError(f'{recording.source}: the {what} is missing; the equations of motion '
                       'need it')
    if time is recording.time and known.all():
        return values
    return np.interp(time, recording.time[known], values[known])
