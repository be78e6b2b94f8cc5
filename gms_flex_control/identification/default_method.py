# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The method of this project: all friction parameters of a joint refined together.

First blocks with fixed yield displacements, spread over decades, and free weights: a smooth
problem that finds the shape of the presliding curve from far away. Then blocks of equal weight
at the quantiles of that shape, for several N; the data held out choose among them. The observer
of the predictor is stiff at first and soft in the end: stiff, each innovation depends on the
last moments only and the cost has hardly any local minimum; soft, it tells the most. In the
end fits from beside the best look for a better one: what they differ by is told as uncertainty.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.identification.coordinates import Coordinates, MOST_BLOCKS, N_STEADY
from gms_flex_control.identification.objective import BLOCK_TIME, coarser, Objective
from gms_flex_control.identification.refine import Prior, refine, total_cost
from gms_flex_control.simulation.predictor import BLOCKS
import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

COARSE = 2e-3         # sample that is fine enough to find the way [s]
CANDIDATES = (1, 2, 4, 6, 8)  # numbers of blocks that are tried
_SPREAD_SHARPNESS = (3.0, 1.0)
_SHARPNESS = (2.0, 1.0)
_HELD_OUT = 4         # one in so many blocks of time is held out
_STEADY_DOUBT, _BLOCK_DOUBT = 1.0, 3.0  # spread of the prior, of logarithms
_MOST_HOPS, _IDLE_HOPS = 24, 6  # fits from beside the best: in all, and without a gain
_GAIN = 1.02          # of the cost, that makes it worth to go on
_KICKS = (0.002, 0.05, 0.02, 0.01)  # how far beside: F_c, F_s - F_c, v_s, sigma_2 (logarithms)
_KICK, _FINE_KICK = 0.05, 0.12  # of attraction and yields; more of those within few counts
_EXTRA_DOUBT = 1.0    # of corrections, in their units
_FEW_COUNTS = 1.5
_GOOD = 1.15          # times the lowest cost: as good an explanation
_UPPER = 0.975        # of a 95 % interval


class Candidate(NamedTuple):
    """One number of blocks that was tried."""

    n_blocks: int
    free_weights: bool
    cost: float          # robust cost per held-out sample
    error: float         # standard error of the difference to the best
    coordinates: Coordinates
    free: np.ndarray


class JointFit(NamedTuple):
    """What the fit of one joint ended with."""

    coordinates: Coordinates
    free: np.ndarray
    prior: Prior
    evaluation: object     # Evaluation on all data
    held_out: object       # Candidate that was chosen, fitted without the data held out
    candidates: tuple      # of Candidate
    settled: bool
    sampling: np.ndarray   # what roughness of the cost and sampling leave open, (P,)


def prior_of(coordinates, free):
    """Return the weak Prior around free numbers."""
    precision = np.full(coordinates.size, _BLOCK_DOUBT ** -2)
    precision[:N_STEADY] = _STEADY_DOUBT ** -2
    precision[coordinates.size - coordinates.n_extra:] = _EXTRA_DOUBT ** -2
    return Prior(free.copy(), precision)


def held_out(period):
    """Return a function Stretch -> bool (T,) of the samples not to be fitted."""
    length = max(round(BLOCK_TIME / period), 1)
    return lambda stretch: (stretch.first_block + np.arange(len(stretch.angle)) // length
                            ) % _HELD_OUT == _HELD_OUT - 1


