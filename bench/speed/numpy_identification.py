# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Identification of one joint written the plain way: Nelder-Mead over a numpy simulation.

A reference for speed. It computes the same cost as identification.objective on a single axis,
which is tested, with one loop over samples in Python and arrays over the blocks.
"""

from time import perf_counter
from typing import NamedTuple

from bench.chain_matrices import matrices
from gms_flex_control.data.signal_analysis import BLOCK_TIME
from gms_flex_control.identification.coordinates import MOST_BLOCKS
from gms_flex_control.simulation.predictor import ATTRACTION, BLOCKS
import numpy as np
from scipy.optimize import minimize


class Search(NamedTuple):
    """How a search ended."""

    cost: float
    free: np.ndarray
    seconds: float
    evaluations: int
    reached: bool    # the cost asked for


def innovations(segment, theta, inertia, period, half, bandwidth):
    """
    Predict the angles of an axis and return how far the readings (T,) lie off [rad].

    Link equation (1) of a single axis without gravity, with Eqs. (2) to (5), of a Segment and its
    parameters as in simulation.predictor; ``half`` is half an encoder count [rad], ``bandwidth``
    that of the observer that draws the prediction to the readings [rad/s].
    """
    ways = {1.0: theta[0:4].tolist(), -1.0: theta[4:8].tolist()}
    attraction = float(theta[ATTRACTION])
    blocks = theta[BLOCKS:].reshape(2, MOST_BLOCKS)
    stiffness, weight = blocks[:, blocks[1] > 0.0]
    readings, pushes = segment.angle[:, 0].tolist(), segment.torque[:, 0].tolist()
    found = np.zeros(len(readings))
    dq = float(segment.rate[0, 0])
    q = readings[0] + 0.5 * period * dq
    sign = 1.0 if pushes[0] >= 0.0 else -1.0
    static = ways[sign][0]
    torque = weight * min(max(pushes[0], -static), static)
    sticking = np.ones(len(weight), dtype=bool)
    for k, (reading, push) in enumerate(zip(readings, pushes, strict=True)):
        error = reading - (q - 0.5 * period * dq)
        error = error - half if error > half else error + half if error < -half else 0.0
        found[k] = error
        friction = torque.sum() + ways[sign][3] * dq  # Eq. (5)
        resistance = 0.5 * period * ways[sign][3] if half > 0.0 else 0.0  # of counted readings
        dq += period * ((push - friction) / (inertia + resistance)
                        + bandwidth ** 2 * error)  # Eq. (1)
        moved = period * dq
        q += moved + period * 2.0 * bandwidth * error
        if moved * sign < 0.0:
            sign = -sign
            sticking[:] = True
        static, coulomb, velocity, _ = ways[sign]
        level = coulomb + (static - coulomb) * np.exp(-(dq / velocity) ** 2)  # Eq. (4)
        limit = sign * level * weight
        stuck = torque + stiffness * moved  # Eq. (2)
        slid = limit + (torque - limit) * np.exp(-attraction * period / level)  # Eq. (3)
        breaks = sign * stuck >= sign * limit
        torque = np.where(sticking, np.where(breaks, limit, stuck), slid)
        sticking &= ~breaks
    return found


class PlainObjective:
    """
    The cost of parameters of a single axis; ``objective`` says which samples count.

    A block of time counts as explained below an innovation of ``floor`` [rad].
    """

    def __init__(self, bundle, objective, floor):
        zero = np.zeros(1)
        self._inertia = float(matrices(zero, zero, zero, zero, bundle.arm).mass[0, 0])
        self._bundle, self._floor = bundle, floor
        self._counted = [objective.counted(segment) for segment in bundle.segments]

    def cost(self, theta):
        """Return the cost of parameters, as Evaluation.cost summed."""
        bundle, total = self._bundle, 0.0
        length = max(round(BLOCK_TIME / bundle.period), 1)
        for segment, counted in zip(bundle.segments, self._counted, strict=True):
            error = innovations(segment, theta, self._inertia, bundle.period,
                                float(bundle.half[0]), float(bundle.observer[0]))
            begins = np.arange(0, len(error), length)
            count = np.add.reduceat(counted, begins, dtype=int)
            square = np.add.reduceat(np.where(counted, error, 0.0) ** 2, begins)
            mean = square / np.maximum(count, 1)
            total += 0.5 * np.sum(count * np.log1p(mean / self._floor ** 2))
        return float(total)


def search(cost, start, wanted, budget):
    """Minimise ``cost`` by Nelder-Mead until one is reached, it converges, or time is up [s]."""
    begin, best, count = perf_counter(), [np.inf, start], 0

    class Enough(Exception):
        """Ends the search from within."""

    def watched(free):
        nonlocal count
        value = cost(free)
        count += 1
        if value < best[0]:
            best[:] = [value, np.array(free)]
        if best[0] <= wanted or perf_counter() - begin > budget:
            raise Enough
        return value

    simplex = np.vstack([start, start + 0.3 * np.eye(len(start))])
    try:
        minimize(watched, start, method='Nelder-Mead', options={
            'initial_simplex': simplex, 'maxfev': 10 ** 6, 'maxiter': 10 ** 6, 'xatol': 1e-4,
            'fatol': 1e-4, 'adaptive': True})
    except Enough:
        pass
    return Search(best[0], best[1], perf_counter() - begin, count, best[0] <= wanted)
