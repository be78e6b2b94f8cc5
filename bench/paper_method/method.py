# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The paper's identification (section 4), step by step, for comparison with the default method.

First the steady-state map (6) by nonlinear least squares (LSQCURVEFIT), torques at break-away
standing at zero velocity where (6) allows them there. Then the stiffnesses of N = 6 blocks of
equal weight by Nelder-Mead (FMINSEARCH) from torque over displacement in presliding. Then C of
(7) by linear least squares from sliding. Each step assumes the results of those before as exact.
"""

from typing import NamedTuple

from bench.paper_method.experiments import (
    believable,
    label,
    presliding_pieces,
    sliding_pieces,
    steady_points,
)
from gms_flex_control.compiled import compiled
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.coordinates import MOST_BLOCKS
from gms_flex_control.identification.outcome import Interval
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.simulation.predictor import ATTRACTION, BLOCKS, parameter_rows
import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.signal import detrend
from scipy.stats import t as student

N_BLOCKS = 6          # as in the paper
_FEWEST = 5           # points of the map in a direction
_STARTS = 5           # of v_s
_SLOWEST_TOLD = 0.5   # of the slowest motion: v_s below it leaves no trace in the map
_LARGEST_DROP = 2.0   # F_s - F_c, of the level
_EVALUATIONS = 6000   # of Nelder-Mead from one place
_RESTARTS = 4
_GAINED = 1e-3        # relative gain below which Nelder-Mead is not started again
_CHUNK = 1.6          # of sliding in which only changes are looked at [s]
_SLOWEST = 0.15       # least speed, of the mean, within it: no stop, no reversal
_SMALLEST = (1e-3, 1e-2, 0.1)  # least yields to begin with, of the travel


class PaperFit(NamedTuple):
    """What the paper's method found for one joint."""

    theta: np.ndarray   # (9 + 2 MOST_BLOCKS,), in the order of simulation.predictor
    intervals: tuple    # of Interval or None for each number of theta
    velocity: np.ndarray  # (W,) of the points of the map [rad/s], 0 for break-away
    torque: np.ndarray    # (W,) [N m]
    presliding: float   # rms error of the presliding torque [N m]


def fit_paper(segments, arm: ArmParams, joint: int, period: float, half: float) -> PaperFit:
    """
    Identify the friction of one joint as section 4 of the paper does.

    95 % intervals of the least-squares steps; none for the block stiffnesses. Phases follow
    from motion and torque where a segment names none; ``half`` is half an encoder count [rad].
    Raises IdentificationError if one of the three experiments is missing from the data.
    """
    theta, intervals = np.zeros(parameter_rows(MOST_BLOCKS, 0)), [None] * BLOCKS
    segments = [segment for segment in segments if segment.tested[:, joint].any()]
    data = (segments, [label(segment, arm, joint, period, half) for segment in segments], arm,
            joint, period)
    points = np.array(steady_points(*data, half))
    velocity, torque = points[:, believable(*points)]
    for row, sign in enumerate((1.0, -1.0)):
        rows = np.sign(torque) == sign
        speed = np.abs(velocity[rows])
        _require(len(np.unique(speed)) >= _FEWEST, segments, joint, 'a map of friction against '
                 f'velocity ({len(speed)} points {"backward" if row else "forward"})',
                 'constant velocities both ways')
        values, own = fit_map(speed, np.abs(torque[rows]))
        theta[4 * row:4 * row + 4], intervals[4 * row:4 * row + 4] = values, own
    pieces = presliding_pieces(*data)
    _require(pieces, segments, joint, 'presliding', 'slow torque ramps below break-away')
    stiffness, error = fit_stiffness(pieces, theta)
    theta[BLOCKS:BLOCKS + N_BLOCKS] = stiffness
    theta[BLOCKS + MOST_BLOCKS:BLOCKS + MOST_BLOCKS + N_BLOCKS] = 1.0 / N_BLOCKS
    pieces = sliding_pieces(*data)
    _require(pieces, segments, joint, 'sliding', 'motion of varying velocity without reversal')
    theta[ATTRACTION], intervals[ATTRACTION] = fit_attraction(pieces, theta, period)
    _require(theta[ATTRACTION] > 0.0, segments, joint, 'a lag of sliding friction (C would be '
             f'{theta[ATTRACTION]:.3g} N m/s)', 'sliding with velocity varied about v_s')
    return PaperFit(theta, (*intervals, *[None] * (len(theta) - BLOCKS)), velocity, torque, error)


