# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Friction fitted to the drive torque along the measured motion, whatever made it.

Robust to moments unlike the rest, and drawn weakly to a belief.
"""

from typing import NamedTuple

from gms_flex_control.friction import gms
from gms_flex_control.identification import held_out as errors
from gms_flex_control.identification.coordinates import friction_record
from gms_flex_control.identification.objective import BLOCK_TIME
from gms_flex_control.identification.smoothing import low_pass
from gms_flex_control.identification.steady import friction_torque
from gms_flex_control.identification.uncertainty import clustered, Spread
import numpy as np
from scipy.optimize import least_squares

_MEMORY = 0.1  # of what a fit leaves of the torque, at least [s]
_STEP = 1e-4   # of a free number, for a derivative
_BENT = 2.0    # residuals beyond this many standard deviations count less


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
        self.measured = np.concatenate([piece.measured[piece.counts] for piece in self._pieces])
        self.memory = max(_MEMORY / bundle.period,
                          *(2.0 * piece.window for piece in self._pieces))

    def __call__(self, theta):
        """Return the unexplained torque (S,) of parameters [N m]."""
        record, parts = friction_record([theta]), []
        for piece in self._pieces:
            friction = gms.replay(piece.angle, piece.rate, self._period, record)[:, 0]
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


def torque_spread(error, coordinates, free, prior):
    """
    Return the Spread of a fit to the torque.

    Parameters
    ----------
    error, coordinates, free, prior
        Of the fit.

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
    told = 1.0 - np.clip(prior.precision * np.diag(inverse), 0.0, 1.0)
    return Spread(clustered(inverse, scores, 1.0), told)
