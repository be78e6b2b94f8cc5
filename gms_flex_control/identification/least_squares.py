# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The least squares of a joint's friction: of the innovations, from many starts, and of its torque.

The cost of the innovations is no sum of squares: each block of time has a noise level of its
own, see objective.Evaluation, and samples are far more than numbers. So the normal equations of
all blocks are summed for Levenberg and Marquardt here; scipy would need the Jacobian of every
sample. The torque is fitted by scipy, robust to moments unlike the rest. Both are drawn weakly to
a prior.

Where links stick and slip the cost is rough: a fit ends in one of many local minima. Those near
the truth lie along a funnel, so that fits from perturbations of the best find a better one until
none is better. What the good ones differ by is reported as uncertainty.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import low_pass, rms
from gms_flex_control.identification.coordinates import (
    Coordinates,
    N_STEADY,
    with_both_as,
    with_narrow_curves,
)
from gms_flex_control.identification.objective import (
    block_length,
    Evaluation,
    Objective,
    torque_memory,
)
from gms_flex_control.identification.outcome import widening
from gms_flex_control.simulation.predictor import PER_DIRECTION, VELOCITY
import numpy as np
from scipy.optimize import least_squares

_LARGEST_STEP = 0.7   # of a logarithm
_TRIALS = 6
_ROUNDS = 3
_SAME_FLOOR = 0.1
_ENOUGH, _NEARLY = 1e-5, 2e-3  # relative decrease of a fit that has settled, or will do to go on
_STEADY_SD, _BLOCK_SD, _EXTRA_SD = 1.0, 3.0, 1.0  # of the prior: logarithms, units of corrections
_STEP = 1e-4   # of a free number, for a derivative
_BENT = 2.0    # residuals beyond this many standard deviations count less
# of a multi-start
IMPROVEMENT = 1.02    # of the cost, that makes it worth to go on
KEPT = 4              # ends with coarse samples that fine ones begin from
_MOST = 32            # perturbed fits in all
_TRIED, _HOPELESS = 3, 1.25  # steps of a fit, and cost over the best beyond which it then ends
_CARRIED, _POOR = 8, 2.0  # likewise of a fit that begins where one with coarser samples ended
_STEADY = (0.002, 0.05, 0.02, 0.01)  # perturbation of F_c, F_s - F_c, v_s, sigma_2 (free numbers)
_BLOCKS, _FINE = 0.05, 0.12  # of attraction and yields; more of those within few counts
_WIDE = 0.3           # of those together, every other time
_FEW_COUNTS = 1.5
_LOST = 10.0          # v_s of one direction over the other's: robots are drawn with 1.6 at most
NARROW = (0.002, 0.01, 0.05)  # of the top speed: v_s of curves that begin where both are lost
_LOST_BLOCK = 3.0     # times its neighbour's yield, or less in that ratio
_GOOD = 1.15          # times the lowest cost: as good an explanation


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
            decrease = cost - total_cost(trial, free + step, prior)
            if decrease > 0.0:
                break
            damping *= 6.0
        else:
            return free, now, count, True
        if attempt:
            trial = objective.evaluate(coordinates, free + step, sharpness, now.floor)
        free, now, damping = free + step, trial, max(damping / 6.0, 1e-9)
        if decrease < enough * cost:
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


class MultiStart(NamedTuple):
    """Outcome of a multi-start."""

    ends: tuple            # of free numbers (P,), the best first
    scatter: np.ndarray    # (P,), standard deviation of the good ones about the best
    improvement: float     # cost where they began over that of the best


def multi_start(objective: Objective, coordinates: Coordinates, starts: Sequence, prior,
                count: float, rng, patience: int) -> MultiStart:
    """
    Refine again from perturbations of the best so far, as long as it pays, and keep the best.

    ``starts`` are free numbers, the best first; ``count`` the encoder step or noise [rad]; it ends
    after ``patience`` fits in a row that improve nothing. The scatter is as much larger as
    Student's distribution is wider for so few: what the roughness leaves open.
    """
    begin = objective.evaluate(coordinates, starts[0], 1.0)
    ends = [_with_blocks_together(objective, coordinates, _with_both_curves(
        objective, coordinates, starts[0], prior), prior)]
    floor, idle = ends[0].evaluation.floor, 0
    carried = list(starts[1:])
    while len(ends) <= _MOST and (carried or idle < patience):
        best = min(ends, key=lambda end: _cost_above(end, floor, prior))
        lowest = _cost_above(best, floor, prior)
        if carried:
            ends.append(_tried(objective, coordinates, carried.pop(0), prior, floor,
                               _CARRIED, _POOR * lowest))
        else:
            start = best.free + _perturbation(coordinates, best.free, count, rng, len(ends) % 2)
            ends.append(_tried(objective, coordinates, start, prior, floor, _TRIED,
                               _HOPELESS * lowest))
        # what the best explain counts as explained: bad local minima look alike above it
        floor = min(floor, objective.floor_of(ends[-1].evaluation.square))
        improvement = _cost_above(best, floor, prior) / _cost_above(ends[-1], floor, prior)
        idle = 0 if improvement > IMPROVEMENT else idle + 1
    ends.sort(key=lambda end: _cost_above(end, floor, prior))
    lowest = _cost_above(ends[0], floor, prior)
    ordered = [_in_order(coordinates, end.free) for end in ends]
    good = [free for free, end in zip(ordered, ends, strict=True)
            if _cost_above(end, floor, prior) <= _GOOD * lowest]
    scatter = widening(max(len(good) - 1, 2)) * np.sqrt(np.mean(
        np.square(np.array(good) - good[0]), axis=0))
    improvement = total_cost(replace(begin, floor=floor), starts[0], prior) / lowest
    return MultiStart(tuple(ordered[:KEPT]), scatter, improvement)


