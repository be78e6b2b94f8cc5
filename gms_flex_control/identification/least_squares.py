# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The two least squares of a fit: of the innovations, and of the drive torque.

The cost of the innovations is no sum of squares: each block of time has a noise level of its
own, see objective.Evaluation, and samples are far more than numbers. So the normal equations of
all blocks are summed for Levenberg and Marquardt here; scipy would need the Jacobian of every
sample. The torque is fitted by scipy, robust to moments unlike the rest. Both are drawn weakly to
a prior.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import low_pass, rms
from gms_flex_control.identification.coordinates import Coordinates, N_STEADY
from gms_flex_control.identification.objective import block_length, Evaluation, Objective
import numpy as np
from scipy.optimize import least_squares

_LARGEST_STEP = 0.7   # of a logarithm
_TRIALS = 6
_ROUNDS = 3
_SAME_FLOOR = 0.1
_ENOUGH, _NEARLY = 1e-5, 2e-3  # relative gain below which a fit has settled, or will do to go on
_STEADY_SD, _BLOCK_SD, _EXTRA_SD = 1.0, 3.0, 1.0  # of the prior: logarithms, units of corrections
_MEMORY = 0.1  # of what a fit leaves of the torque, at least [s]
_STEP = 1e-4   # of a free number, for a derivative
_BENT = 2.0    # residuals beyond this many standard deviations count less


class Prior(NamedTuple):
    """Where the numbers are believed to lie."""

    mean: np.ndarray       # (P,)
    precision: np.ndarray  # (P,), inverse variance; 0 knows nothing


class Refined(NamedTuple):
    """Outcome of a fit."""

    free: np.ndarray       # (P,)
    evaluation: Evaluation
    settled: bool


def prior_of(coordinates: Coordinates, free: np.ndarray) -> Prior:
    """Return the weak Prior around free numbers."""
    precision = np.full(coordinates.size, _BLOCK_SD ** -2)
    precision[:N_STEADY] = _STEADY_SD ** -2
    precision[coordinates.size - coordinates.n_extra:] = _EXTRA_SD ** -2
    return Prior(free.copy(), precision)


def refine(objective: Objective, coordinates: Coordinates, free: np.ndarray, prior: Prior, *,
           sharpness=1.0, iterations=25, roughly=False, floor=None) -> Refined:
    """
    Move free numbers (P,) to the nearest minimum of the cost.

    ``sharpness`` is a factor on the observer's bandwidth: above 1 the cost has fewer local minima
    and says less. ``roughly`` ends early, where another fit goes on from here. ``floor`` [rad]
    is the innovation below which a block counts as explained, to compare fits.
    """
    now, count = objective.evaluate(coordinates, free, sharpness, floor), 0
    for _ in range(_ROUNDS):
        free, now, used, settled = _descend(objective, coordinates, free, now, prior, sharpness,
                                            iterations - count, _NEARLY if roughly else _ENOUGH)
        count += used
        floor = objective.floor_of(now.square)
        if roughly or count >= iterations or abs(floor / now.floor - 1.0) < _SAME_FLOOR:
            break
        now = replace(now, floor=floor)
    return Refined(free, now, settled)


def _descend(objective, coordinates, free, now, prior, sharpness, iterations, enough):
    """Return free numbers, their Evaluation, iterations used and whether the fit settled."""
    damping = 1e-3
    for count in range(1, iterations + 1):
        curvature, slope = summed(now, free, prior)
        cost = total_cost(now, free, prior)
        for attempt in range(_TRIALS):
            step = _damped_step(curvature, slope, damping)
            step = np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
            trial = objective.evaluate(coordinates, free + step, sharpness, now.floor,
                                       derivatives=attempt == 0)  # one that fails needs none
            gain = cost - total_cost(trial, free + step, prior)
            if gain > 0.0:
                break
            damping *= 6.0
        else:
            return free, now, count, True
        if attempt:
            trial = objective.evaluate(coordinates, free + step, sharpness, now.floor)
        free, now, damping = free + step, trial, max(damping / 6.0, 1e-9)
        if gain < enough * cost:
            return free, now, count, True
    return free, now, iterations, False


def _damped_step(curvature, slope, damping):
    """Return the step of Levenberg and Marquardt; a number without any effect stays."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    if not (np.isfinite(curvature).all() and np.isfinite(slope).all()):
        return np.zeros(len(slope))  # derivatives that run away give no direction
    scaled = curvature * np.outer(scale, scale) + damping * np.eye(len(slope))
    return scale * np.linalg.lstsq(scaled, scale * slope, rcond=1e-14)[0]


def total_cost(evaluation: Evaluation, free, prior: Prior) -> float:
    """Return the cost of all data and of the distance from the prior."""
    return evaluation.cost.sum() + 0.5 * np.sum(prior.precision * (free - prior.mean) ** 2)


def summed(evaluation: Evaluation, free, prior: Prior) -> tuple[np.ndarray, np.ndarray]:
    """Return curvature (P, P) and downhill slope (P,) of the cost, the prior included."""
    weight = evaluation.weight
    curvature = np.tensordot(weight, evaluation.curvature, 1) + np.diag(prior.precision)
    slope = weight @ evaluation.gradient - prior.precision * (free - prior.mean)
    return curvature, slope


class TorqueError:
    """Torque that parameters leave unexplained along the motion of ``chosen`` samples (T,)."""

    def __init__(self, objective: Objective, chosen: Callable, step: float):
        bundle, blocks, used = objective.bundle, [], 0
        self._pieces = []  # (window, friction by the link equation, that of parameters, counts)
        for segment in bundle.segments:
            counts = chosen(segment) & bundle.judged(segment, objective.joint, step)
            block = used + np.arange(len(counts)) // block_length(bundle.period)
            used = block[-1] + 1
            if counts.any():
                blocks.append(block[counts])
                self._pieces.append((segment.window, objective.measured(segment),
                                     objective.resistance_along(segment), counts))
        self.block = np.unique(np.concatenate(blocks), return_inverse=True)[1]
        self.measured = np.concatenate([
            torque[counts] for _, torque, _, counts in self._pieces])
        self.memory = max(_MEMORY / bundle.period,
                          *(2.0 * window for window, *_ in self._pieces))

    def __call__(self, theta):
        """Return the unexplained torque (S,) of parameters [N m]."""
        return np.concatenate([
            low_pass(torque - resistance(theta), window)[counts]
            for window, torque, resistance, counts in self._pieces])


def fit_torque(error: TorqueError, coordinates: Coordinates, free, prior: Prior) -> np.ndarray:
    """Return the free numbers (P,) that explain the torque best, drawn weakly to the prior."""
    root = np.sqrt(prior.precision)
    scale = rms(error(coordinates.parameters(free))) * np.sqrt(error.memory)

    def residual(x):
        off = error(coordinates.parameters(x)) / scale
        limit = _BENT / np.sqrt(error.memory)  # linear beyond
        off = np.sign(off) * limit * np.sqrt(2.0 * (np.sqrt(1.0 + (off / limit) ** 2) - 1.0))
        return np.concatenate([off, root * (x - prior.mean)])
    return least_squares(residual, free, jac=lambda x: jacobian(residual, x),
                         method='lm', max_nfev=15, ftol=1e-4, xtol=1e-4).x


def jacobian(function: Callable, x: np.ndarray) -> np.ndarray:
    """Return the derivatives (S, P) of a function of free numbers (P,), by central differences."""
    return np.stack([(function(x + step) - function(x - step)) / (2.0 * _STEP)
                     for step in _STEP * np.eye(len(x))], axis=1)
