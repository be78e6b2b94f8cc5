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
from gms_flex_control.identification.hops import GAIN, hop
from gms_flex_control.identification.objective import BLOCK_TIME, coarser, Objective
from gms_flex_control.identification.refine import Prior, refine
from gms_flex_control.simulation.predictor import BLOCKS, parameter_rows
import numpy as np
from scipy.stats import t as student

COARSE = 4e-3         # sample that is fine enough to find the way [s]
# of hops in turn, samples [s] and the factor on the observer's bandwidth: with coarse samples and
# a soft observer, which sees what acts for long, the cost has fewer hollows
LEVELS = ((8e-3, 0.5), (4e-3, 0.5), (2e-3, 0.5), (2e-3, 1.0))
CANDIDATES = (1, 2, 4, 6, 8)  # numbers of blocks that are tried
_SPREAD_SHARPNESS = (3.0, 1.0)
_SHARPNESS = (2.0, 1.0)
FOLDS = 4             # one in so many blocks of time is held out
_AWAY = 2.0           # times the largest cost of a block
_FEW_OUT = 6          # blocks held out, fewer of which hardly tell their scatter
_STEADY_DOUBT, _BLOCK_DOUBT = 1.0, 3.0  # spread of the prior, of logarithms
_EXTRA_DOUBT = 1.0    # of corrections, in their units
_ONE_ERROR = 0.8413    # of a normal distribution is below one standard deviation
_SOFT = 0.5           # of the observer's bandwidth: another that is right as well
_PATIENCE, _PATIENCE_LAST = 8, 5  # fits in a row without a gain that end hops of a level
_MORE_TURNS = 2       # of hops of all joints at the last level, at most


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
    sampling: np.ndarray   # what numbers move by as the data are looked at in other ways, (P,)
    rivals: tuple = ()     # of parameters: other numbers of blocks that may be right as well
    ends: tuple = ()       # of free numbers, where hops ended, the best first
    fits: tuple = ()       # of (Coordinates, free): each number of blocks, some data held out


def prior_of(coordinates, free):
    """Return the weak Prior around free numbers."""
    precision = np.full(coordinates.size, _BLOCK_DOUBT ** -2)
    precision[:N_STEADY] = _STEADY_DOUBT ** -2
    precision[coordinates.size - coordinates.n_extra:] = _EXTRA_DOUBT ** -2
    return Prior(free.copy(), precision)


def held_out(period, turn=0):
    """Return a function Stretch -> bool (T,) of the samples not to be fitted in a turn."""
    length = max(round(BLOCK_TIME / period), 1)
    return lambda stretch: (stretch.first_block + np.arange(len(stretch.angle)) // length
                            ) % FOLDS == FOLDS - 1 - turn


