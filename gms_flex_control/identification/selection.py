# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Which fit of a joint is chosen: the number of blocks, and what it was fitted to.

The data held out choose among numbers of blocks. The predictor's innovations weigh every moment
by how well it is understood, which says the most of an arm that is as described. On a machine
with forces that nobody has described, few moments are, and they need not be like the rest: there
a plain fit of the torque predicts better. Both are tried, and Coulomb and viscous friction with a
single stiff block as well; torque and free simulation choose among them on the data held out;
where these are few, on all of them and on each quarter held out in turn.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.identification.coordinates import (
    Coordinates,
    equal_blocks,
    MOST_BLOCKS,
)
from gms_flex_control.identification.least_squares import (
    fit_torque,
    Prior,
    prior_of,
    refine,
    TorqueError,
)
from gms_flex_control.identification.objective import (
    Bundle,
    coarser,
    Evaluation,
    everything,
    FOLDS,
    held_out,
    Objective,
    train,
)
from gms_flex_control.identification.prediction_error import (
    coulomb_viscous,
    free_run_error,
    simple_free,
)
from gms_flex_control.identification.result import Candidate
from gms_flex_control.identification.segments import moving
from gms_flex_control.identification.uncertainty import Spread, torque_spread
from gms_flex_control.simulation.predictor import parameter_rows, PER_DIRECTION, VISCOUS
import numpy as np
from scipy.stats import t as student

CANDIDATES = (1, 2, 4, 6, 8)  # numbers of blocks that are tried
_SHARPNESS = (2.0, 1.0)
_AWAY = 2.0           # times the largest cost of a block
_FEW_OUT = 6          # blocks held out, fewer of which hardly show their scatter
_ONE_ERROR = 0.8413    # of a normal distribution is below one standard deviation

INNOVATIONS, TORQUE, SIMPLE = 'innovations', 'torque', 'coulomb and viscous'
_SENTENCES = {
    INNOVATIONS: (),
    TORQUE: ('Forces that the model lacks are as large as what identifies friction: the '
             'parameters are those that predict the drive torque best, not those of friction '
             'alone.',),
    SIMPLE: ('these data do not identify GMS friction: it predicts no better than Coulomb + '
             'viscous friction, which is what was taken (one stiff block, no Stribeck part). '
             'Slow reversals and torque ramps below break-away, with an encoder that resolves '
             'them, would identify it.',)}
_MOST = 20_000        # samples that are looked at, if they are no further apart than
_COARSE = 8e-3        # [s]
_YIELDS = (2.0, 0.2, 0.6, 10.0, 50.0)  # of the simple one's block, in encoder steps
_SHORT = 60.0         # data in which one part held out is too little to choose by [s]
_WORTH = 0.97         # of the error on data held out: a fit that is no better is not chosen
_CLEAR = 0.9          # likewise where the fit itself has seen the data that decide
_NEXT_TO_NOTHING = 0.05  # of the friction torque
_FAR, _LITTLE = 0.7, 1.3  # of the errors of the innovations: where torque decides after all
_DROP, _LEVEL_SD = 0.1, 0.3  # of Coulomb friction: F_s - F_c to begin with; of its logarithm


class JointFit(NamedTuple):
    """What the fit of one joint ended with."""

    coordinates: Coordinates
    free: np.ndarray
    prior: Prior
    held: np.ndarray       # free numbers fitted without the data held out
    candidates: tuple      # of Candidate
    sampling: np.ndarray   # what numbers move by as the data are looked at in other ways, (P,)
    rivals: tuple = ()     # of parameters: other numbers of blocks that may be right as well
    ends: tuple = ()       # of free numbers, where the multi-start ended, the best first
    fits: tuple = ()       # of (Coordinates, free): each number of blocks, some data held out
    evaluation: Evaluation | None = None  # on all data

    @property
    def theta(self) -> np.ndarray:
        """Return the parameters."""
        return self.coordinates.parameters(self.free)


