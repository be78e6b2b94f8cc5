# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Faults of a recording that would make a fit wrong, found before any fit.

==================  =============================================================
kind                what is wrong
==================  =============================================================
joint_names         a joint of the robot is not in the recording
too_short           too few samples or seconds
clock               stamps jump, are out of order or in another unit
dropped             samples are missing
missing             channels, or parts of them, are no number
still               a joint never moves
one_direction       a joint moves one way only
jump                an angle jumps
frozen              samples are repeated while a joint moves
velocity            a velocity is not the derivative of its angle
saturated           the torque is clipped while a joint moves
swapped_joints      two joints are exchanged, as a whole or in some channels
swapped_sides       motor and link are exchanged
side_scale          the motor angle has another scale or sign than the link's
torque_sign         the torque is reversed
torque_scale        the torque is off by a factor
unexplained         the torque does not belong to the motion
==================  =============================================================
"""

from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification import clock_checks, motion_checks, torque_checks
from gms_flex_control.identification.findings import absent_joints, Finding, signals_of

__all__ = ['check', 'Finding', 'require']


def check(recording, robot, rough=False):
    """
    Look a recording over.

    Parameters
    ----------
    recording : Recording
        One experiment.
    robot : RobotParams
        Roughly the robot: which joints are flexible, stiffness within a factor of 4, inertia
        within one of 3. Friction is not used.
    rough : bool
        Inertia and stiffness are placeholders, for instance because they are to be estimated.

    Returns
    -------
    tuple of Finding
        Empty for a healthy recording; faults of time first, since they hide the others.

    """
    absent = absent_joints(recording, robot)
    if absent:
        return tuple(absent)
    signals = signals_of(recording, robot)
    found = [*motion_checks.length(signals), *clock_checks.clock(signals),
             *motion_checks.missing(signals, robot)]
    if any(finding.severity == 'refuse' for finding in found):
        return tuple(found)
    found += motion_checks.broken(signals)
    if any(finding.kind == 'jump' for finding in found):
        return tuple(found)
    found += motion_checks.motion(signals)
    found += motion_checks.rates(signals)
    found += torque_checks.saturated(signals)
    if not any(finding.kind == 'velocity' for finding in found):
        found += torque_checks.physics(signals, robot, rough)
    return tuple(found)


def require(recording, robot, force=False, rough=False):
    """
    Refuse a recording with which a fit would be wrong.

    Parameters
    ----------
    recording : Recording
        One experiment.
    robot : RobotParams
        Roughly the robot.
    force : bool
        Go on whatever was found.
    rough : bool
        See `check`.

    Returns
    -------
    tuple of Finding
        The warnings; with ``force`` all findings.

    Raises
    ------
    IdentificationError
        With the sentence of the first fault that forbids a fit.

    """
    found = check(recording, robot, rough)
    for finding in found:
        if finding.severity == 'refuse' and not force:
            raise IdentificationError(finding.text)
    return found
