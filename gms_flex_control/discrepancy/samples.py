# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A recording at even times: angles with their derivatives, torques held, as the equations need it.

Where a flexible joint has no link encoder, the motor equation gives the spring's torque and so
the link: ``q_link = q_motor - (u - J ddq_motor) / K``, corrected for each model by what its motor
equation leaves. One equation per joint remains, that of link and motor together.

Faults of the data, which no physics can mend, are looked for before any of that.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import COVERED, Recording
from gms_flex_control.dynamics.chain import own_inertia
from gms_flex_control.errors import BagError
from gms_flex_control.identification import sampling_checks
from gms_flex_control.identification.check_basis import absent_joints
from gms_flex_control.identification.recording_checks import check
from gms_flex_control.params.arm import at_last_link, Body, carrying, why_not_carried
from gms_flex_control.simulation import plant
import numpy as np
from scipy.ndimage import minimum_filter1d

_WINDOW = 0.034        # of the smoothing that velocities come from [s]
_FINE = 20.0           # times a count's own noise: smaller steps are not those of an encoder
_LONGEST_HOLE = 5.5    # samples: readings farther apart are not bridged
_SETTLED = 0.3         # after a hole, until friction is that of the motion seen [s]
_INERTIA_NOISE = 0.05  # of the usual torque: noise of an unseen link's inertia torque
_BAND = (1.0, 20.0)    # of the low-pass that limits it [Hz]


class UnseenLink(NamedTuple):
    """A link without encoder."""

    joint: int
    stiffness: float  # as believed [N m/rad]
    inertia: float    # of the motor, as believed [kg m^2]
    window: int       # of the low-pass its angle is seen through, samples


@dataclass(frozen=True, eq=False)
class Samples:
    """T even samples of n joints."""

    joints: tuple         # of str, names of the links
    time: np.ndarray      # (T,) [s]
    period: float         # [s]
    readings: np.ndarray  # (T, 2, n) of link and motor [rad]; rigid: both the link's
    states: np.ndarray    # (T, 6, n) smoothed link angle, rate, acceleration; the motor's
    noise: np.ndarray     # (2, n) standard deviation of the readings [rad]
    known: np.ndarray     # (T,) whether all angles were read, bool; else a straight line
    command: np.ndarray   # (T, n) torque held from sample k to k + 1 [N m]
    supply: np.ndarray    # (T,) voltage of the drives [V], 0 where it is not known
    commanded: bool       # ``command`` is what was asked for; else torque as measured
    source: str           # where it came from
    unseen: tuple = ()    # of UnseenLink: readings and motion are computed, as believed
    pushed: np.ndarray | None = None  # (T, n) on the links of a null simulation [N m]
    load: Body | None = None          # that was carried, in the frame of the last link

    def simulated(self, readings, command, pushed) -> Self:
        """Return the Samples of a null simulation of these."""
        made = make_samples(self.joints, self.time, self.period, readings, command, self.supply,
                            self.commanded, self.source, self.unseen)
        return replace(made, known=self.known, pushed=pushed, load=self.load)


def samples_of(recording, robot) -> Samples:
    """Return the Samples of a Recording, joints as the robot's; BagError if any is missing."""
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
    half = round(0.5 * _SETTLED / period)  # friction remembers the motion that nobody saw
    load = recording.operation.load
    return replace(
        make_samples(recording.joints, time, period, readings,
                     held_torque(recording, time, period), recording.supply_at(time),
                     recording.has_commands, recording.source, unseen),
        known=minimum_filter1d(known, 2 * half + 1, origin=half),
        load=load and at_last_link(load, robot.arm))


def require_known(recording, robot) -> None:
    """Raise BagError where a recording has a load or torques that the robot's model cannot use."""
    load = recording.operation.load
    why_not = load and why_not_carried(load, robot.arm)
    if why_not:
        raise BagError(f'{recording.source}: {why_not}')
    if recording.operation.load_unknown:
        raise BagError(f'{recording.source}: its load is not known in full; gms_flex identify '
                       'finds it (recordings.1.load), then state mass and com in recording.yaml')
    loose = np.flatnonzero(~np.isfinite(recording.scale_sd))
    if len(loose) and not (recording.has_currents and robot.arm.kind == 'decoupled'):
        raise BagError(f'{recording.source}: the torque constant of {recording.joints[loose[0]]} '
                       "is 'unknown': state it in its recording.yaml; 'gms_flex identify "
                       "--estimate all' finds it where another constant or a load is known")


def make_samples(joints, time, period, readings, command, supply, commanded, source,
                 unseen=()) -> Samples:
    """Return Samples, all of them known; readings of ``unseen`` links are computed, in place."""
    time = np.array(time)  # kernels are compiled anew for a read-only one
    command = np.ascontiguousarray(command)
    for link in unseen:
        j, motor = link.joint, readings[:, 1, link.joint]
        readings[:, 0, j] = analysis.low_pass(
            motor - (held_triangle(command)[:, j] - link.inertia * second_difference(
                motor, period)) / link.stiffness, link.window)
    noise = np.sqrt(np.mean(np.diff(readings, 3, axis=0) ** 2, axis=0) / 20.0)
    states = np.stack(analysis.derivatives(readings, period, smoothing(period)), axis=2).reshape(
        len(time), 6, len(joints))
    return Samples(tuple(joints), time, period, readings, np.ascontiguousarray(states), noise,
                   np.ones(len(time), dtype=bool), command, supply, commanded, source, unseen)


