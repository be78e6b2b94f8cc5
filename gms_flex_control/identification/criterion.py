# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The criterion a joint is fitted by: the predictor's innovations, the torque, or simple friction.

The innovations weigh every moment by how well it is understood, which says the most of an arm
that is as described. On a machine with forces that nobody has described, few moments are, and
they need not be like the rest: there a plain fit of the torque predicts better. Both are tried,
and Coulomb and viscous friction with a single stiff block as well; torque and free simulation
choose among them on the data held out; where these are few, on all of them and on each quarter
held out in turn.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import FRICTION_FOLDS, rms
from gms_flex_control.identification.coordinates import DROP, log_odds
from gms_flex_control.identification.least_squares import fit_torque, prior_of, refine, TorqueError
from gms_flex_control.identification.objective import (
    coarser,
    everything,
    held_out,
    Objective,
    train,
)
from gms_flex_control.identification.outcome import CONFIDENT
from gms_flex_control.identification.prediction_error import (
    coulomb_viscous,
    free_run_squares,
    simple_free,
)
from gms_flex_control.identification.selection import JointFit
from gms_flex_control.identification.uncertainty import Spread, torque_spread
from gms_flex_control.simulation.predictor import PER_DIRECTION, VISCOUS
import numpy as np

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
WORTH = 0.97         # of the error: a fit that is no better is not chosen
_NOT_WORSE = 1.0 / WORTH  # than another in one of its errors
NEXT_TO_NOTHING = 0.05  # of the friction torque
_FAR, _LITTLE = 0.7, 1.3  # of the errors of the innovations: where torque decides after all
_LEVEL_SD = 0.3       # of the logarithm of Coulomb friction


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


class _Squares(NamedTuple):
    """Mean squares of errors of a fit."""

    torque: np.ndarray  # (B,), what each block of time adds to that of torque [N^2 m^2]
    free: np.ndarray    # (R,), of each free run [rad^2]; none if no segment is long enough


def choose_fit(objective: Objective, fit: JointFit, step: float) -> Choice:
    """Return the Choice of a joint: the simple one unless another is better as a whole."""
    criteria = _criteria_of(objective, fit, step)
    usual = criteria.wins(criteria.by_innovations, _NOT_WORSE)
    if usual and criteria.left() < NEXT_TO_NOTHING:
        return Choice(INNOVATIONS, fit, None)
    other = criteria.wins(criteria.by_torque, WORTH)  # its parameters are not friction's alone
    if usual and not (other and criteria.clearly_better()):
        return Choice(INNOVATIONS, fit, None)
    return criteria.finished(TORQUE if other else SIMPLE)


def simple_theta(objective: Objective, fit: JointFit, step: float, whole: bool) -> np.ndarray:
    """Return the parameters of the simple fit, to all data or without those held out."""
    criteria = _criteria_of(objective, fit, step)
    coordinates, free = criteria.simple(criteria.whole if whole else criteria.first)
    return coordinates.parameters(free)


def left_of_torque(objective: Objective, fit: JointFit, step: float) -> float:
    """Return the part of the friction torque held out that a fit to the rest leaves."""
    return _criteria_of(objective, fit, step).left()


