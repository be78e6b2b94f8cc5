# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Which fit of a joint is taken: by the innovations, by the torque, or the simple one.

The predictor's innovations weigh every moment by how well it is understood, which tells the
most from an arm that is as described. On a machine with forces that nobody has described, few
moments are, and they need not be like the rest: there a plain fit of the torque predicts better.
Both are tried, and Coulomb and viscous friction with a single stiff block as well; torque and
free simulation choose among them on the data held out; where these are few, on all of them and
on each quarter held out in turn.
"""

from functools import cache
from typing import NamedTuple

from gms_flex_control.identification import held_out as errors
from gms_flex_control.identification.default_method import (
    FOLDS,
    held_out,
    prior_of,
    theta_of,
    train,
)
from gms_flex_control.identification.objective import coarser, Objective
from gms_flex_control.identification.refine import refine
from gms_flex_control.identification.torque_fit import fit_torque, torque_spread, TorqueError
from gms_flex_control.simulation.predictor import PER_DIRECTION, VISCOUS
import numpy as np

INNOVATIONS, TORQUE, SIMPLE = 'innovations', 'torque', 'coulomb and viscous'
_SENTENCES = {
    INNOVATIONS: (),
    TORQUE: ('Forces that the model lacks are as large as what tells friction apart: the '
             'parameters are those that predict the drive torque best, not those of friction '
             'alone.',),
    SIMPLE: ('GMS friction cannot be told from these data: it predicts no better than Coulomb + '
             'viscous friction, which is what was taken (one stiff block, no Stribeck part). '
             'Slow reversals and torque ramps below break-away, with an encoder that resolves '
             'them, would tell it.',)}
_MOST = 20_000        # samples that are looked at, if they are no further apart than
_COARSE = 8e-3        # [s]
_YIELDS = (2.0, 0.2, 0.6, 10.0, 50.0)  # of the simple one's block, in encoder steps
_SHORT = 60.0         # data in which one part held out is too little to choose by [s]
_WORTH = 0.97         # of the error on data held out: a fit that is no better is not taken
_CLEAR = 0.9          # likewise where the fit itself has seen the data that decide
_NEXT_TO_NOTHING = 0.05  # of the friction torque
_FAR, _LITTLE = 0.7, 1.3  # of the errors of the innovations: where torque decides after all
_DROP, _LEVEL_DOUBT = 0.1, 0.3  # of Coulomb friction: F_s - F_c to begin with; of its logarithm


class Choice(NamedTuple):
    """What a joint's fit was chosen from."""

    kind: str        # INNOVATIONS, TORQUE or SIMPLE
    fit: object      # JointFit
    spread: object   # Spread, None where the innovations decided

    @property
    def sentences(self):
        """Return what is to be said of the kind, a tuple of str."""
        return _SENTENCES[self.kind]


class Look(NamedTuple):
    """Which samples are fitted and which judge the fit, each Stretch -> bool (T,)."""

    fitted: object
    out: object


class Trial(NamedTuple):
    """How a fit is compared with the simple one."""

    looks: tuple   # of Look; their errors count together
    enough: float  # error relative to that of the simple one that a fit must stay below


def choose_fit(bundle, joint, fits, step):
    """
    Return the Choice of one joint: none that is worse than the simple one in either error.

    Parameters
    ----------
    bundle : Bundle
        All data.
    joint : int
        Which joint.
    fits : sequence of JointFit
        Of all joints, by the innovations.
    step : float
        Encoder step or noise [rad].

    """
    contest = _contest(bundle, joint, fits, step)
    usual = contest.wins(contest.by_innovations)
    if usual and contest.explained():
        return Choice(INNOVATIONS, fits[joint], None)
    other = contest.wins(contest.by_torque)
    if usual and not (other and contest.clearly_better()):
        return Choice(INNOVATIONS, fits[joint], None)
    return contest.finished(TORQUE if other else SIMPLE)


def simple_theta(bundle, joint, fits, step, whole):
    """
    Return the parameters of the simple fit that others are measured by.

    Parameters
    ----------
    bundle, joint, fits, step
        As `choose_fit`.
    whole : bool
        Whether it is fitted to all data, or without those held out.

    """
    contest = _contest(bundle, joint, fits, step)
    coordinates, free = contest.simple(contest.whole if whole else contest.first)
    return coordinates.unpack(free)[0]


