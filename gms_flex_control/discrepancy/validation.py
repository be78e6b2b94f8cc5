# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
How well models predict what took no part in their fit.

Blocks of time are left out in turn; each is predicted by a model fitted to the others, to first
order. Errors have Student's distribution: one moment at which friction breaks loose decides
nothing.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import FOLDS, runs
from gms_flex_control.discrepancy.fitting import numbers_of, steps_without
from gms_flex_control.discrepancy.motion import at_full_rate
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.thresholds import FEW_BLOCKS, HELD_OUT_NATS, PLAUSIBLE
import numpy as np

_DEGREES = 4.0        # of freedom of Student's distribution
_ACTS = 0.02          # of what an effect changes at most in a block: with less it is not there
_MEMORY = 0.08        # of earlier errors that the next is predicted from [s]
_FEWEST, _MOST = 8, 60  # samples of it
_LEAST = 4            # residuals per number that is fitted: fewer decide nothing
_RIDGE = 1e-12        # of the mean square
_LEAST_INERTIA = 1e-9  # of an equation [kg m^2]


class Gain(NamedTuple):
    """What an effect adds to held-out log likelihood."""

    nats: float      # in all
    sigmas: float    # mean of roots over its standard error, over blocks in which it acts
    blocks: int      # in which it acts

    def is_real(self, caution=1.0) -> bool:
        """Return whether held-out data speak for the effect, with so much ``caution``."""
        return self.nats > HELD_OUT_NATS and (
            self.blocks < FEW_BLOCKS or self.sigmas / caution > PLAUSIBLE)


def predicted(likelihood, model, jacobian, plausible=PLAUSIBLE) -> np.ndarray:
    """Return the log likelihood of blocks, each predicted from the others, shape (B,)."""
    weight, added = likelihood.weights(model.sums.groups), likelihood.noise_added(model)
    return sum(of_blocks(likelihood, left_out, model.whitened + step @ jacobian, weight, added)
               for left_out, step in steps(likelihood, model, jacobian, plausible))


def of_blocks(likelihood, left_out, whitened, weight, added=0.0) -> np.ndarray:
    """
    Return the log likelihood of blocks (B,), of residuals (R,) that are left out, so weighted.

    To first order it is cleared of what encoder noise has ``added`` (R,) to squares.
    """
    squares = whitened ** 2 * weight / _DEGREES
    density = 0.5 * np.log(weight) - 0.5 * (_DEGREES + 1.0) * (
        np.log1p(squares) - added * weight / _DEGREES * (1.0 - squares) / (1.0 + squares) ** 2)
    return np.bincount(likelihood.groups.block[left_out], density[left_out],
                       likelihood.groups.blocks)


def folds(likelihood) -> Iterator[np.ndarray]:
    """Yield which residuals (R,) are left out of each fold, bool."""
    for k in range(min(FOLDS, likelihood.groups.blocks)):
        yield likelihood.groups.block % FOLDS == k


def steps(likelihood, model, jacobian, plausible=np.inf) -> Iterator[tuple]:
    """Yield which residuals (R,) are left out of each fold, and the step (C,) of a fit without."""
    parts = list(folds(likelihood))
    yield from zip(parts, steps_without(likelihood, model, jacobian, numbers_of(
        likelihood, model.robot), parts, plausible), strict=True)


def gain_of(likelihood, state, other, change, plausible=PLAUSIBLE) -> Gain:
    """
    Return the Gain of one model over another, each a Fitted and its Jacobian (C, R).

    The first has an effect that makes a ``change`` (R,). Nuisance parameters may go so many
    standard deviations in both as are ``plausible``, or they would stand for the effect.
    """
    return gain_where(likelihood, predicted(likelihood, *state, plausible)
                      - predicted(likelihood, *other, plausible), change)


def gain_where(likelihood, gains, change) -> Gain:
    """Return the Gain of log likelihoods (B,) where an effect acts, a ``change`` (R,)."""
    return gain_over(gains, acting(likelihood, change))


def acting(likelihood, change) -> np.ndarray:
    """Return in which blocks (B,) an effect acts, a ``change`` (R,) of residuals, bool."""
    size = np.bincount(likelihood.groups.block, change ** 2, minlength=likelihood.groups.blocks)
    return size > _ACTS * size.max()