def _fit_candidate(bundle, joint, thetas, n_blocks, n_extra):
    """Return Coordinates and free numbers of N blocks, fitted without the data held out."""
    objective = Objective(bundle, joint, thetas, train(bundle.period))
    coordinates, free = equal_blocks(thetas[joint], n_blocks, n_extra)
    prior = prior_of(coordinates, free)
    for sharpness in _SHARPNESS:
        free = refine(objective, coordinates, free, prior, sharpness=sharpness, roughly=True).free
    return coordinates, free


def choose(bundle: Bundle, joint: int, thetas: Sequence, fits: Sequence,
           blocks: Sequence) -> tuple:
    """
    Return Candidates, the pair whose held-out error no other beats beyond chance, its rivals.

    ``fits`` are pairs (Coordinates, free numbers) without the data held out, ``blocks`` the
    numbers that may be chosen. The Candidates are of each such number the best; the chosen pair
    has the fewest blocks within one standard error of the best; rivals are the parameters of all
    others that are no worse beyond one standard error of the difference, by Student's
    distribution for so many blocks of time.
    """
    costs, count = _held_out_costs(bundle, joint, thetas, fits)
    order = sorted(range(len(fits)), key=lambda k: (fits[k][0].n_blocks, costs[k].sum()))
    fits, costs = [fits[k] for k in order], costs[order]
    offered = np.array([coordinates.n_blocks in blocks for coordinates, _ in fits])
    off, errors = _above(costs, int(np.argmin(np.where(offered, costs.sum(axis=1), np.inf))))
    shown = {}
    for k in np.flatnonzero(offered):
        n_blocks = fits[k][0].n_blocks
        shown.setdefault(n_blocks, Candidate(
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


def _above(costs, best):
    """Return by how much costs (K, B) are above those of one of them, and standard errors."""
    off = costs - costs[best]
    return off.sum(axis=1), off.std(axis=1) * np.sqrt(off.shape[1])


def fit_joint(bundle: Bundle, joint: int, thetas: Sequence, blocks: Sequence) -> JointFit:
    """
    Fit one joint with each number of blocks, the others as they are, and choose among them.

    Numbers that may not be chosen are fitted as well: they show what depends on the number.
    """
    n_extra = len(thetas[joint]) - parameter_rows(MOST_BLOCKS, 0)
    fits = [_fit_candidate(bundle, joint, thetas, n, n_extra)
            for n in sorted({*blocks, *CANDIDATES})]
    return _unsearched(*choose(bundle, joint, thetas, fits, blocks))._replace(fits=tuple(fits))


def fit_again(bundle: Bundle, joint: int, thetas: Sequence, fit: JointFit,
              blocks: Sequence) -> JointFit:
    """
    Return a JointFit with the number of blocks that is best from where the search ended.

    From far away each number ends in a local minimum of its own, and the best of these need not
    be the best number. Where several are, all that the data do not rule out are rivals. A fit
    that is not that of the search has no ``ends``.
    """
    found = fit.coordinates.n_blocks
    again = [_fit_candidate(bundle, joint, thetas, n, fit.coordinates.n_extra)
             for n in sorted({*blocks, *CANDIDATES} - {found})]
    candidates, best, rivals = choose(bundle, joint, thetas, [
        *fit.fits, (fit.coordinates, fit.free), *again], blocks)
    if best[1] is fit.free:
        return fit._replace(held=best[1], candidates=candidates, rivals=rivals)
    return _unsearched(candidates, best, rivals)


def _unsearched(candidates, chosen, rivals):
    """Return the JointFit of what `choose` returns, for a search to begin from."""
    coordinates, free = chosen
    return JointFit(coordinates, free, prior_of(coordinates, free), free, candidates,
                    np.zeros(len(free)), rivals)


class Choice(NamedTuple):
    """What a joint's fit was chosen from."""

    kind: str              # INNOVATIONS, TORQUE or SIMPLE
    fit: JointFit
    spread: Spread | None  # None where the innovations decided

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return what is to be said of the kind, a tuple of str."""
        return _SENTENCES[self.kind]


class _Look(NamedTuple):
    """Which samples are fitted and which judge the fit, each Segment -> bool (T,)."""

    fitted: Callable
    out: Callable


class _Trial(NamedTuple):
    """How a fit is compared with the simple one."""

    looks: tuple   # of _Look; their errors count together
    enough: float  # error relative to that of the simple one that a fit must stay below


def choose_fit(bundle: Bundle, joint: int, fits: Sequence[JointFit], step: float) -> Choice:
    """
    Return the Choice of one joint: none that is worse than the simple one in either error.

    ``fits`` are those of all joints by the innovations, ``step`` the encoder step or noise [rad].
    """
    contest = _contest(bundle, joint, fits, step)
    usual = contest.wins(contest.by_innovations)
    if usual and contest.explained():
        return Choice(INNOVATIONS, fits[joint], None)
    other = contest.wins(contest.by_torque)
    if usual and not (other and contest.clearly_better()):
        return Choice(INNOVATIONS, fits[joint], None)
    return contest.finished(TORQUE if other else SIMPLE)


def simple_theta(bundle: Bundle, joint: int, fits: Sequence[JointFit], step: float,
                 whole: bool) -> np.ndarray:
    """Return the parameters of the simple fit, to all data or without those held out."""
    contest = _contest(bundle, joint, fits, step)
    coordinates, free = contest.simple(contest.whole if whole else contest.first)
    return coordinates.parameters(free)


def _contest(bundle, joint, fits, step):
    samples = sum(len(segment.angle) for segment in bundle.segments)
    thin = coarser(bundle, min(bundle.period * max(samples // _MOST, 1), _COARSE))
    return _Contest(thin, joint, [fit.theta for fit in fits], fits[joint], step)


class _Contest:
    """Fits of one joint beside the simple one, ``fit`` by the innovations."""

    def __init__(self, bundle, joint, thetas, fit, step):
        self._bundle, self._fit, self._step = bundle, fit, step
        self._objective_of = lambda chosen: Objective(bundle, joint, thetas, chosen)
        self._objective = Objective(bundle, joint, thetas)
        first, *others = _trials(bundle)
        self.trials = (first, *filter(None, map(self._that_tell, others)))
        self.first = first.looks[0]
        self.whole = _Look(everything, self.first.out)
        self.simple, self.by_torque = cache(self._simple), cache(self._by_torque)

    def _that_tell(self, trial):
        """Return a _Trial of the looks whose both parts have motion of the joint, or None."""
        looks = tuple(look for look in trial.looks
                      if self._moves(look.fitted) and self._moves(look.out))
        return trial._replace(looks=looks) if looks else None

    def _moves(self, chosen):
        joint, bundle = self._objective.joint, self._bundle
        return any((chosen(segment) & segment.tested[:, joint] & moving(
            segment, joint, self._step, bundle.half[joint])).any() for segment in bundle.segments)

    def wins(self, fitted) -> bool:
        """Return whether ``fitted``, _Look -> Coordinates and free numbers, passes all trials."""
        return all(self._passes(trial, fitted) for trial in self.trials)

    def explained(self) -> bool:
        """Return whether the fit by the innovations leaves next to nothing of the torque."""
        error = self._error(self.first.out)
        left = error(self._fit.coordinates.parameters(self._fit.held))
        return rms(left) < _NEXT_TO_NOTHING * rms(error.measured)

    def _passes(self, trial, fitted):
        found = self._errors(trial.looks, [fitted(look) for look in trial.looks])
        least = self._errors(trial.looks, [self.simple(look) for look in trial.looks])
        return self._penalty(trial) * np.nanmax(found / least) < trial.enough

    def clearly_better(self) -> bool:
        """Return whether the fit of the torque is far better there, and little worse freely."""
        looks = self.trials[-1].looks
        torque, free = (self._errors(looks, [self.by_torque(look) for look in looks])
                        / self._errors(looks, [self.by_innovations(look) for look in looks]))
        return torque < _FAR and not free > _LITTLE

    def by_innovations(self, look) -> tuple[Coordinates, np.ndarray]:
        """Return Coordinates and free numbers of the fit by the innovations."""
        if look is self.first:
            return self._fit.coordinates, self._fit.held
        return self._fit.coordinates, refine(
            self._objective_of(look.fitted), self._fit.coordinates, self._fit.free,
            self._fit.prior).free

    def _by_torque(self, look):
        """Return Coordinates and free numbers of a fit of the torque."""
        coordinates, free = self.by_innovations(look)
        begin = _levelled(free, self.simple(look)[1])
        return coordinates, fit_torque(self._error(look.fitted), coordinates, begin,
                                       _belief(coordinates, begin))

    def _simple(self, look):
        """
        Return Coulomb and viscous friction as Coordinates and free numbers.

        Its one block is as stiff as suits torque and free motion together: too soft it lags
        behind a reversal, too stiff for the samples it chatters.
        """
        plain = coulomb_viscous(self._objective, self._bundle, self._step, look.fitted)
        tried = [simple_free(plain, factor * self._step) for factor in _YIELDS]
        found = [np.nanprod(self._errors([look], [pair])) for pair in tried]
        return tried[int(np.argmin(found))]

    def finished(self, kind) -> Choice:
        """Return the Choice of a kind, fitted to all data."""
        coordinates, held = (self.by_torque if kind == TORQUE else self.simple)(self.first)
        error, prior = self._error(everything), prior_of(coordinates, held)
        if kind == SIMPLE:
            free = self.simple(self.whole)[1]
        else:
            prior = _belief(coordinates, held)
            free = fit_torque(error, coordinates, held, prior)
        fit = self._fit._replace(coordinates=coordinates, free=free, prior=prior, held=held,
                                 sampling=np.zeros(len(free)),
                                 rivals=(self._fit.theta, *self._fit.rivals))
        return Choice(kind, fit, torque_spread(error, coordinates, free, prior))

    def _penalty(self, trial):
        """
        Return by how much more a fit flatters itself than the simple one.

        Akaike's final prediction error, samples counted by how long an error lasts; 1 where the
        data held out decide, which had no part in the fit.
        """
        look = trial.looks[0]
        if look.out is not everything:
            return 1.0
        error, size = self._error(look.fitted), self._fit.coordinates.size
        least = self.simple(look)[0].size
        count = max(len(error.block) / error.memory, 1.1 * size)
        return float(np.sqrt((count + size) * (count - least) / (count - size) / (count + least)))

    def _errors(self, looks, fits):
        """Return the errors of torque and of free simulation (2,) where looks judge."""
        found = []
        for look, (coordinates, free) in zip(looks, fits, strict=True):
            theta = coordinates.parameters(free)
            found.append([rms(self._error(look.out)(theta)), free_run_error(
                self._objective, self._bundle, theta, look.out)])
        return _root_mean_square(np.array(found))

    def _error(self, chosen):
        return TorqueError(self._objective, self._bundle, chosen, self._step)


def _trials(bundle):
    """
    Return what a fit has to pass, a tuple of _Trial.

    Where data are few, one part of them held out may be like no other, and a motion that lacks
    a quarter may not identify the simple model: a fit must be better on all of them, by more
    than it flatters itself, and as each quarter is held out in turn.
    """
    period = bundle.period
    if period * sum(len(segment.angle) for segment in bundle.segments) > _SHORT:
        return (_Trial((_Look(train(period), held_out(period)),), _WORTH),)
    turns = tuple(_Look(train(period, turn), held_out(period, turn)) for turn in range(FOLDS))
    return _Trial((_Look(train(period), everything),), _CLEAR), _Trial(turns, _WORTH)


def _levelled(free, plain):
    """Return free numbers with the Coulomb and viscous friction of the simple ones."""
    level = free.copy()
    for at in (0, PER_DIRECTION):
        level[at + VISCOUS] = plain[at + VISCOUS]
        level[at] = plain[at]
        level[at + 1] = plain[at] + np.log(_DROP)
    return level


def _belief(coordinates, free):
    """Return the prior of a fit of the torque: friction does not vanish at speed."""
    prior = prior_of(coordinates, free)
    for at in (0, PER_DIRECTION):
        prior.precision[at] = _LEVEL_SD ** -2
    return prior


def _root_mean_square(rows):
    """Return the root mean square of the columns of (L, E), NaN left out, as (E,)."""
    known = np.isfinite(rows)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return np.sqrt(np.square(np.where(known, rows, 0.0)).sum(axis=0) / count)
