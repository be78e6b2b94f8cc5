# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Fits from a little beside the best so far, and the best of them.

Where links stick and slip the cost is rough: a fit ends in one of many hollows. The hollows near
the truth lie along a funnel, so that a short walk from the best finds a better one until there
is none. What the good ones differ by is told as uncertainty.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.identification.coordinates import N_STEADY
from gms_flex_control.identification.refine import refine, total_cost
import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

GAIN = 1.02           # of the cost, that makes it worth to go on
_MOST = 32            # fits from beside the best in all
_TRIED, _HOPELESS = 3, 1.25  # steps of a fit, and cost over the best beyond which it then ends
_CARRIED, _POOR = 8, 2.0  # likewise of a fit that begins where one with coarser samples ended
KEPT = 4              # ends of hops with coarse samples that fine ones begin from
_KICKS = (0.002, 0.05, 0.02, 0.01)  # how far beside: F_c, F_s - F_c, v_s, sigma_2 (logarithms)
_KICK, _FINE_KICK = 0.05, 0.12  # of attraction and yields; more of those within few counts
_WIDE_KICK = 0.3      # of those together, every other time
_FEW_COUNTS = 1.5
_GOOD = 1.15          # times the lowest cost: as good an explanation
_UPPER = 0.975        # of a 95 % interval


class Hopped(NamedTuple):
    """Outcome of hops."""

    ends: tuple            # of free numbers (P,), the best first
    scatter: np.ndarray    # (P,), standard deviation of the good ones about the best
    gain: float            # cost where they began over that of the best


def hop(objective, coordinates, starts, prior, count, rng, patience):
    """
    Refine again from a little beside the best so far, as long as it pays, and keep the best.

    Parameters
    ----------
    objective, coordinates, prior
        As `refine`.
    starts : sequence of ndarray, shape (P,)
        Free numbers to begin with, the best first.
    count : float
        Encoder step or noise [rad].
    rng : numpy.random.Generator
        Says where beside.
    patience : int
        Fits in a row without a gain after which it ends.

    Returns
    -------
    Hopped
        The scatter is as much larger as Student's distribution is wider for so few: what the
        roughness leaves open.

    """
    begin = objective.evaluate(coordinates, starts[0], 1.0)
    ends = [refine(objective, coordinates, starts[0], prior, roughly=True)]
    floor, idle = ends[0].evaluation.floor, 0
    carried = list(starts[1:])
    while len(ends) <= _MOST and (carried or idle < patience):
        best = min(ends, key=lambda end: cost_behind(end, floor, prior))
        lowest = cost_behind(best, floor, prior)
        if carried:
            ends.append(tried(objective, coordinates, carried.pop(0), prior, floor,
                              _CARRIED, _POOR * lowest))
        else:
            start = best.free + kick(coordinates, best.free, count, rng, len(ends) % 2)
            ends.append(tried(objective, coordinates, start, prior, floor, _TRIED,
                              _HOPELESS * lowest))
        # what the best explain decides what counts as explained: bad hollows look alike above it
        floor = min(floor, objective.floor_of(ends[-1].evaluation.square))
        gain = cost_behind(best, floor, prior) / cost_behind(ends[-1], floor, prior)
        idle = 0 if gain > GAIN else idle + 1
    ends.sort(key=lambda end: cost_behind(end, floor, prior))
    lowest = cost_behind(ends[0], floor, prior)
    ordered = [in_order(coordinates, end.free) for end in ends]
    good = [free for free, end in zip(ordered, ends, strict=True)
            if cost_behind(end, floor, prior) <= _GOOD * lowest]
    few = student.ppf(_UPPER, max(len(good) - 1, 2)) / norm.ppf(_UPPER)  # so few tell little
    scatter = few * np.sqrt(np.mean(np.square(np.array(good) - good[0]), axis=0))
    gain = total_cost(replace(begin, floor=floor), starts[0], prior) / lowest
    return Hopped(tuple(ordered[:KEPT]), scatter, gain)


def tried(objective, coordinates, free, prior, floor, steps, limit):
    """Return a Refined from ``free``, left where it is if few steps do not get below ``limit``."""
    end = refine(objective, coordinates, free, prior, roughly=True, floor=floor,
                 iterations=steps)
    if end.settled or cost_behind(end, floor, prior) > limit:
        return end
    return refine(objective, coordinates, end.free, prior, roughly=True, floor=floor)


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


def kick(coordinates, free, count, rng, wide):
    """
    Return a random change of free numbers, about as large as they are uncertain.

    Blocks that break away within a few counts move most, and together: a fit sees them only at
    the moments when a count changes; ``wide`` moves them together far.
    """
    size = np.zeros(coordinates.size)
    size[:N_STEADY] = [*_KICKS, *_KICKS, _KICK]
    size[coordinates.yields] = _KICK
    fine = np.zeros(coordinates.size)
    fine[coordinates.yields] = np.exp(free[coordinates.yields]) < _FEW_COUNTS * count
    return ((size + _FINE_KICK * fine) * rng.standard_normal(coordinates.size)
            + (_WIDE_KICK if wide else _FINE_KICK) * fine * rng.standard_normal())
