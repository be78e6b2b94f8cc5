# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
All friction parameters of a joint refined together, from many starts.

First come blocks with fixed yield displacements, spread over decades, and free weights: a smooth
problem that finds the shape of the presliding curve from far away. Then blocks of equal weight
at the quantiles of that shape, for several N; the data held out choose among them. The observer
of the predictor is stiff at first and soft in the end: stiff, each innovation depends on the
last moments only and the cost has hardly any local minimum; soft, it says the most.

Where links stick and slip the cost is rough: a fit ends in one of many local minima. Those near
the truth lie along a funnel, so that fits from perturbations of the best find a better one until
none is better. What the good ones differ by is reported as uncertainty.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from gms_flex_control.identification.coordinates import (
    Coordinates,
    equal_blocks,
    MOST_BLOCKS,
    N_STEADY,
    of_direction,
    slipping,
    with_both_as,
    with_narrow_curves,
)
from gms_flex_control.identification.friction_map import Start
from gms_flex_control.identification.least_squares import (
    fit_torque,
    Prior,
    prior_of,
    refine,
    Refined,
    TorqueError,
    total_cost,
)
from gms_flex_control.identification.objective import Bundle, coarser, Objective, train
from gms_flex_control.identification.outcome import CONFIDENT
from gms_flex_control.identification.segments import travel
from gms_flex_control.identification.selection import (
    CANDIDATES,
    fit_again,
    fit_joint,
    JointFit,
    objectives_of,
)
from gms_flex_control.identification.uncertainty import widening
from gms_flex_control.simulation.predictor import PER_DIRECTION, VELOCITY
import numpy as np

COARSE = 4e-3         # sample that is fine enough to find the way [s]
# of multi-starts in turn, samples [s] and the factor on the observer's bandwidth: with coarse
# samples and a soft observer, which sees what acts for long, the cost has fewer local minima
LEVELS = ((8e-3, 0.5), (4e-3, 0.5), (2e-3, 0.5), (2e-3, 1.0))
GAIN = 1.02           # of the cost, that makes it worth to go on
KEPT = 4              # ends with coarse samples that fine ones begin from
_TORQUE_FITS = 2      # the second with blocks in the place of those that never slip
_BESIDE = 2           # turns of joints that act on each other
_SPREAD_SHARPNESS = (3.0, 1.0)
_SOFT = 0.5           # of the observer's bandwidth: another that is right as well
_PATIENCE, _PATIENCE_LAST = 8, 5  # fits in a row without a gain that end a multi-start
_MORE_TURNS = 2       # of all joints at the last level, at most
_MOST = 32            # perturbed fits in all
_TRIED, _HOPELESS = 3, 1.25  # steps of a fit, and cost over the best beyond which it then ends
_CARRIED, _POOR = 8, 2.0  # likewise of a fit that begins where one with coarser samples ended
_STEADY = (0.002, 0.05, 0.02, 0.01)  # perturbation of F_c, F_s - F_c, v_s, sigma_2 (logarithms)
_BLOCKS, _FINE = 0.05, 0.12  # of attraction and yields; more of those within few counts
_WIDE = 0.3           # of those together, every other time
_FEW_COUNTS = 1.5
_LOST = 10.0          # v_s of one direction over the other's: robots are drawn with 1.6 at most
_NARROW = (0.002, 0.01, 0.05)  # of the top speed: v_s of curves that begin where both are lost
_LOST_BLOCK = 3.0     # times its neighbour's yield, or less in that ratio
_GOOD = 1.15          # times the lowest cost: as good an explanation


def fit_all(bundle: Bundle, starts: Sequence[Start], extras: Sequence, steps: Sequence[float], *,
            blocks=CANDIDATES, say: Callable = lambda text: None) -> list[JointFit]:
    """
    Fit all joints, in as many threads.

    ``extras`` are further coefficients of each joint to begin with, ``steps`` (n,) of encoders or
    noise [rad], ``blocks`` the numbers of blocks to choose from; ``say`` is called with what is
    being done.
    """
    thetas = [rough_theta(start, extra) for start, extra in zip(starts, extras, strict=True)]
    joints, rough = range(len(starts)), coarser(bundle, COARSE)
    with ThreadPoolExecutor(max_workers=len(starts)) as pool:
        say('fitting each joint')
        training = [Objective(rough, j, thetas, train(rough.period)) for j in joints]
        thetas = list(pool.map(_spread, training, starts, extras))
        by_torque = list(pool.map(_by_torque, training, thetas, steps))
        thetas = _better(pool, rough, (by_torque, thetas))
        fits = list(pool.map(partial(fit_joint, blocks=blocks), [
            Objective(rough, j, thetas) for j in joints]))
        say('refining each joint, the others as they were found')
        fits = _search(pool, bundle, fits, LEVELS)
        fits = list(pool.map(
            partial(fit_again, blocks=blocks), objectives_of(rough, fits), fits))
        if not all(fit.ends for fit in fits):  # not where the search ended
            fits = _search(pool, bundle, fits, LEVELS[-1:])
        fits = [fit.slipping(travel(bundle.segments, j)) for j, fit in enumerate(fits)]
        return list(pool.map(_finish, objectives_of(bundle, fits), fits))