def second_difference(angle, period) -> np.ndarray:
    """Return the central second difference of angles (T, ...), zero at both ends."""
    out = np.zeros_like(angle)
    out[1:-1] = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / period ** 2
    return out


def held_triangle(torque) -> np.ndarray:
    """
    Return torques (T, n) held from sample k to k + 1 as a second difference sees them.

    Under a force held over each sample, ``q[k+1] - 2 q[k] + q[k-1]`` is exactly the mean of both
    samples' accelerations times the squared period.
    """
    out = torque.copy()
    out[1:] = 0.5 * (torque[1:] + torque[:-1])
    return out


def smoothing(period) -> int:
    """Return the samples of the smoothing that velocities come from."""
    return max(2 * round(0.5 * _WINDOW / period) + 1, 5)


def encoder_step(angle, noise) -> float:
    """Return the count of an encoder by its readings (T,) [rad], 0 if they have no steps."""
    step = analysis.quantum(angle)
    return step if noise < _FINE * step / np.sqrt(12.0) else 0.0


# --- links without encoder ----------------------------------------------------------------------


def unseen_links(recording, robot) -> tuple:
    """Return the flexible joints of which only the motor was recorded, tuple of UnseenLink."""
    arm, found, inertias = robot.arm, [], own_inertia(plant.constants_of(robot).chain)[0]
    alone = recording.motors_alone
    for j in range(robot.n_joints):
        if arm.rigid[j] or not alone[j]:
            continue
        stiffness, inertia = float(arm.stiffness[j]), float(arm.motor_inertia[j])
        # the fourth derivative of white noise of density 2 noise^2 period reaches the equation
        carried = inertias[j] * inertia / stiffness * (2.0 * np.pi) ** 4
        noise = analysis.noise_of(recording.q_motor[:, j])
        density = 2.0 * noise ** 2 * recording.period * carried ** 2
        band = (9.0 * (_INERTIA_NOISE * _usual_torque(recording, j)) ** 2 / density) ** (1.0 / 9.0)
        found.append(UnseenLink(j, stiffness, inertia, analysis.low_pass_window(
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
    samples, q_link = samples_of(recording, robot), recording.q_link.copy()
    for link in unseen:
        q_link[:, link.joint] = np.interp(recording.time, samples.time,
                                          samples.readings[:, 0, link.joint])
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


def held_torque(recording, time, period) -> np.ndarray:
    """Return the torque held from even times on (T, n) [N m]: commands, or efforts reported."""
    if recording.has_commands:
        torque = held(recording.command)
    elif np.isfinite(recording.tau_motor).mean() > COVERED:
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
    return analysis.means_held(torque, until, np.append(time, time[-1] + period))


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


_OF_TORQUE = ('swapped_torques', 'swapped_sides', 'torque_sign', 'torque_scale', 'unexplained')


def faults_of(recordings, robot) -> list:
    """Return the findings of `recording_checks` in what equations will use, the worst first."""
    found = [finding for recording in recordings for finding in _faults(recording, robot)]
    return sorted(found, key=lambda finding: finding.severity != 'refuse')


def _faults(recording, robot):
    """Return the findings of one recording."""
    absent = absent_joints(recording, robot)
    if absent:
        return absent
    recording = recording.of_joints(robot.joints)
    timing = [*sampling_checks.length(recording), *sampling_checks.clock(recording)]
    if any(finding.severity == 'refuse' for finding in timing):
        return timing  # nothing can be computed along such a time
    recording = with_links(recording, robot)
    if recording.has_currents and robot.arm.kind == 'decoupled':
        recording = replace(recording, scale_sd=0.0)  # of the robot file as well
    load = recording.operation.load
    if load is not None and not why_not_carried(load, robot.arm):
        robot = replace(robot, arm=carrying(robot.arm, load))
        recording = replace(recording, operation=recording.operation._replace(load=None))
    if not recording.has_commands:
        return list(check(recording, robot))
    efforts = np.isfinite(recording.tau_motor).any(axis=0)
    commanded = [joint for joint, known in zip(recording.joints, efforts, strict=True)
                 if not known]
    # a command is all that was asked for, clipped or not
    checked = _with_commands(recording, commanded)
    found = [finding for finding in check(checked, robot)
             if finding.kind != 'saturated' or finding.joint not in commanded]
    return found + _of_commands(checked, robot, found)


def _of_commands(recording, robot, found):
    """Return findings of commands that stand beside efforts and are not among those ``found``."""
    other = _with_commands(recording, recording.joints)
    if np.array_equal(other.tau_motor, recording.tau_motor, equal_nan=True):
        return []  # looked over already
    named = {(finding.kind, finding.joint) for finding in found}
    return [finding._replace(text=f'{finding.text} (of its torque commands, which the equations '
                             'take)')
            for finding in check(other, robot)
            if finding.kind in _OF_TORQUE and (finding.kind, finding.joint) not in named]


def _with_commands(recording, joints):
    """Return a Recording with commands, of the sample that ended, as the efforts of joints."""
    torque = recording.tau_motor.copy()
    columns = [recording.joints.index(joint) for joint in joints]
    torque[1:, columns] = held(recording.command)[:-1, columns]
    return replace(recording, tau_motor=torque)
