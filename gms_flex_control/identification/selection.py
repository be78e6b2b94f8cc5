# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
How many blocks the fit of a joint has: as few as the data held out leave open.

Numbers that may not be chosen are fitted as well: they show what depends on the number.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

from gms_flex_control.data.signal_analysis import FRICTION_FOLDS
from gms_flex_control.identification.coordinates import (
    Coordinates,
    equal_blocks,
    MOST_BLOCKS,
    slipping,
    with_both_as,
)
from gms_flex_control.identification.least_squares import Prior, prior_of, refine
from gms_flex_control.identification.objective import (
    Bundle,
    Evaluation,
    held_out,
    Objective,
    train,
)
from gms_flex_control.identification.outcome import BlockCandidate
import numpy as np
from scipy.stats import t as student

CANDIDATES = (1, 2, 4, 6, 8)  # numbers of blocks that are tried
_SHARPNESS = (2.0, 1.0)
_AWAY = 2.0           # times the largest cost of a block
_FEW_OUT = 6          # blocks held out, fewer of which hardly show their scatter
_ONE_ERROR = 0.8413    # of a normal distribution is below one standard deviation


class JointFit(NamedTuple):
    """What the fit of one joint ended with."""

    coordinates: Coordinates
    free: np.ndarray
    prior: Prior
    held: np.ndarray       # free numbers fitted without the data held out
    candidates: tuple      # of BlockCandidate
    sampling: np.ndarray   # what numbers move by as the data are looked at in other ways, (P,)
    rivals: tuple = ()     # of parameters: other numbers of blocks that may be right as well
    ends: tuple = ()       # of free numbers, where the multi-start ended, the best first
    fits: tuple = ()       # of (Coordinates, free): each number of blocks, some data held out
    evaluation: Evaluation | None = None  # on all data

    @property
    def theta(self) -> np.ndarray:
        """Return the parameters."""
        return self.coordinates.parameters(self.free)

    def alike_both_ways(self, unmoved) -> Self:
        """Return it with friction of a direction without motion (0, 1 or None) as the other's."""
        if unmoved is None:
            return self
        free, held = (with_both_as(one, 1 - unmoved) for one in (self.free, self.held))
        return self._replace(free=free, held=held)

    def slipping(self, reach: float) -> Self:
        """
        Return it without the blocks that never slip within ``reach`` [rad].

        Held by the motion, they take part of the levels without being friction.
        """
        yields = self.coordinates.yields
        idle = yields.start + np.flatnonzero(np.exp(self.free[yields]) >= reach)
        fewer = self.coordinates.n_blocks - len(idle)
        if fewer in (0, self.coordinates.n_blocks):
            return self
        coordinates, free = equal_blocks(slipping(self.theta, reach), fewer)
        return self._replace(
            coordinates=coordinates, free=free, prior=prior_of(coordinates, free), held=free,
            sampling=np.delete(self.sampling, idle), ends=(),
            rivals=tuple(slipping(one, reach) for one in self.rivals),
            candidates=tuple(
                one._replace(n_blocks=fewer) if one.n_blocks == self.coordinates.n_blocks else one
                for one in self.candidates if one.n_blocks != fewer))


def objectives_of(bundle: Bundle, fits: Sequence[JointFit]) -> list[Objective]:
    """Return the Objective of each joint, the others as JointFits have them."""
    thetas = [fit.theta for fit in fits]
    return [Objective(bundle, j, thetas) for j in range(len(fits))]


def _fit_candidate(objective, n_blocks):
    """Return Coordinates and free numbers of N blocks, fitted without the data held out."""
    training = objective.of(train(objective.bundle.period))
    coordinates, free = equal_blocks(objective.thetas[objective.joint], n_blocks)
    prior = prior_of(coordinates, free)
    for sharpness in _SHARPNESS:
        free = refine(training, coordinates, free, prior, sharpness=sharpness, roughly=True).free
    return coordinates, free


