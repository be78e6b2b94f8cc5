# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Faults of the data, which no physics can mend: looked for before any of it."""

from dataclasses import replace

from gms_flex_control.discrepancy.path import has_commands, held, with_links
from gms_flex_control.identification.checks import check
import numpy as np


def faults_of(recordings, robot):
    """
    Return the findings of `identification.checks` in what the equations will use.

    Parameters
    ----------
    recordings : sequence of Recording
        Commands count as torque where no effort was recorded.
    robot : RobotParams
        As believed.

    Returns
    -------
    list of Finding
        Those that forbid a fit first.

    """
    found = []
    for recording in recordings:
        commanded = _commanded(recording)
        seen = with_links(recording, robot)
        if commanded:
            seen = _with_commands(seen, commanded)
        found += [finding for finding in check(seen, robot)
                  # a command is all that was asked for, clipped or not
                  if finding.kind != 'saturated' or finding.joint not in commanded]
    return sorted(found, key=lambda finding: finding.severity != 'refuse')


def _commanded(recording):
    """Return the joints of which commands are known and no efforts."""
    if not has_commands(recording):
        return []
    known = np.isfinite(recording.tau_motor).any(axis=0)
    return [joint for joint, has_effort in zip(recording.joints, known, strict=True)
            if not has_effort]


def _with_commands(recording, joints):
    """Return a Recording with commands, of the sample that ended, as the efforts of joints."""
    torque = recording.tau_motor.copy()
    columns = [recording.joints.index(joint) for joint in joints]
    torque[1:, columns] = held(recording.command)[:-1, columns]
    return replace(recording, tau_motor=torque)
