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
clock               stamps are uneven or in another unit
dropped             samples are missing
missing             channels, or parts of them, are no number
angle_unit          angles are in degrees
still               a joint never moves
one_direction       a joint moves one way only
jump                an angle jumps
frozen              samples are repeated while a joint moves
velocity            a velocity is not the derivative of its angle
saturated           the torque is clipped while a joint moves
swapped_torques     the torques of two joints are exchanged
swapped_sides       motor and link are exchanged
side_scale          the motor angle has another scale or sign than the link's
torque_sign         the torque is reversed
torque_scale        the torque is off by a factor
unexplained         the torque does not belong to the motion
load                a load on an arm that is not one of a URDF
coupling            coupled motors on an arm that is not one of a URDF
==================  =============================================================
"""

from dataclasses import replace

from gms_flex_control.data.recording import Recording
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification import sampling_checks, torque_checks
from gms_flex_control.identification.check_basis import absent_joints, Finding
from gms_flex_control.params.arm import carrying
from gms_flex_control.params.robot import RobotParams


def check(recording: Recording, robot: RobotParams, rough=False) -> tuple[Finding, ...]:
    """
    Return the findings of one experiment, faults of time first, since they hide the others.

    Of the robot is used which joints are flexible, stiffness within a factor of 4, inertia within
    one of 3, no friction; ``rough`` says that both are placeholders, for instance because they
    are to be estimated.
    """
    absent = absent_joints(recording, robot)
    if absent:
        return tuple(absent)
    signals = recording.of_joints(robot.joints)
    load, load_unknown, _ = signals.operation
    if (load is not None or load_unknown) and robot.arm.frames is None:
        return (Finding('load', robot.joints[-1], 'refuse', (
            f'{recording.source}: has a load, which needs an arm of a URDF; write the robot file '
            'with arm.kind: urdf, or add the load to its last link')),)
    if recording.coupling is not None and robot.arm.frames is None:
        return (Finding('coupling', robot.joints[-1], 'refuse', (
            f'{recording.source}: has coupled motors, whose friction needs an arm of a URDF; '
            'write the robot file with arm.kind: urdf')),)
    robot = replace(robot, arm=carrying(robot.arm, load))
    found = [*sampling_checks.length(signals), *sampling_checks.clock(signals),
             *sampling_checks.missing(signals, robot)]
    if any(finding.severity == 'refuse' for finding in found):
        return tuple(found)
    found += sampling_checks.units(signals, robot)
    if any(finding.kind == 'angle_unit' for finding in found):
        return tuple(found)
    found += sampling_checks.broken(signals)
    if any(finding.kind == 'jump' for finding in found):
        return tuple(found)
    found += sampling_checks.motion(signals)
    found += sampling_checks.rates(signals)
    found += torque_checks.saturated(signals)
    if not any(finding.kind == 'velocity' for finding in found):
        loose = [joint for joint, sd in zip(signals.joints, signals.scale_sd, strict=True) if sd]
        found += [one for one in torque_checks.physics(signals, robot, rough or bool(loose))
                  if one.kind != 'torque_scale' or one.joint not in loose]
    return tuple(found)


def require(recording: Recording, robot: RobotParams, force=False, rough=False) -> list:
    """
    Return the warnings of `check`, with ``force`` all findings.

    Raises IdentificationError with the sentence of the first fault that forbids a fit.
    """
    found = check(recording, robot, rough)
    for finding in found:
        if finding.severity == 'refuse' and not force:
            raise IdentificationError(finding.text)
    return found
