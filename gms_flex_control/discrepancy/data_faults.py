# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Faults of the data, which no physics can mend: looked for before any of it."""

from dataclasses import replace

from gms_flex_control.discrepancy.samples import has_commands, held, with_links
from gms_flex_control.identification import sampling_checks
from gms_flex_control.identification.check_basis import absent_joints
from gms_flex_control.identification.recording_checks import check
from gms_flex_control.params.arm import carrying, why_not_carried
import numpy as np

_OF_TORQUE = ('swapped_torques', 'swapped_sides', 'torque_sign', 'torque_scale', 'unexplained')


def faults_of(recordings, robot) -> list:
    """
    Return the findings of `identification.recording_checks` in what the equations will use.

    Those that forbid a fit first. Recordings may have joints in any order; torque commands are
    checked beside efforts, or instead of them.
    """
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
    if not has_commands(recording):
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
