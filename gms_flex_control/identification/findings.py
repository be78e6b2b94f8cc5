# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a check says, and the channels all checks look at."""

from typing import NamedTuple

import numpy as np


class Finding(NamedTuple):
    """One fault of a recording."""

    kind: str      # see `gms_flex_control.identification.checks`
    joint: str     # link name, '' if it concerns all
    severity: str  # 'refuse': a fit would be wrong; 'warn': a fit is possible, less is known
    text: str      # a sentence: what, where, the value, the way out


class Signals(NamedTuple):
    """The channels of a recording, joints in the order of the robot; arrays (T,) and (T, n)."""

    source: str
    joints: tuple
    time: np.ndarray
    period: float
    q_link: np.ndarray
    dq_link: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    tau_motor: np.ndarray
    command: np.ndarray

    def sides(self, joint):
        """Yield (name, angle, rate) of each side that was recorded of a joint's number."""
        for name, q, dq in (('link', self.q_link, self.dq_link),
                            ('motor', self.q_motor, self.dq_motor)):
            if np.isfinite(q[:, joint]).any():
                yield name, q[:, joint], dq[:, joint]


def signals_of(recording, robot):
    """
    Return the channels of the robot's joints, whatever the order in the recording.

    Parameters
    ----------
    recording : Recording
        With all joints of the robot, see `absent_joints`.
    robot : RobotParams
        What was recorded.

    Returns
    -------
    Signals

    """
    order = [recording.joints.index(joint) for joint in robot.joints]
    same = order == list(range(len(recording.joints)))
    channels = (getattr(recording, name) if same else getattr(recording, name)[:, order]
                for name in Signals._fields[4:])
    return Signals(recording.source, robot.joints, recording.time, recording.period, *channels)


def absent_joints(recording, robot):
    """Return a finding for the first joint of a robot that a Recording lacks."""
    for joint in robot.joints:
        if joint not in recording.joints:
            return [Finding('joint_names', joint, 'refuse', (
                f'{recording.source}: has no joint {joint!r}, it has '
                f'{", ".join(recording.joints)}; use the names of the recording in the robot '
                'file, or choose its joints when it is read'))]
    return []
