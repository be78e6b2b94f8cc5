# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Friction fitted to the drive torque along the measured motion, where that predicts better.

The predictor's innovations weigh every moment by how well it is understood, which tells the
most from an arm that is as described. On a machine with forces that nobody has described, few
moments are, and they need not be like the rest: there a plain fit of the torque predicts better.
Both are tried, and Coulomb and viscous friction with a single stiff block as well; torque and
free simulation choose among them, on the data held out, or on all where these are few.
"""

from typing import NamedTuple

from gms_flex_control.identification import held_out as errors
from gms_flex_control.identification.coordinates import friction_record
from gms_flex_control.identification.default_method import held_out, prior_of, train
from gms_flex_control.identification.objective import BLOCK_TIME, coarser, Objective
from gms_flex_control.identification.smoothing import low_pass
from gms_flex_control.identification.steady import friction_torque
from gms_flex_control.identification.uncertainty import REPLICATES, Spread
from gms_flex_control.simulation.friction_replay import replay
from gms_flex_control.simulation.predictor import PER_DIRECTION, VISCOUS
import numpy as np
from scipy.optimize import least_squares

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
_MOST = 20_000        # samples that are looked at
_YIELDS = (1.0, 5.0, 25.0)  # of the simple one's block, of the usual
_SHORT = 60.0         # data in which what is held out is too little to choose by [s]
_WORTH = 0.97         # of the error on data held out: a fit that is no better is not taken
_CLEAR = 0.9          # likewise where the fit itself has seen the data that decide
_MEMORY = 0.1         # of what a fit leaves of the torque, at least [s]
_DROP, _LEVEL_DOUBT = 0.1, 0.3  # of Coulomb friction: F_s - F_c to begin with; of its logarithm
_STEP = 1e-4          # of a free number, for a derivative
_BENT = 2.0           # residuals beyond this many standard deviations count less
_BIG = 0.7            # largest change of a logarithm by a replicate


class Choice(NamedTuple):
    """What a joint's fit was chosen from."""

    kind: str        # INNOVATIONS, TORQUE or SIMPLE
    fit: object      # JointFit
    spread: object   # Spread, None where the innovations decided

    @property
    def sentences(self):
        """Return what is to be said of the kind, a tuple of str."""
        return _SENTENCES[self.kind]


class _Piece(NamedTuple):
    """What the torque of one stretch is compared by."""

    measured: np.ndarray  # (T,) friction torque by the link equation [N m]
    angle: np.ndarray     # (T, 1) smoothed
    rate: np.ndarray      # (T, 1)
    extra: np.ndarray     # (T, R)
    window: int
    counts: np.ndarray    # (T,) bool
    block: np.ndarray     # (T,) int


class TorqueError:
    """
    Torque that a joint's parameters leave unexplained along the measured motion.

    Parameters
    ----------
    objective : Objective
        Of the joint, for its further torques.
    bundle : Bundle
        All data.
    chosen : callable
        Stretch -> bool (T,) of samples that count, where the joint moves.
    step : float
        Encoder step or noise [rad].

    """

    def __init__(self, objective, bundle, chosen, step):
        self._period, self._pieces, joint = bundle.period, [], objective.joint
        length, used = max(round(BLOCK_TIME / bundle.period), 1), 0
        for stretch in bundle.stretches:
            counts = chosen(stretch) & stretch.tested[:, joint] & errors.moving(
                stretch, joint, step, bundle.half[joint])
            block = used + np.arange(len(counts)) // length
            used = block[-1] + 1
            if counts.any():
                angle = errors.smooth_angle(stretch, bundle.period)
                self._pieces.append(_Piece(
                    friction_torque(stretch, bundle.arm)[:, joint], angle[:, joint:joint + 1],
                    stretch.rate[:, joint:joint + 1], objective.extra(stretch), stretch.window,
                    counts, block))
        blocks = [piece.block[piece.counts] for piece in self._pieces]
        self.block = np.unique(np.concatenate(blocks), return_inverse=True)[1]
        self.memory = max(_MEMORY / bundle.period,
                          *(2.0 * piece.window for piece in self._pieces))

    def __call__(self, theta):
        """Return the unexplained torque (S,) of parameters [N m]."""
        record, parts = friction_record([theta]), []
        for piece in self._pieces:
            friction = replay(piece.angle, piece.rate, self._period, record)[:, 0]
            model = friction - piece.extra @ theta[len(theta) - piece.extra.shape[1]:]
            parts.append(low_pass(piece.measured - model, piece.window)[piece.counts])
        return np.concatenate(parts)


def fit_torque(error, coordinates, free, prior):
    """
    Move free numbers to where the torque is explained best, drawn weakly to a belief.

    Parameters
    ----------
    error : TorqueError
        What to make small.
    coordinates : Coordinates
        What the numbers stand for.
    free : ndarray, shape (P,)
        Where to begin.
    prior : Prior
        Belief.

    Returns
    -------
    ndarray, shape (P,)

    """
    root = np.sqrt(prior.precision)
    scale = errors.rms(error(coordinates.unpack(free)[0])) * np.sqrt(error.memory)

    def residual(x):
        off = error(coordinates.unpack(x)[0]) / scale
        limit = _BENT / np.sqrt(error.memory)  # linear beyond
        off = np.sign(off) * limit * np.sqrt(2.0 * (np.sqrt(1.0 + (off / limit) ** 2) - 1.0))
        return np.concatenate([off, root * (x - prior.mean)])
    return least_squares(residual, free, jac=lambda x: _jacobian(residual, x),
                         method='lm', max_nfev=15, ftol=1e-4, xtol=1e-4).x


