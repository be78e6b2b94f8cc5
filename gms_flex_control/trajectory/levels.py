# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""References for identification: velocities held one after another, torques reached slowly."""

from dataclasses import replace

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.trajectory.builders import at_rest, constant, hermite, polynomials
import numpy as np


def velocity_levels(velocities, durations, *, settle_time=0.5):
    """
    Return velocities held one after another between two rests.

    Parameters
    ----------
    velocities : ndarray, shape (m, n_joints)
        Signed velocities [rad/s]; joints with 0 stay.
    durations : ndarray, shape (m,)
        How long each is held [s].
    settle_time : float
        Duration of each change of velocity, also from and to rest [s].

    Returns
    -------
    Trajectory
        Begins at angle zero; smooth to the fourth derivative.

    """
    velocities = np.atleast_2d(np.asarray(velocities, dtype=float))
    durations = np.atleast_1d(np.asarray(durations, dtype=float))
    if len(durations) != len(velocities):
        raise TrajectoryError(f'{len(velocities)} velocities need as many durations, '
                              f'got {len(durations)}')
    if not (np.all(durations > 0) and settle_time > 0):
        raise TrajectoryError(f'durations and settle_time must be above 0, got '
                              f'{durations.tolist()} and {settle_time}')
    state = at_rest(np.zeros(velocities.shape[1]))
    starts, scales, polys, time = [], [], [], 0.0
    for velocity, duration in zip([*velocities, 0.0 * velocities[0]], [*durations, 1.0],
                                  strict=True):
        held = at_rest(state[0] + 0.5 * settle_time * (state[1] + velocity))
        held[1] = velocity
        line = constant(held[0])
        line[1] = velocity
        starts += [time, time + settle_time]
        scales += [settle_time, 1.0]
        polys += [hermite(state, held, settle_time), line]
        time += settle_time + duration
        state = held.copy()
        state[0] += velocity * duration
    return polynomials(starts, scales, polys, end=starts[-1])


def torque_levels(levels, rate):
    """
    Return open-loop torques from zero through levels and back to zero, without a kink.

    Parameters
    ----------
    levels : ndarray, shape (m, n_joints)
        Torques to turn at [N m].
    rate : float
        Mean slope between two levels of the joint that changes most [N m/s]; the steepest is
        2.5 times that, and at each level it is zero: a torque that jumps, or whose slope does,
        makes a motor on a spring ring.

    Returns
    -------
    Trajectory
        Of quantity 'effort'.

    """
    if not rate > 0:
        raise TrajectoryError(f'rate must be above 0, got {rate}')
    levels = np.atleast_2d(np.asarray(levels, dtype=float))
    zero = np.zeros((1, levels.shape[1]))
    points = np.vstack([zero, levels, zero])
    starts, scales, polys, time = [], [], [], 0.0
    for begin, end in zip(points[:-1], points[1:], strict=True):
        duration = np.max(np.abs(end - begin)) / rate
        if duration > 0.0:
            starts, scales = [*starts, time], [*scales, duration]
            polys = [*polys, hermite(at_rest(begin), at_rest(end), duration)]
            time += duration
    return polynomials([*starts, time], [*scales, 1.0], [*polys, constant(zero[0])], end=time,
                       quantity='effort')


def displaced(trajectory, offset):
    """Return ``trajectory`` with ``offset`` (n_joints,) added to its angle or torque."""
    poly = trajectory.poly.copy()
    poly[:, 0, :] += np.asarray(offset, dtype=float)
    return replace(trajectory, poly=poly)