def best_from(objective, coordinates, begins, prior, floor) -> Refined:
    """Return the best Refined of those from free numbers to begin with."""
    ends = [refine(objective, coordinates, begin, prior, roughly=True, floor=floor)
            for begin in begins]
    return min(ends, key=lambda one: _cost_above(one, floor, prior))


def _with_both_curves(objective, coordinates, free, prior):
    """
    Return the Refined from ``free``, a Stribeck curve that is lost begun anew.

    As that of the other direction; where both are wider than motion is fast, as narrow ones.
    """
    end = refine(objective, coordinates, free, prior, roughly=True)
    velocities = coordinates.parameters(end.free)[[VELOCITY, PER_DIRECTION + VELOCITY]]
    top = objective.fastest
    if velocities.min() > top:
        begins = [with_narrow_curves(end.free, share * top) for share in NARROW]
    elif velocities.max() > _LOST * velocities.min():
        begins = [with_both_as(end.free, way) for way in range(2)]
    else:
        return end
    floor = end.evaluation.floor
    best = best_from(objective, coordinates, begins, prior, floor)
    better = IMPROVEMENT * _cost_above(best, floor, prior) < _cost_above(end, floor, prior)
    return best if better else end


def _with_blocks_together(objective, coordinates, end, prior):
    """
    Return the Refined with a block that is lost at either end of the yields beside the others.

    One far stiffer than these breaks away within a count, whatever its yield is, and one far
    softer hardly slips: the cost is flat there, and steps do not lead back.
    """
    for side in (0, -1):
        for _ in range(coordinates.n_blocks - 1):
            lost = _lost_block(coordinates, end.free, side)
            if not lost:
                break
            begin = end.free.copy()
            begin[lost[0]] = end.free[lost[1]]
            floor = end.evaluation.floor
            other = refine(objective, coordinates, begin, prior, roughly=True, floor=floor)
            worse = _cost_above(other, floor, prior) / _cost_above(end, floor, prior)
            if worse >= (1.0 if _lost_block(coordinates, other.free, side) else IMPROVEMENT):
                break
            end = other
    return end


def _lost_block(coordinates, free, side):
    """Return the places of a lost block at one end of the yields and of its neighbour, or ()."""
    order = coordinates.yields.start + np.argsort(free[coordinates.yields])
    block, beside = order[side], order[1 if side == 0 else -2]
    return (block, beside) if abs(free[block] - free[beside]) >= np.log(_LOST_BLOCK) else ()


def _tried(objective, coordinates, free, prior, floor, steps, limit):
    """Return a Refined from ``free``, left where it is if few steps do not get below ``limit``."""
    end = refine(objective, coordinates, free, prior, roughly=True, floor=floor, iterations=steps)
    if end.settled or _cost_above(end, floor, prior) > limit:
        return end
    return refine(objective, coordinates, end.free, prior, roughly=True, floor=floor)


def _cost_above(end, floor, prior):
    """Return the cost of a Refined, blocks below ``floor`` [rad] explained; inf if it ran off."""
    cost = total_cost(replace(end.evaluation, floor=floor), end.free, prior)
    return cost if np.isfinite(cost) else np.inf


def _in_order(coordinates, free):
    """Return free numbers with blocks of equal weight from stiff to soft."""
    ordered = free.copy()
    ordered[coordinates.yields] = np.sort(free[coordinates.yields])
    return ordered


def _perturbation(coordinates, free, count, rng, wide):
    """
    Return a random change of free numbers, about as large as they are uncertain.

    Blocks that break away within a few counts move most, and together: a fit sees them only at
    the moments when a count changes; ``wide`` moves them together far.
    """
    size = np.zeros(coordinates.size)
    size[:N_STEADY] = [*_STEADY, *_STEADY, _BLOCKS]
    size[coordinates.yields] = _BLOCKS
    fine = np.zeros(coordinates.size)
    fine[coordinates.yields] = np.exp(free[coordinates.yields]) < _FEW_COUNTS * count
    return ((size + _FINE * fine) * rng.standard_normal(coordinates.size)
            + (_WIDE if wide else _FINE) * fine * rng.standard_normal())


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
        self.measured = np.concatenate([torque[counts] for _, torque, _, counts in self._pieces])
        self.memory = torque_memory(bundle.period, [window for window, *_ in self._pieces])

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