def _jacobian(function, x):
    columns = []
    for p in range(len(x)):
        step = np.zeros(len(x))
        step[p] = _STEP
        columns.append((function(x + step) - function(x - step)) / (2.0 * _STEP))
    return np.stack(columns, axis=1)


def torque_spread(error, coordinates, free, prior, rng):
    """
    Return the Spread of a fit to the torque.

    Parameters
    ----------
    error, coordinates, free, prior
        Of the fit.
    rng : numpy.random.Generator
        Draws the blocks.

    """
    def residual(x):
        return error(coordinates.unpack(x)[0])
    off, slope = residual(free), _jacobian(residual, free)
    noise = errors.rms(off) ** 2 * error.memory
    curvature = slope.T @ slope / noise + np.diag(prior.precision)
    inverse = np.linalg.pinv(curvature, rcond=1e-12, hermitian=True)
    blocks = int(error.block.max()) + 1
    scores = np.stack([np.bincount(error.block, weights=column, minlength=blocks)
                       for column in (slope * off[:, None] / noise).T], axis=1)
    scores = scores - scores.mean(axis=0)
    replicates = np.empty((REPLICATES, len(free)))
    for row in replicates:
        times = np.bincount(rng.integers(blocks, size=blocks), minlength=blocks)
        row[:] = free - np.clip(inverse @ (times @ scores), -_BIG, _BIG)
    told = 1.0 - np.clip(prior.precision * np.diag(inverse), 0.0, 1.0)
    return Spread(inverse, replicates, told)


def choose_fit(bundle, joint, fits, step, rng):
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
    rng : numpy.random.Generator
        For the bootstrap.

    """
    samples = sum(len(stretch.angle) for stretch in bundle.stretches)
    thin = coarser(bundle, bundle.period * max(samples // _MOST, 1))
    thetas = [fit.coordinates.unpack(fit.free)[0] for fit in fits]
    objective = Objective(thin, joint, thetas)
    fit, chosen = fits[joint], train(thin.period)
    known = fit.coordinates, fit.held_out.free
    plain = _simple(objective, thin, step, chosen)
    least = _errors(objective, thin, *plain, step)
    training = TorqueError(objective, thin, chosen, step)
    fair = _penalty(training, thin, known[0].size, plain[0].size)
    enough = _WORTH if _seconds(thin) > _SHORT else _CLEAR
    if fair * _worse(_errors(objective, thin, *known, step), least) < enough:
        return Choice(INNOVATIONS, fit, None)
    begin = _levelled(known[1], plain[1])
    moved = known[0], fit_torque(training, known[0], begin, _belief(known[0], begin))
    if fair * _worse(_errors(objective, thin, *moved, step), least) < enough:
        return _finished(TORQUE, objective, thin, fit, *moved, step, rng)
    return _finished(SIMPLE, objective, thin, fit, *plain, step, rng)


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


def _penalty(error, bundle, size, least):
    """
    Return by how much more a fit of ``size`` numbers flatters itself than one of ``least``.

    Akaike's final prediction error, samples counted by how long an error lasts; 1 where the
    data held out decide, which took no part in the fit.
    """
    if _seconds(bundle) > _SHORT:
        return 1.0
    count = max(len(error.block) / error.memory, 1.1 * size)
    return float(np.sqrt((count + size) * (count - least) / (count - size) / (count + least)))


def _seconds(bundle):
    return bundle.period * sum(len(stretch.angle) for stretch in bundle.stretches)


def _worse(found, least):
    """Return the larger of both errors (2,) relative to those of the simple model (2,)."""
    return float(np.nanmax(found / least))


def _simple(objective, bundle, step, chosen):
    """
    Return Coulomb and viscous friction as Coordinates and free numbers.

    Its one block is as stiff as suits the torque best, as long as free motion does not suffer.
    """
    plain = errors.coulomb_viscous(objective, bundle.stretches, bundle.arm, objective.joint,
                                   step, chosen)
    tried = [errors.simple_free(plain, factor * step, len(plain) - 4) for factor in _YIELDS]
    found = [_errors(objective, bundle, *pair, step) for pair in tried]
    fine = [k for k, pair in enumerate(found) if not pair[1] > found[0][1]]
    return tried[min(fine, key=lambda k: found[k][0])]


def _finished(kind, objective, bundle, fit, coordinates, held, step, rng):
    """Return the Choice of a kind, fitted to all data."""
    error = TorqueError(objective, bundle, _everything, step)
    prior = _belief(coordinates, held) if kind == TORQUE else prior_of(coordinates, held)
    if kind == SIMPLE:
        free = _simple(objective, bundle, step, _everything)[1]
    else:
        free = fit_torque(error, coordinates, held, prior)
    chosen = fit.held_out._replace(coordinates=coordinates, free=held,
                                   n_blocks=coordinates.n_blocks)
    fit = fit._replace(coordinates=coordinates, free=free, prior=prior, held_out=chosen,
                       sampling=np.zeros(len(free)))
    return Choice(kind, fit, torque_spread(error, coordinates, free, prior, rng))


def _everything(stretch):
    return np.ones(len(stretch.angle), dtype=bool)


def _errors(objective, bundle, coordinates, free, step):
    """Return the errors of torque and of free simulation (2,)."""
    theta = coordinates.unpack(free)[0]
    out = held_out(bundle.period) if _seconds(bundle) > _SHORT else _everything
    return np.array([errors.rms(TorqueError(objective, bundle, out, step)(theta)),
                     errors.free_run_error(objective, bundle, theta, out)])