def fit_beside(bundle: Bundle, fits: Sequence[JointFit]) -> list[JointFit]:
    """Return JointFits where a Bundle, whose arm is hardly another, has its nearest minimum."""
    with ThreadPoolExecutor(max_workers=len(fits)) as pool:
        for _ in range(_BESIDE if bundle.arm.kind == 'planar' and len(fits) > 1 else 1):
            fits = list(pool.map(_finish, objectives_of(bundle, fits), fits))
    return fits


def rough_theta(start: Start, extra) -> np.ndarray:
    """Return parameters as the start has them, blocks of equal weight over the spread."""
    coordinates = Coordinates(len(start.yields), n_extra=len(extra))
    steady, _ = start.both()
    return coordinates.parameters(coordinates.pack(*steady, start.attraction, start.yields,
                                                   extra=extra))


def _spread(objective, start, extra):
    """Return parameters of blocks with fixed yields, the better of two fits."""
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
    best = min(ends, key=lambda end: replace(end.evaluation, floor=floor).cost.sum())
    return coordinates.parameters(best.free)


def _by_torque(objective, theta, step):
    """
    Return the parameters of as many blocks as there may be that explain the torque best.

    Motion that was measured moves all joints here, whatever friction the others are taken to have.
    """
    error = TorqueError(objective, train(objective.bundle.period), step)
    reach = travel(objective.bundle.segments, objective.joint)
    for _ in range(_TORQUE_FITS):
        coordinates, free = equal_blocks(theta, MOST_BLOCKS)
        found = coordinates.parameters(
            fit_torque(error, coordinates, free, prior_of(coordinates, free)))
        theta = slipping(found, reach)
        if theta is found:
            break
    return theta


def _better(pool, bundle, several):
    """
    Return of several sets of parameters that which predicts the motion best.

    Of axes that do not act on each other the best of each.
    """
    def looked(sets, j):
        objective = Objective(bundle, j, sets, train(bundle.period))
        return objective.evaluate(*equal_blocks(sets[j], MOST_BLOCKS), 1.0, derivatives=False)

    def costs(j):
        found = [looked(sets, j) for sets in several]
        floor = min(one.floor for one in found)
        return [replace(one, floor=floor).cost.sum() for one in found]
    table = np.nan_to_num(list(pool.map(costs, range(len(several[0])))), nan=np.inf)
    if bundle.arm.kind == 'planar':
        table[:] = table.sum(axis=0)
    return [several[k][j] for j, k in enumerate(np.argmin(table, axis=1))]


def _search(pool, bundle, fits, levels):
    """
    Return fits from multi-starts of all joints, coarse samples and a soft observer first.

    Each has the others as last found. Links of a planar arm act on each other: with a wrong
    friction of one joint the best of another is no minimum at all, or one far from the truth. So
    they go on in turn while any gains.
    """
    looks = [(max(period, bundle.period), softness) for period, softness in levels]
    coupled = bundle.arm.kind == 'planar' and len(fits) > 1
    if not coupled:
        looks = list(dict.fromkeys(looks))
    rough, last = [coarser(bundle, period) for period, _ in looks], len(looks) - 1
    levels = [one._replace(observer=softness * one.observer)
              for one, (_, softness) in zip(rough, looks, strict=True)]
    if coupled:
        levels += [levels[-1]] * _MORE_TURNS
    for turn, level in enumerate(levels):
        patience = _PATIENCE if turn < last else _PATIENCE_LAST
        tasks = [(objective, fit, np.random.default_rng([turn, objective.joint]), patience,
                  turn == last, turn > last)
                 for objective, fit in zip(objectives_of(level, fits), fits, strict=True)]
        fits, gains = zip(*pool.map(_searched, *zip(*tasks, strict=True)), strict=True)
        if turn >= last and max(gains) < GAIN:
            break
    return fits


def _searched(objective, fit, rng, patience, all_ends, again):
    """
    Return the best JointFit near one, or near all its ends, and how much was gained.

    What good ends differ by is kept where the same look at the data is repeated (``again``).
    """
    bundle = objective.bundle
    found = multi_start(objective.of(train(bundle.period)), fit.coordinates,
                        fit.ends if all_ends and fit.ends else (fit.free,), fit.prior,
                        2.0 * bundle.half[objective.joint], rng, patience)
    scatter = np.maximum(found.scatter, fit.sampling) if again else found.scatter
    return fit._replace(free=found.ends[0], sampling=scatter, ends=found.ends), found.gain


