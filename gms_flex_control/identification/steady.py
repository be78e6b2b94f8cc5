# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction against velocity at steady motion, and the Stribeck curve through it (Fig. 3)."""

from typing import NamedTuple

from gms_flex_control.dynamics.chain import inverse_dynamics
import numpy as np
from scipy.optimize import least_squares, nnls

_WINDOW = 0.25      # of one point of the map [s]
_UNSTEADY = 0.25    # relative change of velocity within a window that still counts as steady
_SLOWEST_STEPS = 3  # encoder steps a window must travel
_FEWEST = 4         # points of a direction for a Stribeck curve; below, Coulomb and viscous only
_DROP, _NARROW = 0.1, 0.02  # of F_c and of the top velocity: F_s - F_c and v_s of a straight curve
_LEAST = 0.05       # of the largest torque: F_c of a straight curve


class FrictionMap(NamedTuple):
    """Mean friction torque in windows of motion."""

    velocity: np.ndarray  # (W,) [rad/s]
    torque: np.ndarray    # (W,) [N m]
    steady: np.ndarray    # (W,) bool, the velocity hardly changes


class Stribeck(NamedTuple):
    """Steady friction of one direction, Eq. (6)."""

    static: float    # F_s [N m]
    coulomb: float   # F_c [N m]
    velocity: float  # v_s [rad/s]
    viscous: float   # sigma_2 [N m s/rad]


def friction_torque(stretch, arm):
    """
    Return the friction torque of each link by its equation of motion.

    Parameters
    ----------
    stretch : Stretch
        Smoothed without lag.
    arm : ArmParams
        Inertia and gravity; rigid where the motor's torque drives the link.

    Returns
    -------
    ndarray, shape (T, n_joints)
        Torque that opposes positive motion [N m].

    Notes
    -----
    Eq. (1), link: ``F_f = K (q2 - q1) - M q1'' - C q1' - g``.

    """
    angle = filled(stretch.angle)
    torque = 0.5 * (stretch.torque + np.roll(stretch.torque, 1, axis=0))  # at the sample
    torque[0] = stretch.torque[0]
    return torque - inverse_dynamics(angle, stretch.rate, stretch.acceleration, arm)


def filled(angle):
    """Return angles (T, n) with gaps interpolated."""
    found = angle.copy()
    rows = np.arange(len(angle))
    for j in range(angle.shape[1]):
        lost = ~np.isfinite(angle[:, j])
        found[lost, j] = np.interp(rows[lost], rows[~lost], angle[~lost, j])
    return found


def friction_map(stretches, arm, joint, period, half):
    """
    Return the friction of one joint in short windows of motion in one direction.

    Parameters
    ----------
    stretches : sequence of Stretch
        All data.
    arm : ArmParams
        The arm.
    joint : int
        Which joint.
    period : float
        Sample [s].
    half : float
        Half an encoder count [rad].

    Returns
    -------
    FrictionMap

    """
    size = max(round(_WINDOW / period), 4)
    rows = []
    for stretch in stretches:
        torque = friction_torque(stretch, arm)[:, joint]
        rate, tested = stretch.rate[:, joint], stretch.tested[:, joint]
        angle = filled(stretch.angle[:, joint:joint + 1])[:, 0]
        count = len(rate) // size
        if not count:
            continue
        cut = slice(0, count * size)
        rates = rate[cut].reshape(count, size)
        travel = np.ptp(angle[cut].reshape(count, size), axis=1)
        mean = rates.mean(axis=1)
        spread = np.ptp(rates, axis=1)
        one_way = (np.abs(rates).min(axis=1) > 0.0) & (np.abs(np.sign(rates).sum(axis=1)) == size)
        good = one_way & (travel > 2 * _SLOWEST_STEPS * half) & tested[cut].reshape(
            count, size).all(axis=1)
        steady = spread < _UNSTEADY * np.abs(mean) + 4.0 * half / _WINDOW
        middle = torque[cut].reshape(count, size).mean(axis=1)
        rows.append(np.stack([mean, middle, steady], axis=1)[good])
    table = np.concatenate(rows) if rows else np.zeros((0, 3))
    return FrictionMap(table[:, 0], table[:, 1], table[:, 2] > 0)


