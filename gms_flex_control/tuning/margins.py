# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Gain, phase and delay margins of the sampled loop, and what encoder noise does in it."""

from itertools import product
from typing import NamedTuple

from gms_flex_control.dynamics import chain
from gms_flex_control.tuning.linear_loop import law_of, linear_loop
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

_GRID = 400              # frequencies up to half the sample rate
_LOWEST = 0.05           # of them [rad/s]
_MOST_SAMPLES = 50.0     # of delay that are looked at
_HALVINGS = 12
_MOST_POSES = 27
_POSES_IN_SPACE = 6  # each takes seconds with seven joints


class JointMargins(NamedTuple):
    """
    How much one joint's loop bears, the others closed.

    ``gain_up`` and ``gain_down`` are the factors on the torque at which the loop gets
    unstable (infinite and 0 where none does), ``phase`` the least turn of it [rad],
    ``distance`` the least abs(1 + L), ``crossover`` the highest frequency at which
    abs(L) = 1 [rad/s].
    """

    gain_up: float
    gain_down: float
    phase: float
    distance: float
    crossover: float


class Jitter(NamedTuple):
    """What encoders leave at rest, standard deviations (n,): torque [N m] and angle [rad]."""

    torque: np.ndarray
    angle: np.ndarray


def poses(arm):
    """
    Return the poses in which an arm is looked at.

    Parameters
    ----------
    arm : ArmParams
        The arm.

    Returns
    -------
    list of ndarray, shape (n_joints,)
        Angles of a coarse grid from stretched to folded [rad]; where there is gravity the
        first joint turns too. Decoupled axes without gravity have one pose, chains in space a few
        spread over the ranges of their joints.

    """
    n = arm.n_joints
    if arm.kind == 'urdf':
        return list(chain.configurations(arm, _POSES_IN_SPACE))
    turning = [arm.kind == 'planar'] * n
    turning[0] = False
    if np.any(arm.gravity != 0.0):
        turning = [True] * n
    count = sum(turning)
    if not count:
        return [np.zeros(n)]
    angles = np.linspace(0.0, np.pi, 5 if count == 1 else 3)
    if np.any(arm.gravity != 0.0):
        angles = np.append(angles, -np.pi / 2.0)
    grid = product(*(angles if turns else [0.0] for turns in turning))
    return [np.array(pose) for pose, _ in zip(grid, range(_MOST_POSES), strict=False)]


def open_loop(loop, joint, frequencies):
    """
    Return the frequency response of one joint's loop, the others closed.

    Parameters
    ----------
    loop : LinearLoop
        The loop.
    joint : int
        Where it is cut.
    frequencies : ndarray, shape (F,)
        [rad/s], up to pi over the period.

    Returns
    -------
    ndarray, shape (F,)
        L, complex; the closed loop is stable as Nyquist's criterion has it for 1 + L.

    """
    others = [i for i in range(loop.b.shape[1]) if i != joint]
    a = loop.a + loop.b[:, others] @ loop.c[others]
    points = np.exp(1j * np.asarray(frequencies) * loop.period)
    matrices = points[:, None, None] * np.eye(len(a)) - a
    right = np.broadcast_to(loop.b[:, [joint]].astype(complex), (len(points), len(a), 1))
    return -(np.linalg.solve(matrices, right)[..., 0] @ loop.c[joint])


def joint_margins(loop, joint):
    """
    Return the margins of one joint's loop.

    Parameters
    ----------
    loop : LinearLoop
        The loop, stable when closed.
    joint : int
        Where it is cut.

    Returns
    -------
    JointMargins

    """
    highest = np.pi / loop.period
    grid = np.geomspace(_LOWEST, highest, _GRID)
    grid[-1] = highest
    response = open_loop(loop, joint, grid)
    real = _crossings(loop, joint, grid, response, lambda values: values.imag)
    factors = [-1.0 / value for value in [*real[1].real, response[-1].real] if value < 0.0]
    unit = _crossings(loop, joint, grid, response, lambda values: np.abs(values) - 1.0)
    return JointMargins(
        gain_up=min((factor for factor in factors if factor > 1.0), default=np.inf),
        gain_down=max((factor for factor in factors if factor < 1.0), default=0.0),
        phase=float(np.abs(np.angle(-unit[1])).min(initial=np.pi)),
        distance=float(np.abs(1.0 + response).min()),
        crossover=float(unit[0].max(initial=0.0)))


def _crossings(loop, joint, grid, response, measure):
    """Return frequencies and responses where ``measure`` of the response is zero."""
    values = measure(response)
    places = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    low, high, left = grid[places], grid[places + 1], values[places]
    for _ in range(_HALVINGS if len(places) else 0):
        middle = np.sqrt(low * high)
        found = measure(open_loop(loop, joint, middle))
        same = found * left > 0.0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    middle = np.sqrt(low * high)
    return middle, open_loop(loop, joint, middle) if len(places) else np.zeros(0, complex)


def delay_margin(robot, model, gains, timing, pose):
    """
    Return the least further delay of all torques at which the loop is unstable.

    Parameters
    ----------
    robot, model, gains, timing, pose
        As for `linear_loop.linear_loop`; stable as it is.

    Returns
    -------
    float
        [s]; infinite where it is more than 50 samples.

    Notes
    -----
    Not read from the phase: the delay is put into the sampled loop, and its poles are computed.

    """
    law = law_of(model, gains, timing, pose)

    def stable(extra):
        late = timing._replace(delay=timing.delay + extra)
        return linear_loop(robot, model, gains, late, pose, law=law).stable

    low, high = 0.0, 0.25 * timing.period
    while stable(high):
        low, high = high, high + min(0.5 * timing.period + 0.1 * high, 5.0 * timing.period)
        if low > _MOST_SAMPLES * timing.period:
            return np.inf
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def jitter(loop, encoder):
    """
    Return what the encoders' noise and counts do to torque and links at rest.

    Parameters
    ----------
    loop : LinearLoop
        Stable when closed.
    encoder : EncoderParams
        Counts are taken as noise, equally spread within one and new at each sample.

    Returns
    -------
    Jitter

    """
    n = loop.b.shape[1]
    count = 2.0 * np.pi / float(encoder.counts) if encoder.counts > 0 else 0.0
    variance = float(encoder.noise) ** 2 + count ** 2 / 12.0
    entering = loop.noise + loop.b @ loop.through
    spread = solve_discrete_lyapunov(loop.closed, variance * entering @ entering.T)
    torque = np.einsum('ij,jk,ik->i', loop.c, spread, loop.c) + variance * np.sum(
        loop.through ** 2, axis=1)
    return Jitter(np.sqrt(torque), np.sqrt(np.diag(spread)[:n]))
