# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The fit of all joints' friction: in which order their parameters are sought, and from where.

First come blocks with fixed yield displacements, spread over decades, and free weights: a smooth
problem that finds the shape of the presliding curve from far away. Then blocks of equal weight
at the quantiles of that shape, for several N; the data held out choose among them. The observer
of the predictor is stiff at first and soft in the end: stiff, each innovation depends on the
last moments only and the cost has hardly any local minimum; soft, it says the most.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

from gms_flex_control.identification.coordinates import (
    Coordinates,
    equal_blocks,
    MOST_BLOCKS,
    N_STEADY,
    of_direction,
    slipping,
    with_narrow_curves,
)
from gms_flex_control.identification.friction_map import Start
from gms_flex_control.identification.least_squares import (
    best_from,
    fit_torque,
    IMPROVEMENT,
    multi_start,
    NARROW,
    Prior,
    prior_of,
    refine,
    Refined,
    TorqueError,
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
from gms_flex_control.simulation.predictor import PER_DIRECTION, VELOCITY
import numpy as np

COARSE = 4e-3         # sample that is fine enough to find the way [s]
# of multi-starts in turn, samples [s] and the factor on the observer's bandwidth: with coarse
# samples and a soft observer, which sees what acts for long, the cost has fewer local minima
LEVELS = ((8e-3, 0.5), (4e-3, 0.5), (2e-3, 0.5), (2e-3, 1.0))
_TORQUE_FITS = 2      # the second with blocks in the place of those that never slip
_BESIDE = 2           # turns of joints that act on each other
_SPREAD_SHARPNESS = (3.0, 1.0)
_SOFT = 0.5           # of the observer's bandwidth: another that is right as well
_PATIENCE, _PATIENCE_LAST = 8, 5  # fits in a row without improvement that end a multi-start
_MORE_TURNS = 2       # of all joints at the last level, at most


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
        fits = list(pool.map(partial(fit_again, blocks=blocks), objectives_of(rough, fits), fits))
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
    they go on in turn while any improves.
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
        fits, improvements = zip(*pool.map(_searched, *zip(*tasks, strict=True)), strict=True)
        if turn >= last and max(improvements) < IMPROVEMENT:
            break
    return fits


def _searched(objective, fit, rng, patience, all_ends, again):
    """
    Return the best JointFit near one, or near all its ends, and by how much it improved.

    What good ends differ by is kept where the same look at the data is repeated (``again``).
    """
    bundle = objective.bundle
    found = multi_start(objective.of(train(bundle.period)), fit.coordinates,
                        fit.ends if all_ends and fit.ends else (fit.free,), fit.prior,
                        2.0 * bundle.half[objective.joint], rng, patience)
    scatter = np.maximum(found.scatter, fit.sampling) if again else found.scatter
    return fit._replace(free=found.ends[0], sampling=scatter, ends=found.ends), found.improvement


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
    wide = theta[[VELOCITY, PER_DIRECTION + VELOCITY]] > NARROW[-1] * top
    if not wide.any():
        return None, np.nan
    begins = [with_narrow_curves(end.free, share * top) for share in NARROW]
    for begin in begins:
        for way in np.flatnonzero(~wide):
            begin[of_direction(way)] = end.free[of_direction(way)]
        if not wide.all():
            begin[N_STEADY - 1] = end.free[N_STEADY - 1]
    floor = end.evaluation.floor
    best = best_from(objective, coordinates, begins, prior, floor)
    off = replace(best.evaluation, floor=floor).cost - end.evaluation.cost
    return best, off.sum() / max(off.std() * np.sqrt(len(off)), 1e-12)
