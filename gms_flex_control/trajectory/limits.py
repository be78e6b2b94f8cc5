# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Motions that go beyond what the URDF of a robot allows are refused."""

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.params.arm import Frames
from gms_flex_control.trajectory.segments import Trajectory
import numpy as np

_STEP = 2e-3       # between the times at which a motion is checked [s]
_ROUNDING = 1e-6   # beyond a limit, relative


def require_within(trajectory: Trajectory, joints, frames: Frames | None, offset) -> None:
    """
    Raise TrajectoryError if a motion leaves the position or velocity limits of a URDF.

    ``offset`` (n_joints,) is what the URDF adds to the angles of the robot ``joints``. A robot
    that stands beyond a limit may move inwards. Without frames there are no limits; an open-loop
    torque is not checked.
    """
    if frames is None or trajectory.quantity != 'motion':
        return
    turning = trajectory.amplitude[-1] != 0.0
    last = (2.0 * np.pi / np.abs(trajectory.omega[-1][turning])).max(initial=0.0)
    begin, end = trajectory.start[0], trajectory.start[-1] + last
    time = np.append(np.arange(begin, end, _STEP), end)
    angle, rate = np.moveaxis(trajectory.sample(time)[:, :2], 1, 0)
    angle = angle + offset
    for j, joint in enumerate(joints):
        unit = 'm' if frames.prismatic[j] else 'rad'
        upper, lower = max(frames.upper[j], angle[0, j]), min(frames.lower[j], angle[0, j])
        fastest = frames.velocity[j]
        for verb, values, limit, beyond, per in (
                ('goes to', angle[:, j], upper, angle[:, j] - upper, ''),
                ('goes to', angle[:, j], lower, lower - angle[:, j], ''),
                ('moves at', rate[:, j], fastest, np.abs(rate[:, j]) - fastest, '/s')):
            k = np.argmax(beyond)
            if beyond[k] > _ROUNDING * abs(limit):
                raise TrajectoryError(
                    f'{joint} {verb} {values[k]:.4g} {unit}{per} at {time[k] - begin:.3g} s, '
                    f'beyond its limit of {limit:.4g} {unit}{per} in {frames.source}; reduce the '
                    'motion of that joint, or give it more time')