def numbered(stretches, period):
    """Return stretches with their blocks of time numbered; the last of few is held out."""
    counts = [max(len(stretch.angle) * period // BLOCK_TIME, 1.0) for stretch in stretches]
    begin = max(FOLDS - int(sum(counts)), 0)
    firsts = begin + np.concatenate([[0], np.cumsum(counts)]).astype(int)
    return [replace(stretch, first_block=int(first))
            for stretch, first in zip(stretches, firsts[:-1], strict=True)]


def train(period, turn=0):
    """Return a function Stretch -> bool (T,) of the samples to be fitted in a turn."""
    out = held_out(period, turn)
    return lambda stretch: ~out(stretch)


def spread(objective, start, extra):
    """Return Coordinates and free numbers of blocks with fixed yields, the better of two fits."""
    coordinates = Coordinates(len(start.yields), yields=start.yields, free_weights=True,
                              n_extra=len(extra))
    ends = []
    for steady in start.both():
        free = coordinates.pack(*steady, start.attraction, None, extra=extra)
        prior = prior_of(coordinates, free)
        for sharpness in _SPREAD_SHARPNESS:
            end = refine(objective, coordinates, free, prior, sharpness=sharpness, roughly=True)
            free = end.free
        ends.append(end)
    floor = min(end.evaluation.floor for end in ends)
    return coordinates, min(ends, key=lambda end: replace(
        end.evaluation, floor=floor).cost.sum()).free


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
        free = refine(objective, coordinates, free, prior, sharpness=sharpness, roughly=True).free
    return coordinates, free


def choose(bundle, joint, thetas, fits, blocks):
    """
    Return the candidates, the one whose held-out error no other beats beyond chance, its rivals.

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
    blocks : sequence of int
        Numbers of blocks that may be chosen.

    Returns
    -------
    candidates : tuple of Candidate
        Those that may be chosen: of each number of blocks the best.
    chosen : Candidate
        The fewest blocks within one standard error of the best.
    rivals : tuple of ndarray
        Parameters of all others that are no worse beyond one standard error of the difference,
        by Student's distribution for so many blocks.

    """
    fits = sorted(fits, key=_size_of)
    costs, count = _held_out_costs(bundle, joint, thetas, fits)
    order = sorted(range(len(fits)), key=lambda k: (_size_of(fits[k]), costs[k].sum()))
    fits, costs = [fits[k] for k in order], costs[order]
    offered = np.array([coordinates.n_blocks in blocks for coordinates, _ in fits])
    off, errors = _above(costs, int(np.argmin(np.where(offered, costs.sum(axis=1), np.inf))))
    candidates = tuple(
        Candidate(coordinates.n_blocks, coordinates.free_weights, float(cost.sum() / count),
                  float(error / count), coordinates, free)
        for (coordinates, free), cost, error in zip(fits, costs, errors, strict=True))
    chosen = int(np.flatnonzero(offered & (off <= errors))[0])
    off, errors = _above(costs, chosen)
    blocks_out = costs.shape[1]
    # of few blocks the scatter is hardly known, of one not at all
    errors = errors * student.ppf(_ONE_ERROR, blocks_out - 1) * np.sqrt(
        blocks_out / (blocks_out - 1)) if blocks_out > 1 else np.full(len(fits), np.inf)
    rivals = tuple(coordinates.unpack(free)[0] for k, (coordinates, free) in enumerate(fits)
                   if k != chosen and off[k] <= errors[k])
    shown = {}
    for one, may in zip(candidates, offered, strict=True):
        if may:
            shown.setdefault(one.n_blocks, one)
    return tuple(shown.values()), candidates[chosen], rivals


def _held_out_costs(bundle, joint, thetas, fits):
    """
    Return the cost of each fit in each block of time held out (K, B), and samples in all.

    Where one turn holds few blocks out, all turns do: then each fit goes on from where it is
    without the data that judge it.
    """
    costs, count = [], 0.0
    for turn in range(FOLDS):
        objective = Objective(bundle, joint, thetas, held_out(bundle.period, turn))
        fitted = Objective(bundle, joint, thetas, train(bundle.period, turn))
        if turn and not (objective.counts and fitted.counts):
            continue
        evaluations = [objective.evaluate(coordinates, free if turn == 0 else refine(
            fitted, coordinates, free, prior_of(coordinates, free), roughly=True).free, 1.0)
            for coordinates, free in fits]
        floor = min(one.floor for one in evaluations)  # what the best explain is explained
        costs.append([replace(one, floor=floor).cost for one in evaluations])
        count += evaluations[0].count.sum()
        if len(evaluations[0].count) >= _FEW_OUT:
            break
    costs = np.concatenate(costs, axis=1)
    away = ~np.isfinite(costs)  # predictions that run away are worse than any other
    return np.where(away, _AWAY * np.max(costs, where=~away, initial=0.0), costs), count


def _size_of(fit):
    """Return the number of blocks of (Coordinates, free)."""
    return fit[0].n_blocks


def _above(costs, best):
    """Return by how much costs (K, B) are above those of one of them, and standard errors."""
    off = costs - costs[best]
    return off.sum(axis=1), off.std(axis=1) * np.sqrt(off.shape[1])


def fit_joint(bundle, joint, thetas, blocks):
    """
    Fit one joint with each number of blocks, the others as they are, and choose among them.

    Numbers that may not be chosen are fitted as well: they tell what depends on the number.

    Parameters
    ----------
    bundle : Bundle
        All data.
    joint : int
        Which joint.
    thetas : sequence of ndarray
        Parameters of all joints, its own to begin with.
    blocks : sequence of int
        Numbers of blocks to try.

    Returns
    -------
    JointFit

    """
    n_extra = len(thetas[joint]) - parameter_rows(MOST_BLOCKS, 0)
    fits = [fit_candidate(bundle, joint, thetas, thetas[joint], n, n_extra)
            for n in sorted({*blocks, *CANDIDATES})]
    candidates, best, rivals = choose(bundle, joint, thetas, fits, blocks)
    return _unsearched(candidates, best, rivals)._replace(fits=tuple(fits))


def fit_again(bundle, joint, thetas, fit, blocks):
    """
    Return a JointFit with the number of blocks that is best from where the search ended.

    From far away each number ends in a local minimum of its own, and the best of these need not
    be the best number. Where several are, all that the data do not rule out are rivals.

    Parameters
    ----------
    bundle, joint, thetas, blocks
        As `fit_joint`, the parameters as the search found them.
    fit : JointFit
        As the search found it.

    """
    n_extra, found = fit.coordinates.n_extra, fit.coordinates.n_blocks
    again = [fit_candidate(bundle, joint, thetas, thetas[joint], n, n_extra)
             for n in sorted({*blocks, *CANDIDATES} - {found})]
    candidates, best, rivals = choose(bundle, joint, thetas, [
        *fit.fits, (fit.coordinates, fit.free), *again], blocks)
    if best.free is fit.free:
        return fit._replace(held_out=best, candidates=candidates, rivals=rivals)
    return _unsearched(candidates, best, rivals)


def _unsearched(candidates, chosen, rivals):
    """Return the JointFit of what `choose` returns, for a search to begin from."""
    free = chosen.free
    return JointFit(chosen.coordinates, free, prior_of(chosen.coordinates, free), None, chosen,
                    candidates, False, np.zeros(len(free)), rivals)


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
    joints, rough = range(len(starts)), coarser(bundle, COARSE)
    with ThreadPoolExecutor(max_workers=len(starts)) as pool:
        say('fitting each joint')
        training = [Objective(rough, j, thetas, train(rough.period)) for j in joints]
        thetas = [coordinates.unpack(free)[0]
                  for coordinates, free in pool.map(spread, training, starts, extras)]
        fits = list(pool.map(lambda j: fit_joint(rough, j, thetas, blocks), joints))
        say('refining each joint, the others as they were found')
        fits = search(pool, bundle, fits, LEVELS)
        thetas, sizes = [theta_of(fit) for fit in fits], [fit.coordinates.size for fit in fits]
        fits = list(pool.map(lambda j: fit_again(rough, j, thetas, fits[j], blocks), joints))
        if [fit.coordinates.size for fit in fits] != sizes:
            fits = search(pool, bundle, fits, LEVELS[-1:])
        thetas = [theta_of(fit) for fit in fits]
        return list(pool.map(lambda j: finish(bundle, j, thetas, fits[j]), joints))


def theta_of(fit):
    """Return the parameters of a JointFit."""
    return fit.coordinates.unpack(fit.free)[0]


def search(pool, bundle, fits, levels):
    """
    Return fits from hops of all joints, coarse samples and a soft observer first.

    Each has the others as last found. Links of a planar arm act on each other: with a wrong
    friction of one joint the best of another is no hollow at all, or one far from the truth. So
    they go on in turn while any gains.

    Parameters
    ----------
    pool : Executor
        Runs joints side by side.
    bundle : Bundle
        All data.
    fits : sequence of JointFit
        One per joint.
    levels : sequence of (float, float)
        Such as `LEVELS`.

    """
    looks = [(max(period, bundle.period), softness) for period, softness in levels]
    coupled = bundle.arm.kind == 'planar' and len(fits) > 1
    if not coupled:
        looks = list(dict.fromkeys(looks))
    levels, last = [looked_at(bundle, *look) for look in looks], len(looks) - 1
    if coupled:
        levels += [levels[-1]] * _MORE_TURNS
    for turn, level in enumerate(levels):
        thetas = [theta_of(fit) for fit in fits]
        patience = _PATIENCE if turn < last else _PATIENCE_LAST
        tasks = [(level, j, thetas, fit, np.random.default_rng([turn, j]), patience,
                  turn == last, turn > last) for j, fit in enumerate(fits)]
        fits, gains = zip(*pool.map(hopped, *zip(*tasks, strict=True)), strict=True)
        if turn >= last and max(gains) < GAIN:
            break
    return fits


def looked_at(bundle, period, softness):
    """Return a bundle sampled every ``period`` [s] with another bandwidth of the observer."""
    rough = coarser(bundle, period)
    return rough._replace(observer=softness * rough.observer)


def hopped(bundle, joint, thetas, fit, rng, patience, all_ends, again=False):
    """
    Return the best JointFit near one, or near all its ends, and how much was gained.

    What good ends differ by is kept where the same look at the data is taken ``again``.
    """
    found = hop(Objective(bundle, joint, thetas, train(bundle.period)), fit.coordinates,
                fit.ends if all_ends and fit.ends else (fit.free,), fit.prior,
                2.0 * bundle.half[joint], rng, patience)
    scatter = np.maximum(found.scatter, fit.sampling) if again else found.scatter
    return fit._replace(free=found.ends[0], sampling=scatter, ends=found.ends), found.gain


def finish(bundle, joint, thetas, fit):
    """Refine a fit with all samples: without the data held out, then on all."""
    coordinates, prior = fit.coordinates, fit.prior
    held = refine(Objective(bundle, joint, thetas, train(bundle.period)), coordinates, fit.free,
                  prior).free
    objective = Objective(bundle, joint, thetas)
    refined = refine(objective, coordinates, held, prior)
    others = (refine(Objective(coarser(bundle, 2.0 * bundle.period), joint, thetas), coordinates,
                     refined.free, prior),
              refine(objective, coordinates, refined.free, prior, sharpness=_SOFT))
    moved = sum((other.free - refined.free) ** 2 for other in others)
    return fit._replace(free=refined.free, evaluation=refined.evaluation,
                        held_out=fit.held_out._replace(free=held), settled=refined.settled,
                        sampling=np.sqrt(fit.sampling ** 2 + moved))


def rough_theta(start, extra):
    """Return parameters as the start has them, blocks of equal weight over the spread."""
    coordinates = Coordinates(len(start.yields), n_extra=len(extra))
    steady, _ = start.both()
    return coordinates.unpack(coordinates.pack(*steady, start.attraction, start.yields,
                                               extra=extra))[0]