def _finish(objective, fit):
    """Refine a fit with all samples: without the data held out, then on all."""
    coordinates, prior, bundle = fit.coordinates, fit.prior, objective.bundle
    held = refine(objective.of(train(bundle.period)), coordinates, fit.free, prior).free
    refined = refine(objective, coordinates, held, prior)
    narrow, above = narrower_curves(objective, coordinates, refined, prior)
    if narrow and above < -CONFIDENT:
        held = refine(objective.of(train(bundle.period)), coordinates, narrow.free, prior).free
        refined = refine(objective, coordinates, narrow.free, prior)
    rivals = (coordinates.parameters(narrow.free),) if narrow and abs(above) <= CONFIDENT else ()
    others = (refine(objective.of(bundle=coarser(bundle, 2.0 * bundle.period)), coordinates,
                     refined.free, prior),
              refine(objective, coordinates, refined.free, prior, sharpness=_SOFT))
    moved = sum((other.free - refined.free) ** 2 for other in others)
    return fit._replace(free=refined.free, evaluation=refined.evaluation, held=held,
                        rivals=(*fit.rivals, *rivals),
                        sampling=np.sqrt(fit.sampling ** 2 + moved))


def narrower_curves(objective: Objective, coordinates: Coordinates, end: Refined,
                    prior: Prior) -> tuple[Refined | None, float]:
    """
    Return the best Refined with narrower Stribeck curves, or None, and by how much it is worse.

    In standard errors of the difference, from blocks of time. A wide curve takes the place of
    F_c and of viscous friction, and steps do not lead from it to a narrow one.
    """
    theta, top = coordinates.parameters(end.free), objective.fastest
    wide = theta[[VELOCITY, PER_DIRECTION + VELOCITY]] > _NARROW[-1] * top
    if not wide.any():
        return None, np.nan
    begins = [with_narrow_curves(end.free, share * top) for share in _NARROW]
    for begin in begins:
        for way in np.flatnonzero(~wide):
            begin[of_direction(way)] = end.free[of_direction(way)]
        if not wide.all():
            begin[N_STEADY - 1] = end.free[N_STEADY - 1]
    floor = end.evaluation.floor
    best = _best_from(objective, coordinates, begins, prior, floor)
    off = replace(best.evaluation, floor=floor).cost - end.evaluation.cost
    return best, off.sum() / max(off.std() * np.sqrt(len(off)), 1e-12)


class MultiStart(NamedTuple):
    """Outcome of a multi-start."""

    ends: tuple            # of free numbers (P,), the best first
    scatter: np.ndarray    # (P,), standard deviation of the good ones about the best
    gain: float            # cost where they began over that of the best


def multi_start(objective: Objective, coordinates: Coordinates, starts: Sequence, prior,
                count: float, rng, patience: int) -> MultiStart:
    """
    Refine again from perturbations of the best so far, as long as it pays, and keep the best.

    ``starts`` are free numbers, the best first; ``count`` the encoder step or noise [rad]; it ends
    after ``patience`` fits in a row without a gain. The scatter is as much larger as Student's
    distribution is wider for so few: what the roughness leaves open.
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
        gain = _cost_above(best, floor, prior) / _cost_above(ends[-1], floor, prior)
        idle = 0 if gain > GAIN else idle + 1
    ends.sort(key=lambda end: _cost_above(end, floor, prior))
    lowest = _cost_above(ends[0], floor, prior)
    ordered = [_in_order(coordinates, end.free) for end in ends]
    good = [free for free, end in zip(ordered, ends, strict=True)
            if _cost_above(end, floor, prior) <= _GOOD * lowest]
    scatter = widening(max(len(good) - 1, 2)) * np.sqrt(np.mean(
        np.square(np.array(good) - good[0]), axis=0))
    gain = total_cost(replace(begin, floor=floor), starts[0], prior) / lowest
    return MultiStart(tuple(ordered[:KEPT]), scatter, gain)


def _best_from(objective, coordinates, begins, prior, floor):
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
        begins = [with_narrow_curves(end.free, share * top) for share in _NARROW]
    elif velocities.max() > _LOST * velocities.min():
        begins = [with_both_as(end.free, way) for way in range(2)]
    else:
        return end
    floor = end.evaluation.floor
    best = _best_from(objective, coordinates, begins, prior, floor)
    better = GAIN * _cost_above(best, floor, prior) < _cost_above(end, floor, prior)
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
            if worse >= (1.0 if _lost_block(coordinates, other.free, side) else GAIN):
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
    end = refine(objective, coordinates, free, prior, roughly=True, floor=floor,
                 iterations=steps)
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