def _require(found, segments, joint, what, way_out):
    if not found:
        source = segments[0].source if segments else 'no recording'
        raise IdentificationError(f"{source}: for joint {joint + 1} the paper's method lacks "
                                  f'{what}; record {way_out}, or use the default method')


def steady_torque(speed, static, coulomb, velocity, viscous) -> np.ndarray:
    """Return Eq. (6) at ``speed`` (W,), 0 or above [N m]."""
    decay = np.exp(-np.minimum((speed / velocity) ** 2, 50.0))
    return coulomb + (static - coulomb) * decay + viscous * speed


def fit_map(speed: np.ndarray, torque: np.ndarray) -> tuple[tuple, list[Interval]]:
    """
    Fit the steady friction of one direction by least squares.

    Absolute values (W,) [rad/s, N m]; speed 0 for torques at break-away. Returns F_s, F_c [N m],
    v_s [rad/s], sigma_2 [N m s/rad] and 95 % intervals from the Jacobian, of v_s symmetric in
    its logarithm.
    """
    top, level = speed.max(), np.median(torque)
    slowest = np.min(speed[speed > 0.0])

    def curve(x):
        coulomb, drop, velocity, viscous = level * x[0], level * x[1], np.exp(x[2]), x[3]
        return steady_torque(speed, coulomb + drop, coulomb, velocity, viscous * level / top)

    bounds = ([1e-3, 1e-6, np.log(_SLOWEST_TOLD * slowest), 0.0],
              [5.0, _LARGEST_DROP, np.log(top), 5.0])
    fits = [least_squares(
        lambda x: (curve(x) - torque) / level, [0.9, 0.1, np.log(start), 0.1], bounds=bounds)
        for start in np.geomspace(slowest, 0.5 * top, _STARTS)]
    fit = min(fits, key=lambda one: one.cost)
    freedom = max(len(speed) - 4, 1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * 2.0 * fit.cost / freedom
    scale = np.array([[level, level, 0, 0], [level, 0, 0, 0], [0, 0, 1, 0],
                      [0, 0, 0, level / top]])  # F_s, F_c, log v_s, sigma_2
    values = scale @ fit.x
    reach = student.ppf(0.975, freedom) * np.sqrt(np.diag(scale @ covariance @ scale.T))
    low, high = values - reach, values + reach
    for row in (values, low, high):
        row[2] = np.exp(np.clip(row[2], -50.0, 50.0))
    return tuple(values), [Interval(*pair) for pair in zip(low.tolist(), high.tolist(),
                                                           strict=True)]


@compiled
def load_blocks(displacement, level, stiffness, limit, first, torque) -> None:
    """
    Write the torque (T,) of slipping springs in parallel [N m], driven by displacement (T,).

    Displacement is from each sample to the next [rad], ``level`` (T,) that of the direction of
    motion, a block slips at the share ``limit`` of it; ``first`` is the torque at the beginning,
    shared by all blocks. Eqs. (2) and (5); in presliding a block that slips stays at its share.
    """
    blocks = stiffness.shape[0]
    load = np.full(blocks, first / blocks)
    for k in range(displacement.shape[0]):
        top, total = limit * level[k], 0.0
        for i in range(blocks):
            total += load[i]
            load[i] += stiffness[i] * displacement[k]
            if displacement[k] > 0.0 and load[i] > top:
                load[i] = top
            elif displacement[k] < 0.0 and load[i] < -top:
                load[i] = -top
        torque[k] = total


def fit_stiffness(pieces, theta: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return increasing block stiffnesses (N_BLOCKS,) [N m/rad] and the rms of the torque [N m].

    Fitted to torque over displacement of presliding pieces. A constant torque is left open in
    each: the load that blocks too soft to slip have kept from before.
    """
    inputs = []
    for piece in pieces:
        moved = np.append(np.diff(piece.angle), 0.0)
        level = _level(moved, piece.rate, theta)
        inputs.append((moved, level, piece.friction - _viscous_of(moved, theta) * piece.rate,
                       slice(piece.first, None)))
    travel = max(np.ptp(piece.angle[piece.first:]) for piece in pieces)
    static = 0.5 * (theta[0] + theta[4])
    total = sum(len(piece.angle) - piece.first for piece in pieces)

    def cost(free):
        stiffness, square = np.exp(free), 0.0
        for moved, level, torque, counted in inputs:
            model = np.empty(len(moved))
            load_blocks(moved, level, stiffness, 1.0 / N_BLOCKS, torque[0], model)
            off = (model - torque)[counted]
            square += np.var(off) * len(off)
        return square / total / static ** 2

    best, spent = min((_minimize_again(cost, np.log(
        static / N_BLOCKS / travel / np.geomspace(smallest, 2.0, N_BLOCKS)))
        for smallest in _SMALLEST), key=lambda end: end[1])
    return np.sort(np.exp(best)), float(np.sqrt(spent) * static)


def _minimize_again(cost, start):
    """Run Nelder-Mead, again from where it ended while that pays; return place and cost."""
    best, least = start, np.inf
    for _ in range(_RESTARTS):
        simplex = np.vstack([best, best + np.diag(np.full(len(best), 0.5))])
        fit = minimize(cost, best, method='Nelder-Mead', options={
            'initial_simplex': simplex, 'maxfev': _EVALUATIONS // _RESTARTS, 'xatol': 1e-3,
            'fatol': 1e-9})
        gain = least - fit.fun
        best, least = fit.x, fit.fun
        if gain < _GAINED * least:
            break
    return best, least


def _level(direction, rate, theta):
    """Return s(v), Eq. (4), shape (T,), of the sign of ``direction`` at ``rate`` (T,)."""
    row = np.where(direction >= 0.0, 0, 4)
    static, coulomb, velocity = theta[row], theta[row + 1], theta[row + 2]
    return coulomb + (static - coulomb) * np.exp(-np.minimum((rate / velocity) ** 2, 50.0))


def _viscous_of(direction, theta):
    """Return sigma_2, shape (T,), of the sign of ``direction`` (T,)."""
    return theta[np.where(direction >= 0.0, 3, 7)]


def fit_attraction(pieces, theta: np.ndarray, period: float) -> tuple:
    """
    Return C [N m/s] of one-way sliding pieces and its 95 % Interval, 0 and None if all stop.

    Neighbouring samples of a window are counted once. Eq. (7), corrected:
    ``d(F_f - sigma_2 v)/dt = C (sgn v - (F_f - sigma_2 v) / s(v))``. A straight line is left open
    in each second or two: the map's error there is not small beside the lag, and the softest
    blocks may load still.
    """
    chunks = []
    for piece in pieces:
        slip = piece.friction - _viscous_of(piece.rate, theta) * piece.rate
        rest = np.sign(piece.rate) - slip / _level(piece.rate, piece.rate, theta)
        rows = np.stack([piece.smooth(slip)[1], piece.smooth(rest)[0], np.abs(piece.rate)])
        rows = rows[:, piece.window:-piece.window]
        for part in np.array_split(rows, max(round(rows.shape[1] * period / _CHUNK), 1), axis=1):
            if part[2].min() > _SLOWEST * part[2].mean():
                chunks.append(detrend(part[:2]))
    if not chunks:
        return 0.0, None
    y, x = np.concatenate(chunks, axis=1)
    independent = len(x) / pieces[0].window - 2 * len(chunks)
    attraction = float(x @ y / (x @ x))
    freedom = max(independent - 1, 1)
    spread = np.sqrt(np.mean((y - attraction * x) ** 2) / np.mean(x * x) / freedom)
    reach = student.ppf(0.975, freedom) * spread
    return attraction, Interval(attraction - reach, attraction + reach)