def _contest(bundle, joint, fits, step):
    samples = sum(len(stretch.angle) for stretch in bundle.stretches)
    thin = coarser(bundle, min(bundle.period * max(samples // _MOST, 1), _COARSE))
    return _Contest(thin, joint, [theta_of(fit) for fit in fits], fits[joint], step)


class _Contest:
    """
    Fits of one joint beside the simple one.

    Parameters
    ----------
    bundle : Bundle
        Data to compare by.
    joint : int
        Which joint.
    thetas : sequence of ndarray
        Parameters of all joints.
    fit : JointFit
        By the innovations.
    step : float
        Encoder step or noise [rad].

    """

    def __init__(self, bundle, joint, thetas, fit, step):
        self._bundle, self._fit, self._step = bundle, fit, step
        self._objective_of = lambda chosen: Objective(bundle, joint, thetas, chosen)
        self._objective = Objective(bundle, joint, thetas)
        first, *others = _trials(bundle)
        self.trials = (first, *filter(None, map(self._that_tell, others)))
        self.first = first.looks[0]
        self.whole = Look(_everything, self.first.out)
        self.simple, self.by_torque = cache(self._simple), cache(self._by_torque)

    def _that_tell(self, trial):
        """Return a Trial of the looks whose both parts have motion of the joint; None if none."""
        looks = tuple(look for look in trial.looks
                      if self._moves(look.fitted) and self._moves(look.out))
        return trial._replace(looks=looks) if looks else None

    def _moves(self, chosen):
        joint, bundle = self._objective.joint, self._bundle
        return any((chosen(stretch) & stretch.tested[:, joint] & errors.moving(
            stretch, joint, self._step, bundle.half[joint])).any() for stretch in bundle.stretches)

    def wins(self, fitted):
        """Return whether ``fitted``, Look -> Coordinates and free numbers, passes all trials."""
        return all(self._passes(trial, fitted) for trial in self.trials)

    def explained(self):
        """Return whether the fit by the innovations leaves next to nothing of the torque."""
        error = self._error(self.first.out)
        left = error(self._fit.coordinates.unpack(self._fit.held_out.free)[0])
        return errors.rms(left) < _NEXT_TO_NOTHING * errors.rms(error.measured)

    def _passes(self, trial, fitted):
        found = self._errors(trial.looks, [fitted(look) for look in trial.looks])
        least = self._errors(trial.looks, [self.simple(look) for look in trial.looks])
        return self._penalty(trial) * np.nanmax(found / least) < trial.enough

    def clearly_better(self):
        """Return whether the fit of the torque is far better there, and little worse freely."""
        looks = self.trials[-1].looks
        torque, free = (self._errors(looks, [self.by_torque(look) for look in looks])
                        / self._errors(looks, [self.by_innovations(look) for look in looks]))
        return torque < _FAR and not free > _LITTLE

    def by_innovations(self, look):
        """Return Coordinates and free numbers of the fit by the innovations."""
        if look is self.first:
            return self._fit.coordinates, self._fit.held_out.free
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
        plain = errors.coulomb_viscous(self._objective, self._bundle.stretches, self._bundle.arm,
                                       self._objective.joint, self._step, look.fitted)
        tried = [errors.simple_free(plain, factor * self._step, len(plain) - 4)
                 for factor in _YIELDS]
        found = [np.nanprod(self._errors([look], [pair])) for pair in tried]
        return tried[int(np.argmin(found))]

    def finished(self, kind):
        """Return the Choice of a kind, fitted to all data."""
        coordinates, held = (self.by_torque if kind == TORQUE else self.simple)(self.first)
        error, prior = self._error(_everything), prior_of(coordinates, held)
        if kind == SIMPLE:
            free = self.simple(self.whole)[1]
        else:
            prior = _belief(coordinates, held)
            free = fit_torque(error, coordinates, held, prior)
        chosen = self._fit.held_out._replace(coordinates=coordinates, free=held,
                                             n_blocks=coordinates.n_blocks)
        fit = self._fit._replace(coordinates=coordinates, free=free, prior=prior,
                                 held_out=chosen, sampling=np.zeros(len(free)),
                                 rivals=(theta_of(self._fit), *self._fit.rivals))
        return Choice(kind, fit, torque_spread(error, coordinates, free, prior))

    def _penalty(self, trial):
        """
        Return by how much more a fit flatters itself than the simple one.

        Akaike's final prediction error, samples counted by how long an error lasts; 1 where the
        data held out decide, which took no part in the fit.
        """
        look = trial.looks[0]
        if look.out is not _everything:
            return 1.0
        error, size = self._error(look.fitted), self._fit.coordinates.size
        least = self.simple(look)[0].size
        count = max(len(error.block) / error.memory, 1.1 * size)
        return float(np.sqrt((count + size) * (count - least) / (count - size) / (count + least)))

    def _errors(self, looks, fits):
        """Return the errors of torque and of free simulation (2,) where looks judge."""
        found = []
        for look, (coordinates, free) in zip(looks, fits, strict=True):
            theta = coordinates.unpack(free)[0]
            found.append([errors.rms(self._error(look.out)(theta)), errors.free_run_error(
                self._objective, self._bundle, theta, look.out)])
        return _root_mean_square(np.array(found))

    def _error(self, chosen):
        return TorqueError(self._objective, self._bundle, chosen, self._step)


def _trials(bundle):
    """
    Return what a fit has to pass, a tuple of Trial.

    Where data are few, one part of them held out may be like no other, and a motion that lacks
    a quarter may not tell the simple model either: a fit must be better on all of them, by more
    than it flatters itself, and as each quarter is held out in turn.
    """
    period = bundle.period
    if period * sum(len(stretch.angle) for stretch in bundle.stretches) > _SHORT:
        return (Trial((Look(train(period), held_out(period)),), _WORTH),)
    turns = tuple(Look(train(period, turn), held_out(period, turn)) for turn in range(FOLDS))
    return Trial((Look(train(period), _everything),), _CLEAR), Trial(turns, _WORTH)


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
        prior.precision[at] = _LEVEL_DOUBT ** -2
    return prior


def _root_mean_square(rows):
    """Return the root mean square of the columns of (L, E), NaN left out, as (E,)."""
    known = np.isfinite(rows)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return np.sqrt(np.square(np.where(known, rows, 0.0)).sum(axis=0) / count)


def _everything(stretch):
    return np.ones(len(stretch.angle), dtype=bool)
