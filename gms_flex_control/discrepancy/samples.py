# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A recording at even times: angles with their derivatives, torques held, as the equations need it.

Links without encoders are computed (`identification.unseen_links`), corrected for each model by
what its motor equation leaves.

Faults of the data, which no physics can mend, are looked for before any of that.
"""

from dataclasses import dataclass, replace
from typing import Self

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import even_time, held, held_torque, resampled
from gms_flex_control.errors import BagError
from gms_flex_control.identification import sampling_checks
from gms_flex_control.identification.check_basis import absent_joints, Fault
from gms_flex_control.identification.recording_checks import check, OF_ALL, of_all
from gms_flex_control.identification.unseen_links import unseen_links, with_links
from gms_flex_control.params.arm import at_last_link, Body, carrying, why_not_carried
import numpy as np
from scipy.ndimage import minimum_filter1d

_FINE = 20.0           # times a count's own noise: smaller steps are not those of an encoder
_LONGEST_HOLE = 5.5    # samples: readings farther apart are not bridged
_SETTLED = 0.3         # after a hole, until friction is that of the motion seen [s]


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
            readings[:, side, j] = resampled(recording, angles[:, j], time,
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
        j = link.joint
        readings[:, 0, j] = link.angle(readings[:, 1, j], command[:, j], period)
    noise = np.sqrt(np.mean(np.diff(readings, 3, axis=0) ** 2, axis=0) / 20.0)
    states = np.stack(analysis.derivatives(
        readings, period, analysis.odd_window(analysis.RATE_WINDOW / period)), axis=2).reshape(
        len(time), 6, len(joints))
    return Samples(tuple(joints), time, period, readings, np.ascontiguousarray(states), noise,
                   np.ones(len(time), dtype=bool), command, supply, commanded, source, unseen)


def encoder_step(angle, noise) -> float:
    """Return the count of an encoder by its readings (T,) [rad], 0 if they have no steps."""
    step = analysis.quantum(angle)
    return step if noise < _FINE * step / np.sqrt(12.0) else 0.0


def _in_hole(read, time, period):
    """Return which times (T,) lie in holes between the times (K,) of readings [s], bool."""
    if len(read) == 0:
        return np.ones(len(time), dtype=bool)
    after = np.searchsorted(read, time, side='left')
    before, after = read[np.maximum(after - 1, 0)], read[np.minimum(after, len(read) - 1)]
    off = np.minimum(np.abs(time - before), np.abs(time - after))
    return (np.maximum(after - before, off) > _LONGEST_HOLE * period) & (off > 0.0)


_OF_TORQUE = ('swapped_torques', 'swapped_sides', 'torque_sign', 'torque_scale', 'unexplained')


def faults_of(recordings, robot, holdout=()) -> list:
    """Return the faults of `recording_checks` in what equations will use, the worst first."""
    found = [fault for recording in (*recordings, *holdout)
             for fault in _faults(recording, robot)]
    if not any(fault.severity == 'refuse' for fault in found):
        found = [fault for fault in found if fault.kind not in OF_ALL] + of_all(
            [with_links(one.of_joints(robot.joints), robot) for one in recordings], robot)
    return sorted(found, key=lambda fault: fault.severity != 'refuse')


def _faults(recording, robot):
    """Return the faults of one recording."""
    absent = absent_joints(recording, robot)
    if absent:
        return absent
    recording = recording.of_joints(robot.joints)
    timing = [*sampling_checks.length(recording), *sampling_checks.clock(recording)]
    if any(fault.severity == 'refuse' for fault in timing):
        return timing  # nothing can be computed along such a time
    torque = recording.command if recording.has_commands else recording.tau_motor[2:]
    if np.isfinite(torque).all() and not np.ptp(torque, axis=0).any():
        return [Fault('missing', '', 'refuse', (
            f'{recording.source}: no torque ever changes, as where a driver reports none; record '
            'efforts or commands (a robot that nothing drives: --force)'))]
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
    found = [fault for fault in check(checked, robot)
             if fault.kind != 'saturated' or fault.joint not in commanded]
    return found + _of_commands(checked, robot, found)


def _of_commands(recording, robot, found):
    """Return faults of commands that stand beside efforts and are not among those ``found``."""
    other = _with_commands(recording, recording.joints)
    if np.array_equal(other.tau_motor, recording.tau_motor, equal_nan=True):
        return []  # looked over already
    named = {(fault.kind, fault.joint) for fault in found}
    return [fault._replace(text=f'{fault.text} (of its torque commands, which the equations take)')
            for fault in check(other, robot)
            if fault.kind in _OF_TORQUE and (fault.kind, fault.joint) not in named]


def _with_commands(recording, joints):
    """Return a Recording with commands, of the sample that ended, as the efforts of joints."""
    torque = recording.tau_motor.copy()
    columns = [recording.joints.index(joint) for joint in joints]
    torque[1:, columns] = held(recording.command)[:-1, columns]
    return replace(recording, tau_motor=torque)
