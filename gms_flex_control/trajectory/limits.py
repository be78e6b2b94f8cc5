# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Position and velocity limits of a URDF for a reference: bounded first, sampled where needed."""

from functools import cache
from math import comb

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.params.arm import Frames
from gms_flex_control.trajectory.segments import COEFFICIENTS, DEGREE, Trajectory
import numpy as np

_STEP = 2e-3       # between the times at which a motion is sampled [s]
_MOST = 500        # samples of a polynomial, however long it lasts
_ROUNDING = 1e-6   # beyond a limit, relative
_PIECES = 8        # of a polynomial, each of which is bounded by its Bernstein coefficients


def require_within(trajectory: Trajectory, joints, frames: Frames | None, offset, *,
                   segments: int | None = None) -> None:
    """
    Raise TrajectoryError if a motion leaves the position or velocity limits of a URDF.

    ``offset`` (n_joints,) is what the URDF adds to the angles of the robot ``joints``. A robot
    that stands beyond a limit may move inwards. Without frames there are no limits; an open-loop
    torque is not checked. ``segments`` checks only so many at the beginning.

    Notes
    -----
    A polynomial lies between the least and the largest of its Bernstein coefficients. Only
    segments that these do not prove to be within the limits are sampled.

    """
    if frames is None or trajectory.quantity != 'motion':
        return
    begin = trajectory.sample(trajectory.start[0])[0] + offset
    upper, lower = np.maximum(frames.upper, begin), np.minimum(frames.lower, begin)
    duration = _durations(trajectory)[:segments]
    least, most, fastest = _bounds(trajectory, duration)
    doubtful = ((most + offset > upper) | (least + offset < lower)
                | (fastest > frames.velocity)).any(axis=1)
    for m in np.flatnonzero(doubtful):
        count = max(2, int(np.ceil(duration[m] / _STEP)) + 1)
        if not trajectory.amplitude[m].any():
            count = min(count, _MOST)
        time = trajectory.start[m] + np.linspace(0.0, duration[m], count)
        _judge(trajectory, time, joints, frames, offset, upper, lower)


def _judge(trajectory, time, joints, frames, offset, upper, lower):
    """Raise TrajectoryError for the first joint that is beyond a limit at one of the times."""
    angle, rate = np.moveaxis(trajectory.sample(time)[:, :2], 1, 0)
    angle = angle + offset
    for j, joint in enumerate(joints):
        unit = 'm' if frames.prismatic[j] else 'rad'
        fastest = frames.velocity[j]
        for verb, values, limit, beyond, per in (
                ('goes to', angle[:, j], upper[j], angle[:, j] - upper[j], ''),
                ('goes to', angle[:, j], lower[j], lower[j] - angle[:, j], ''),
                ('moves at', rate[:, j], fastest, np.abs(rate[:, j]) - fastest, '/s')):
            k = np.argmax(beyond)
            if beyond[k] > _ROUNDING * abs(limit):
                raise TrajectoryError(
                    f'{joint} {verb} {values[k]:.4g} {unit}{per} at '
                    f'{time[k] - trajectory.start[0]:.3g} s, beyond its limit of {limit:.4g} '
                    f'{unit}{per} in {frames.source}; reduce the motion of that joint, or give '
                    'it more time')


def _durations(trajectory):
    """Return how long each segment lasts (m,), the last one a period of its sinusoid [s]."""
    turning = trajectory.amplitude[-1] != 0.0
    last = (2.0 * np.pi / np.abs(trajectory.omega[-1][turning])).max(initial=0.0)
    return np.append(np.diff(trajectory.start), last)


def _bounds(trajectory, duration):
    """Return least and most value and largest rate of the first segments, each (m, n_joints)."""
    m = len(duration)
    scale = trajectory.scale[:m, None, None]
    reach = (duration[:, None] / trajectory.scale[:m, None]) ** np.arange(COEFFICIENTS)
    poly = trajectory.poly[:m]
    shape, amplitude = trajectory.envelope[:m, :, None], np.abs(trajectory.amplitude[:m])
    value, rate, envelope, change = (
        _hull() @ (coefficients * reach[:, :, None]) for coefficients in (
            poly, _derivative(poly) / scale, shape, _derivative(shape) / scale))
    wave = np.abs(envelope).max(axis=1) * amplitude
    turn = np.abs(change).max(axis=1) * amplitude + wave * np.abs(trajectory.omega[:m])
    return (value.min(axis=1) - wave, value.max(axis=1) + wave, np.abs(rate).max(axis=1) + turn)


def _derivative(coefficients):
    """Return the coefficients (m, 10, n) of the derivative of polynomials."""
    powers = np.arange(1, COEFFICIENTS)[:, None]
    return np.concatenate([coefficients[:, 1:] * powers, 0.0 * coefficients[:, :1]], axis=1)


@cache
def _hull():
    """Return the matrix from coefficients on [0, 1] to Bernstein coefficients of all pieces."""
    powers = range(COEFFICIENTS)
    bernstein = np.array([[comb(i, k) / comb(DEGREE, k) for k in powers] for i in powers])
    pieces = [np.array([[comb(p, k) * piece ** (p - k) / _PIECES ** p if p >= k else 0.0
                         for p in powers] for k in powers]) for piece in range(_PIECES)]
    return np.concatenate([bernstein @ piece for piece in pieces])
