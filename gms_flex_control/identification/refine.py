# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Levenberg-Marquardt on the cost of all blocks, with a weak pull towards where it began."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

_LARGEST_STEP = 0.7   # of a logarithm
_TRIALS = 6
_ROUNDS = 3
_SAME_FLOOR = 0.1
_ENOUGH, _NEARLY = 1e-5, 2e-3  # relative gain below which a fit has settled, or will do to go on


class Prior(NamedTuple):
    """Where the numbers are believed to lie."""

    mean: np.ndarray       # (P,)
    precision: np.ndarray  # (P,), inverse variance; 0 knows nothing


class Refined(NamedTuple):
    """Outcome of a fit."""

    free: np.ndarray       # (P,)
    evaluation: object     # Evaluation there
    iterations: int
    settled: bool


def refine(objective, coordinates, free, prior, *, sharpness=1.0, iterations=25, roughly=False,
           floor=None):
    """
    Move free numbers to the nearest minimum of the cost.

    Parameters
    ----------
    objective : Objective
        What to make small.
    coordinates : Coordinates
        What the numbers stand for.
    free : ndarray, shape (P,)
        Where to begin.
    prior : Prior
        Belief; it keeps in place what the data cannot tell.
    sharpness : float
        Factor on the observer's bandwidth: above 1 the cost has fewer local minima and tells
        less.
    iterations : int
        At most.
    roughly : bool
        Whether to end early, where another fit goes on from here.
    floor : float, optional
        Innovation below which a block counts as explained [rad], to compare fits.

    Returns
    -------
    Refined

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
    return Refined(free, now, count, settled)


def _descend(objective, coordinates, free, now, prior, sharpness, iterations, enough):
    """Return free numbers, their Evaluation, iterations taken and whether the fit settled."""
    damping = 1e-3
    for count in range(1, iterations + 1):
        curvature, slope = summed(now, free, prior)
        cost = total_cost(now, free, prior)
        for attempt in range(_TRIALS):
            step = damped_step(curvature, slope, damping)
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


def damped_step(curvature, slope, damping):
    """Return the step of Levenberg and Marquardt; a number without any effect stays."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    if not (np.isfinite(curvature).all() and np.isfinite(slope).all()):
        return np.zeros(len(slope))  # derivatives that run away tell no direction
    scaled = curvature * np.outer(scale, scale) + damping * np.eye(len(slope))
    return scale * np.linalg.lstsq(scaled, scale * slope, rcond=1e-14)[0]


def total_cost(evaluation, free, prior):
    """Return the cost of all data and of the distance from the prior."""
    return evaluation.cost.sum() + 0.5 * np.sum(prior.precision * (free - prior.mean) ** 2)


def summed(evaluation, free, prior):
    """Return curvature (P, P) and downhill slope (P,) of the cost, the prior included."""
    weight = evaluation.weight
    curvature = np.tensordot(weight, evaluation.curvature, 1) + np.diag(prior.precision)
    slope = weight @ evaluation.gradient - prior.precision * (free - prior.mean)
    return curvature, slope