def fit_stribeck(velocity, torque):
    """
    Fit the steady friction of one direction.

    Parameters
    ----------
    velocity, torque : ndarray, shape (W,)
        Absolute values [rad/s, N m].

    Returns
    -------
    Stribeck
        All positive; without enough points static equals coulomb.

    Notes
    -----
    Eq. (6), by trust-region least squares with a soft-L1 loss (section 4's LSQCURVEFIT).

    """
    top, level = velocity.max(), max(float(np.median(torque)), 1e-12)
    slow = max(float(np.quantile(velocity, 0.1)), 1e-9)
    if len(velocity) < _FEWEST:
        return Stribeck(1.02 * level, level, slow, 1e-3 * level / top)
    scale = np.array([level, level, 1.0, level / top])
    noise = max(1.5 * float(np.median(np.abs(torque - np.median(torque)))), 1e-3 * level)

    def residual(x):
        coulomb, viscous = x[0] * level, x[3] * level / top
        drop = x[1] * coulomb  # at most F_s = 2 F_c: else a curve that bends is no Stribeck curve
        decay = np.exp(-np.minimum((velocity / np.exp(x[2])) ** 2, 50.0))
        return coulomb + drop * decay + viscous * velocity - torque

    best = None
    for start in np.geomspace(slow, top, 4):
        fit = least_squares(
            residual, [0.9, 0.1, np.log(start), 0.1], loss='soft_l1', f_scale=0.3 * noise,
            bounds=([1e-3, 1e-4, np.log(0.3 * slow), 0.0], [3.0, 1.0, np.log(top), 3.0]))
        if best is None or fit.cost < best.cost:
            best = fit
    coulomb = best.x[0] * scale[0]
    drop = best.x[1] * coulomb
    return Stribeck(coulomb + drop, coulomb, float(np.exp(best.x[2])), best.x[3] * scale[3])


def straight(velocity, torque):
    """
    Return Coulomb and viscous friction of one direction, its Stribeck part narrow.

    Parameters
    ----------
    velocity, torque : ndarray, shape (W,)
        Absolute values [rad/s, N m].

    Returns
    -------
    Stribeck
        Where friction falls with velocity, without viscous part.

    """
    top = velocity.max()
    level, rise = nnls(np.stack([np.ones(len(velocity)), velocity / top], axis=1), torque)[0]
    level = max(level, _LEAST * float(np.abs(torque).max()), 1e-12)
    return Stribeck((1.0 + _DROP) * level, level, _NARROW * top, max(rise, 1e-3 * level) / top)


def repeatability(stretches, phases, arm, joint):
    """
    Return how much the friction of repeated equal motion differs.

    Parameters
    ----------
    stretches : sequence of Stretch
        All data.
    phases : sequence of sequence of Phase
        Of each recording; steps of one joint, phase and value are repeats.
    arm : ArmParams
        The arm.
    joint : int
        Which joint.

    Returns
    -------
    float
        Standard deviation of the mean friction torque among repeats [N m]; NaN without any.

    """
    groups = {}
    for stretch in stretches:
        owned = stretch.tested[:, joint]
        steady = owned & (stretch.phase == 'constant_velocity')
        if not steady.any():
            continue
        torque, rate = friction_torque(stretch, arm)[:, joint], stretch.rate[:, joint]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(np.int8), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            speeds = rate[begin:end]
            typical = np.median(speeds)
            near = np.abs(speeds - typical) < 0.1 * abs(typical)
            if near.sum() > 10:
                key = round(float(np.sign(typical)) * np.log(abs(typical)) * 10.0)
                groups.setdefault((np.sign(typical), key), []).append(
                    torque[begin:end][near].mean())
    spreads = [np.var(values, ddof=1) for values in groups.values() if len(values) > 1]
    return float(np.sqrt(np.mean(spreads))) if spreads else float('nan')