def gain_over(gains, acts=slice(None)) -> Gain:
    """
    Return the Gain of log likelihoods (B,), over blocks in which an effect acts (B,).

    Signed roots of log likelihood ratios are nearly normal (Barndorff-Nielsen 1986, Biometrika
    73): they scatter alike where an effect acts a hundred times as much in one block as in others.
    """
    own = np.sign(gains[acts]) * np.sqrt(np.abs(gains[acts]))
    if len(own) < 2:
        return Gain(float(gains.sum()), 0.0, len(own))
    spread = np.std(own, ddof=1) / np.sqrt(len(own))
    return Gain(float(gains.sum()), float(own.mean() / max(spread, 1e-12)), len(own))


def prediction_cost(likelihood, models) -> np.ndarray:
    """
    Return how badly models predict the equations of all joints, one sample ahead.

    A controller puts encoder noise, and its answer to the noise of the drives, into the torque: a
    late torque that makes more of that cancel looks better than the true one. No controller knows
    the noise of the next reading, though: errors of prediction are smallest for the true model,
    loop closed or not (Ljung, System Identification, 2nd ed., 1999, section 13.4). How each error
    depends on earlier ones, of all joints as they move each other, is fitted with each model.

    ``models`` are RobotParams and their nuisance parameters (P,). The cost (M,) is twice the
    negative logarithm of the likelihood of normal errors, but for a constant; all zero where
    recordings are too short.
    """
    n, costs = likelihood.robot.n_joints, np.zeros(len(models))
    for motion in likelihood.motions:
        fine = at_full_rate(motion)
        for i, (robot, x) in enumerate(models):
            (acted,), constants = likelihood.acted([fine], robot, x)
            errors = unexplained(acted, constants)
            there = np.any(errors, axis=0)
            inertia = np.ravel([_inertia(acted, constants, errors, j) for j in range(n)], 'F')
            costs[i] += innovation_cost((errors / inertia)[:, there], fine.settled, fine.period)
    return costs


def _inertia(motion, constants, left, joint):
    """
    Return by how much both equations of a joint change with its own accelerations, mean (2,).

    So much less than ``left`` (S, 2 n) they are where these are more: errors of readings are those
    of equations divided by it.
    """
    second = motion.second.copy()
    second[:, :, joint] += 1.0
    more = unexplained(replace(motion, second=second, _kept={}), constants)
    n = len(motion.samples.joints)
    return np.maximum(np.mean((more - left)[:, [joint, n + joint]], axis=0), _LEAST_INERTIA)


def memory_of(period) -> int:
    """Return from how many earlier errors the next is predicted."""
    return int(np.clip(_MEMORY / period, _FEWEST, _MOST))


def innovation_cost(errors: np.ndarray, usable: np.ndarray, period: float) -> float:
    """
    Return the cost of errors (T, C) less what earlier ones predict, at ``usable`` samples (T,).

    ``period`` [s] is that of the samples; 0 where too few of them are usable.
    """
    memory, count = memory_of(period), errors.shape[1]
    size, used, gram = count * memory, 0, np.zeros((memory + 1, memory + 1, count, count))
    for begin, end in runs(usable):
        if end - begin > memory:
            gram += _lagged_products(errors[begin:end], memory)
            used += end - begin - memory
    if used < _LEAST * size:
        return 0.0
    gram = gram.transpose(0, 2, 1, 3).reshape(size + count, size + count)
    now, before, both = gram[:count, :count], gram[count:, count:], gram[count:, :count]
    before = before + _RIDGE * np.trace(before) / size * np.eye(size)
    return used * np.linalg.slogdet((now - both.T @ np.linalg.solve(before, both)) / used)[1]


def _lagged_products(errors, memory):
    """
    Return sums of products of errors (T, C) some samples before, and others, (K, K, C, C).

    Over all samples that have ``memory`` others before. One sample earlier on both sides the sum
    has one product more at its beginning and one less at its end.
    """
    now, (length, count) = errors[memory:], errors.shape
    sums = np.empty((memory + 1, memory + 1, count, count))
    for k in range(memory + 1):
        sums[0, k] = now.T @ errors[memory - k:length - k]
        sums[k, 0] = sums[0, k].T
    first, last = errors[memory - 1::-1], errors[:-memory - 1:-1]
    for k in range(memory):
        sums[k + 1, 1:] = sums[k, :-1] + (first[k, :, None] * first[:, None]
                                          - last[k, :, None] * last[:, None])
    return sums