def _criteria_of(objective, fit, step):
    bundle = objective.bundle
    samples = sum(len(segment.angle) for segment in bundle.segments)
    thin = coarser(bundle, min(bundle.period * max(samples // _MOST, 1), _COARSE))
    return _Criteria(objective.of(bundle=thin), fit, step)


class _Criteria:
    """Fits of one joint beside the simple one, ``fit`` by the innovations."""

    def __init__(self, objective, fit, step):
        self._objective, self._fit, self._step = objective, fit, step
        first, *others = _trials(objective.bundle)
        self.trials = (first, *filter(None, map(self._that_judge, others)))
        self.first = first[0]
        self.whole = _Look(everything, self.first.out)
        self.simple, self.by_torque, self.by_innovations = (
            cache(one) for one in (self._simple, self._by_torque, self._by_innovations))
        self._error = cache(partial(TorqueError, objective, step=step))

    def _that_judge(self, looks):
        """Return the looks of a trial whose both parts have motion of the joint."""
        return tuple(look for look in looks if self._moves(look.fitted) and self._moves(look.out))

    def _moves(self, chosen):
        joint, bundle = self._objective.joint, self._objective.bundle
        return any((chosen(segment) & bundle.judged(segment, joint, self._step)).any()
                   for segment in bundle.segments)

    def wins(self, fitted, limit) -> bool:
        """
        Return whether ``fitted``, _Look -> Coordinates and free numbers, passes all trials.

        Neither of its errors may reach ``limit`` times that of the simple one.
        """
        return all(self._passes(trial, fitted, limit) for trial in self.trials)

    def left(self) -> float:
        """Return the part of the friction torque held out that the fit leaves."""
        error = self._error(self.first.out)
        left = error(self._fit.coordinates.parameters(self._fit.held))
        return float(rms(left) / rms(error.measured))

    def _passes(self, looks, fitted, limit):
        penalty = self._penalty(looks[0])
        found, least = ([self._squares(look, *one(look)) for look in looks]
                        for one in (fitted, self.simple))
        ratios = penalty * _ratios(found, least)
        together = np.exp(np.nanmean(np.log(ratios)))  # as discovery compares
        if not (together < WORTH and np.nanmax(ratios) < limit):
            return False
        # less torque is missed than blocks differ by; free runs do not say so
        own, torque = least[0].torque, penalty ** 2 * found[0].torque
        less = _weights(own, torque) * (own - torque)
        return looks[0].out is not everything or len(less) > 1 and np.mean(
            less) > CONFIDENT * np.std(less, ddof=1) / np.sqrt(len(less))

    def clearly_better(self) -> bool:
        """Return whether the fit of the torque is far better there, and little worse freely."""
        looks = self.trials[-1]
        torque, free = _ratios(*([self._squares(look, *one(look)) for look in looks]
                                 for one in (self.by_torque, self.by_innovations)))
        return torque < _FAR and not free > _LITTLE

    def _by_innovations(self, look):
        """Return Coordinates and free numbers of the fit by the innovations."""
        if look is self.first:
            return self._fit.coordinates, self._fit.held
        return self._fit.coordinates, refine(
            self._objective.of(look.fitted), self._fit.coordinates, self._fit.free,
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
        plain = coulomb_viscous(self._objective, self._step, look.fitted)
        tried = [simple_free(plain, factor * self._step) for factor in _YIELDS]
        found = [self._squares(look, *pair) for pair in tried]
        return tried[int(np.argmin([one.torque.sum() * (np.mean(one.free) if len(one.free) else 1)
                                    for one in found]))]

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

    def _penalty(self, look):
        """
        Return by how much more a fit flatters itself than the simple one.

        Akaike's final prediction error, samples counted by how long an error lasts; 1 where the
        data held out decide, which had no part in the fit.
        """
        if look.out is not everything:
            return 1.0
        error, size = self._error(look.fitted), self._fit.coordinates.size
        least = self.simple(look)[0].size
        count = max(len(error.block) / error.memory, 1.1 * size)
        return float(np.sqrt((count + size) * (count - least) / (count - size) / (count + least)))

    def _squares(self, look, coordinates, free):
        """Return the _Squares where a look judges."""
        theta, error = coordinates.parameters(free), self._error(look.out)
        return _Squares(np.bincount(error.block, error(theta) ** 2) / len(error.block),
                        free_run_squares(self._objective, theta, look.out))


def _trials(bundle):
    """
    Return what a fit has to pass, a tuple of tuples of _Look, whose errors count together.

    Where data are few, one part of them held out may be like no other, and a motion that lacks
    a quarter may not identify the simple model: a fit must be better on all of them, by more
    than it flatters itself and than chance, and as each quarter is held out in turn.
    """
    period = bundle.period
    if period * sum(len(segment.angle) for segment in bundle.segments) > _SHORT:
        return ((_Look(train(period), held_out(period)),),)
    turns = tuple(_Look(train(period, turn), held_out(period, turn))
                  for turn in range(FRICTION_FOLDS))
    return (_Look(train(period), everything),), turns


def _levelled(free, plain):
    """Return free numbers with the Coulomb and viscous friction of the simple ones."""
    level = free.copy()
    for at in (0, PER_DIRECTION):
        level[at + VISCOUS] = plain[at + VISCOUS]
        level[at] = plain[at]
        level[at + 1] = log_odds(DROP)
    return level


def _belief(coordinates, free):
    """Return the prior of a fit of the torque: friction does not vanish at speed."""
    prior = prior_of(coordinates, free)
    for at in (0, PER_DIRECTION):
        prior.precision[at] = _LEVEL_SD ** -2
    return prior


def _ratios(found, least):
    """
    Return errors of torque and of free runs (2,) of _Squares over those of others, or NaN.

    A run that slips, or stands, says no more than any other.
    """
    torque = sum(one.torque.sum() for one in found) / sum(one.torque.sum() for one in least)
    free, usual = (np.concatenate([one.free for one in several]) for several in (found, least))
    if not len(usual):
        return np.sqrt([torque, np.nan])
    weight = _weights(usual, free)
    return np.sqrt([torque, (weight @ free) / (weight @ usual)])


def _weights(squares, others):
    """Return weights of squares of two fits (K,): beyond the mean error each counts by shares."""
    both = 0.5 * (squares + others)
    return 1.0 / (both + np.mean(np.sqrt(both)) ** 2)