def choose(objective: Objective, fits: Sequence, blocks: Sequence) -> tuple:
    """
    Return BlockCandidates, the pair whose held-out error no other beats beyond chance, its rivals.

    ``fits`` are pairs (Coordinates, free numbers) without the data held out, ``blocks`` the
    numbers that may be chosen. The candidates are of each such number the best; the chosen pair
    has the fewest blocks within one standard error of the best; rivals are the parameters of all
    others that are no worse beyond one standard error of the difference, by Student's
    distribution for so many blocks of time.
    """
    costs, count = _held_out_costs(objective, fits)
    order = sorted(range(len(fits)), key=lambda k: (fits[k][0].n_blocks, costs[k].sum()))
    fits, costs = [fits[k] for k in order], costs[order]
    offered = np.array([coordinates.n_blocks in blocks for coordinates, _ in fits])
    off, errors = _above(costs, int(np.argmin(np.where(offered, costs.sum(axis=1), np.inf))))
    shown = {}
    for k in np.flatnonzero(offered):
        n_blocks = fits[k][0].n_blocks
        shown.setdefault(n_blocks, BlockCandidate(
            n_blocks, float(costs[k].sum() / count), float(errors[k] / count), False))
    chosen = int(np.flatnonzero(offered & (off <= errors))[0])
    off, errors = _above(costs, chosen)
    blocks_out = costs.shape[1]
    # of few blocks the scatter is hardly known, of one not at all
    errors = errors * student.ppf(_ONE_ERROR, blocks_out - 1) * np.sqrt(
        blocks_out / (blocks_out - 1)) if blocks_out > 1 else np.full(len(fits), np.inf)
    rivals = tuple(coordinates.parameters(free) for k, (coordinates, free) in enumerate(fits)
                   if k != chosen and off[k] <= errors[k])
    return tuple(shown.values()), fits[chosen], rivals


def _held_out_costs(objective, fits):
    """Return the cost of each fit in each block of time held out (K, B), and samples in all."""
    costs, count = [], 0.0
    for turn in range(FRICTION_FOLDS):
        out, fitted = (objective.of(of(objective.bundle.period, turn)) for of in (held_out, train))
        if turn and not (out.counts and fitted.counts):
            continue
        evaluations = [out.evaluate(coordinates, free if turn == 0 else refine(
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


def _above(costs, best):
    """Return by how much costs (K, B) are above those of one of them, and standard errors."""
    off = costs - costs[best]
    return off.sum(axis=1), off.std(axis=1) * np.sqrt(off.shape[1])


def fit_joint(objective: Objective, blocks: Sequence) -> JointFit:
    """Fit one joint with each number of blocks, chosen or shown only, and choose among them."""
    fits = [_fit_candidate(objective, n) for n in sorted({*blocks, *CANDIDATES})]
    return _unsearched(*choose(objective, fits, blocks))._replace(fits=tuple(fits))


def fit_again(objective: Objective, fit: JointFit, blocks: Sequence) -> JointFit:
    """
    Return a JointFit with the number of blocks that is best from where the search ended.

    From far away each number ends in a local minimum of its own, and the best of these need not
    be the best number. Where several are, all that the data do not rule out are rivals. A fit
    that is not that of the search has no ``ends``.
    """
    again = [_fit_candidate(objective, n)
             for n in sorted({*blocks, *CANDIDATES} - {fit.coordinates.n_blocks})]
    candidates, best, rivals = choose(
        objective, [*fit.fits, (fit.coordinates, fit.free), *again], blocks)
    if best[1] is fit.free:
        return fit._replace(held=best[1], candidates=candidates, rivals=rivals)
    return _unsearched(candidates, best, rivals)


def _unsearched(candidates, chosen, rivals):
    """Return the JointFit of what `choose` returns, for a search to begin from."""
    coordinates, free = chosen
    return JointFit(coordinates, free, prior_of(coordinates, free), free, candidates,
                    np.zeros(len(free)), rivals)


def few_blocks(fit: JointFit) -> tuple[str, ...]:
    """Return a sentence where a JointFit has as many blocks as were tried and more can be."""
    most = max(candidate.n_blocks for candidate in fit.candidates)
    if fit.coordinates.n_blocks < most or most == MOST_BLOCKS:
        return ()
    return (f'N = {most} is the largest number of blocks that may be chosen. Where presliding '
            'needs more, other parameters take part of its place: allow more '
            f'(--blocks, up to {MOST_BLOCKS})',)