def numbered(stretches, period):
    """Return stretches with their blocks of time numbered; the last of few is held out."""
    counts = [max(len(stretch.angle) * period // BLOCK_TIME, 1.0) for stretch in stretches]
    begin = max(_HELD_OUT - int(sum(counts)), 0)
    firsts = begin + np.concatenate([[0], np.cumsum(counts)]).astype(int)
    return [replace(stretch, first_block=int(first))
            for stretch, first in zip(stretches, firsts[:-1], strict=True)]


def train(period):
    """Return a function Stretch -> bool (T,) of the samples to be fitted."""
    out = held_out(period)
    return lambda stretch: ~out(stretch)


def spread(objective, start, extra):
    """Return Coordinates and free numbers of the blocks with fixed yields, fitted."""
    coordinates = Coordinates(len(start.yields), yields=start.yields, free_weights=True,
                              n_extra=len(extra))
    both = np.array([start.forward, start.backward]).T
    free = coordinates.pack(*both, start.attraction, None, extra=extra)
    prior = prior_of(coordinates, free)
    for sharpness in _SPREAD_SHARPNESS:
        free = refine(objective, coordinates, free, prior, sharpness=sharpness, roughly=True).free
    return coordinates, free


def yield_quantiles(theta, n_blocks):
    """
    Return yields of blocks of equal weight that make the same presliding curve.

    Parameters
    ----------
    theta : ndarray
        Parameters of a joint.
    n_blocks : int
        How many blocks.

    Returns
    -------
    ndarray, shape (n_blocks,)
        Increasing [rad].

    """
    stiffness, weight = theta[BLOCKS:BLOCKS + 2 * MOST_BLOCKS].reshape(2, MOST_BLOCKS)
    used = weight > 0.0
    yields = weight[used] * theta[[0, 4]].mean() / stiffness[used]
    order = np.argsort(yields)
    yields, share = np.log(yields[order]), weight[used][order]
    middle = np.cumsum(share) - 0.5 * share
    at = (np.arange(n_blocks) + 0.5) / n_blocks
    return np.exp(np.interp(at, np.concatenate([[0.0], middle, [1.0]]),
                            np.concatenate([yields[:1], yields, yields[-1:]])))


def equal_blocks(theta, n_blocks, n_extra):
    """Return Coordinates and free numbers of N equal blocks like those of ``theta``."""
    coordinates = Coordinates(n_blocks, n_extra=n_extra)
    return coordinates, coordinates.pack(
        theta[[0, 4]], theta[[1, 5]], theta[[2, 6]], theta[[3, 7]], theta[8],
        yield_quantiles(theta, n_blocks), extra=theta[len(theta) - n_extra:])


def fit_candidate(bundle, joint, thetas, theta, n_blocks, n_extra):
    """Return Coordinates and free numbers of N blocks, fitted without the data held out."""
    objective = Objective(bundle, joint, thetas, train(bundle.period))
    coordinates, free = equal_blocks(theta, n_blocks, n_extra)
    prior = prior_of(coordinates, free)
    for sharpness in _SHARPNESS:
        free = refine(objective, coordinates, free, prior, sharpness=sharpness,
                      roughly=sharpness > 1.0).free
    return coordinates, free


def choose(bundle, joint, thetas, fits):
    """
    Return the candidates, and the one whose held-out error no other beats beyond chance.

    Parameters
    ----------
    bundle : Bundle
        All data.
    joint : int
        Which joint.
    thetas : sequence of ndarray
        Parameters of all joints.
    fits : sequence of (Coordinates, ndarray)
        Fitted without the data held out.

    Returns
    -------
    candidates : tuple of Candidate
        In the order of ``fits``.
    chosen : int
        The fewest blocks within one standard error of the best.

    """
    objective = Objective(bundle, joint, thetas, held_out(bundle.period))
    evaluations, floor = [], None
    for coordinates, free in reversed(fits):  # the largest sets the floor
        evaluations.insert(0, objective.evaluate(coordinates, free, 1.0, floor))
        floor = evaluations[0].floor
    count = evaluations[0].count.sum()
    costs = np.array([evaluation.cost for evaluation in evaluations])
    best = int(np.argmin(costs.sum(axis=1)))
    off = costs - costs[best]
    errors = off.std(axis=1) * np.sqrt(off.shape[1])
    candidates = tuple(
        Candidate(coordinates.n_blocks, coordinates.free_weights, float(cost.sum() / count),
                  float(error / count), coordinates, free)
        for (coordinates, free), cost, error in zip(fits, costs, errors, strict=True))
    within = np.flatnonzero(off.sum(axis=1) <= errors)
    return candidates, int(within[0])


def fit_joint(bundle, joint, thetas, start, extra, blocks):
    """
    Fit one joint, the others as they are.

    Parameters
    ----------
    bundle : Bundle
        All data.
    joint : int
        Which joint.
    thetas : sequence of ndarray
        Parameters of all joints.
    start : Start
        Where to begin.
    extra : ndarray, shape (R,)
        Further coefficients to begin with.
    blocks : sequence of int
        Numbers of blocks to try.

    Returns
    -------
    JointFit

    """
    training = Objective(bundle, joint, thetas, train(bundle.period))
    coordinates, free = spread(training, start, extra)
    theta, _ = coordinates.unpack(free)
    fits = [fit_candidate(bundle, joint, thetas, theta, n, len(extra)) for n in blocks]
    candidates, chosen = choose(bundle, joint, thetas, fits)
    best = candidates[chosen]
    return JointFit(best.coordinates, best.free, prior_of(best.coordinates, best.free), None,
                    best, candidates, False, np.zeros(len(best.free)))


def hop(objective, coordinates, free, prior, count, rng):
    """
    Refine again from a little beside the best so far, several times, and keep the best.

    Where links stick and slip the cost is rough: a fit ends in one of many shallow hollows.

    Parameters
    ----------
    objective, coordinates, free, prior
        As `refine`.
    count : float
        Encoder step or noise [rad].
    rng : numpy.random.Generator
        Says where beside.

    Returns
    -------
    free : ndarray, shape (P,)
        The best.
    scatter : ndarray, shape (P,)
        Standard deviation of the good ones about the best, as much larger as Student's
        distribution is wider for so few: what the roughness leaves open.

    """
    ends = [refine(objective, coordinates, free, prior, roughly=True)]
    floor, idle = ends[0].evaluation.floor, 0
    while len(ends) <= _MOST_HOPS and idle < _IDLE_HOPS:
        best = min(ends, key=lambda end: cost_behind(end, floor, prior))
        start = best.free + kick(coordinates, best.free, count, rng)
        ends.append(refine(objective, coordinates, start, prior, roughly=True, floor=floor))
        # what the best explain decides what counts as explained: bad hollows look alike above it
        floor = min(floor, objective.floor_of(ends[-1].evaluation.square))
        gain = cost_behind(best, floor, prior) / cost_behind(ends[-1], floor, prior)
        idle = 0 if gain > _GAIN else idle + 1
    ends.sort(key=lambda end: cost_behind(end, floor, prior))
    limit = _GOOD * cost_behind(ends[0], floor, prior)
    good = [in_order(coordinates, end.free) for end in ends
            if cost_behind(end, floor, prior) <= limit]
    few = student.ppf(_UPPER, max(len(good) - 1, 2)) / norm.ppf(_UPPER)  # so few tell little
    return good[0], few * np.sqrt(np.mean(np.square(np.array(good) - good[0]), axis=0))


def cost_behind(end, floor, prior):
    """Return the cost of a Refined if blocks below ``floor`` [rad] counted as explained."""
    return total_cost(replace(end.evaluation, floor=floor), end.free, prior)


def in_order(coordinates, free):
    """Return free numbers with blocks of equal weight from stiff to soft."""
    if coordinates.free_weights:
        return free
    ordered = free.copy()
    ordered[coordinates.yields] = np.sort(free[coordinates.yields])
    return ordered


def kick(coordinates, free, count, rng):
    """
    Return a random change of free numbers, about as large as they are uncertain.

    Blocks that break away within a few counts move most, and together: a fit sees them only at
    the moments when a count changes.
    """
    size = np.zeros(coordinates.size)
    size[:N_STEADY] = [*_KICKS, *_KICKS, _KICK]
    size[coordinates.yields] = _KICK
    fine = np.zeros(coordinates.size)
    fine[coordinates.yields] = np.exp(free[coordinates.yields]) < _FEW_COUNTS * count
    return ((size + _FINE_KICK * fine) * rng.standard_normal(coordinates.size)
            + _FINE_KICK * fine * rng.standard_normal())


def fit_all(bundle, starts, extras, *, blocks=CANDIDATES, say=lambda text: None):
    """
    Fit all joints, in as many threads.

    Parameters
    ----------
    bundle : Bundle
        All data.
    starts : sequence of Start
        One per joint.
    extras : sequence of ndarray
        Further coefficients of each joint to begin with.
    blocks : sequence of int
        Numbers of blocks to try.
    say : callable, optional
        Told what is being done.

    Returns
    -------
    list of JointFit
        One per joint.

    """
    thetas = [rough_theta(start, extra) for start, extra in zip(starts, extras, strict=True)]
    joints = range(len(starts))
    with ThreadPoolExecutor(max_workers=len(starts)) as pool:
        say('fitting each joint')
        rough = coarser(bundle, COARSE)
        fits = list(pool.map(lambda j: fit_joint(rough, j, thetas, starts[j], extras[j], blocks),
                             joints))
        say('refining each joint, the others as they were found')
        found = [fit.coordinates.unpack(fit.free)[0] for fit in fits]
        return list(pool.map(lambda j: finish(bundle, j, found, fits[j]), joints))


def finish(bundle, joint, thetas, fit):
    """Refine a fit now that the other joints are known: without the data held out, then on all."""
    coordinates, prior, rough = fit.coordinates, fit.prior, coarser(bundle, COARSE)
    training = Objective(bundle, joint, thetas, train(bundle.period))
    held = refine(training, coordinates, fit.free, prior, sharpness=2.0, roughly=True).free
    held, scatter = hop(Objective(rough, joint, thetas, train(rough.period)), coordinates, held,
                        prior, 2.0 * bundle.half[joint],
                        np.random.default_rng(joint))
    held = refine(training, coordinates, held, prior).free
    refined = refine(Objective(bundle, joint, thetas), coordinates, held, prior)
    half = coarser(bundle, 2.0 * bundle.period)
    seldom = refine(Objective(half, joint, thetas), coordinates, refined.free, prior).free
    return fit._replace(free=refined.free, evaluation=refined.evaluation,
                        held_out=fit.held_out._replace(free=held), settled=refined.settled,
                        sampling=np.hypot(scatter, seldom - refined.free))


def rough_theta(start, extra):
    """Return parameters as the start has them, blocks of equal weight over the spread."""
    coordinates = Coordinates(len(start.yields), n_extra=len(extra))
    both = np.array([start.forward, start.backward]).T
    return coordinates.unpack(coordinates.pack(*both, start.attraction, start.yields,
                                               extra=extra))[0]
