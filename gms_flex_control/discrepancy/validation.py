# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How well models predict what took no part in their fit.

Blocks of time are left out in turn; each is predicted by a model fitted to the others, to first
order. Errors have Student's distribution: one moment at which friction breaks loose decides
nothing.
"""

from typing import NamedTuple

from gms_flex_control.discrepancy.fitting import at_values, numbers_of, step_of, values_of
from gms_flex_control.discrepancy.free_run import all_known, free_runs
from gms_flex_control.discrepancy.motion import at_full_rate
from gms_flex_control.discrepancy.null_simulation import null_simulation
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.result import Gap
from gms_flex_control.discrepancy.thresholds import FEW_BLOCKS, HELD_OUT, HELD_OUT_NATS, PLAUSIBLE
import numpy as np

FOLDS = 5
_DEGREES = 4.0        # of freedom of Student's distribution
_ACTS = 0.02          # of what an effect changes at most in a block: with less it is not there
_FARTHEST = 10.0      # errors of free runs that run away count as so much [rad]
_SEED = 991           # of the null simulation that tells the floor, of none that was fitted
_MEMORY = 0.08        # of earlier errors that the next is predicted from [s]
_FEWEST, _MOST = 8, 60  # samples of it
_EDGE = 0.5           # at both ends, where smoothing is not settled [s]
_LEAST = 4            # rows per number that is fitted, for anything to be told
_RIDGE = 1e-12        # of the mean square


class Gain(NamedTuple):
    """What an effect adds to held-out log likelihood."""

    nats: float      # in all
    sigmas: float    # mean over its standard error, over blocks in which the effect acts
    blocks: int      # in which it acts

    @property
    def is_real(self):
        """Return whether held-out data speak for the effect."""
        return self.nats > HELD_OUT_NATS and (self.blocks < FEW_BLOCKS or self.sigmas > HELD_OUT)


def predicted(likelihood, model, columns, plausible=np.inf):
    """
    Return the log likelihood of blocks, each predicted from the others, shape (B,).

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    model : Fitted
        At its likeliest.
    columns : ndarray, shape (C, R)
        Derivatives of its rows.
    plausible : float or ndarray, shape (P,)
        Standard deviations of their priors that nuisance parameters may go.

    Returns
    -------
    ndarray, shape (B,)

    """
    weight = likelihood.weights(model.sums.groups)
    return sum(of_blocks(likelihood, left_out, model.rows + step @ columns, weight)
               for left_out, step in _steps(likelihood, model, columns, weight, plausible))


def of_blocks(likelihood, left_out, rows, weight):
    """Return the log likelihood of blocks (B,), of rows (R,) that are left out, so weighted."""
    density = (0.5 * np.log(weight)
               - 0.5 * (_DEGREES + 1.0) * np.log1p(rows ** 2 * weight / _DEGREES))
    return np.bincount(likelihood.block[left_out], density[left_out], likelihood.blocks)


def folds(likelihood):
    """Yield which rows (R,) are left out of each fold, bool."""
    for k in range(min(FOLDS, likelihood.blocks)):
        yield likelihood.block % FOLDS == k


def _steps(likelihood, model, columns, weight, plausible=np.inf):
    """Yield which rows (R,) are left out of each fold, and the step (C,) of a fit without."""
    numbers = numbers_of(likelihood, model.robot)
    for left_out in folds(likelihood):
        yield left_out, step_of(likelihood, model, columns, numbers, weight * ~left_out,
                                plausible)


def gain_of(likelihood, state, other, change, plausible=PLAUSIBLE):
    """
    Return the Gain of one model over another.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    state, other : (Fitted, ndarray of shape (C, R))
        With an effect, and without it.
    change : ndarray, shape (R,)
        What the effect changes.
    plausible : float or ndarray, shape (P,)
        Standard deviations of their priors that nuisance parameters may go in both, or they
        would stand for the effect.

    Returns
    -------
    Gain

    """
    gains = (predicted(likelihood, *state, plausible)
             - predicted(likelihood, *other, plausible))
    size = np.bincount(likelihood.block, change ** 2, minlength=likelihood.blocks)
    return gain_over(gains, size > _ACTS * size.max())


def gain_over(gains, acts=slice(None)):
    """Return the Gain of log likelihoods (B,), over blocks in which an effect acts (B,)."""
    own = gains[acts]
    if len(own) < 2:
        return Gain(float(gains.sum()), 0.0, len(own))
    spread = np.std(own, ddof=1) / np.sqrt(len(own))
    return Gain(float(gains.sum()), float(own.mean() / max(spread, 1e-12)), len(own))


# --- the gap -----------------------------------------------------------------------------------


def gap_of(likelihood, before, after, holdout=None):
    """
    Return the Gap of two models.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings that were fitted.
    before, after : State
        Nuisance parameters re-tuned as far as plausible, and with the effects found.
    holdout : Likelihood, optional
        Of other recordings; default the blocks of time that are left out in turn.

    Returns
    -------
    Gap

    """
    given = likelihood.fitted(likelihood.robot, np.zeros(len(likelihood.nuisances)))
    measured = holdout or likelihood
    parts = {'before': _whole(measured, given),
             'retuned': _parts(likelihood, before, holdout, PLAUSIBLE),
             'after': _parts(likelihood, after, holdout)}
    after = after.model
    torque = {name: _torque(measured, one) for name, one in parts.items()}
    clean = _clean(measured, after)
    floor = _torque(measured, _whole(measured, after), clean)
    free = {name: _free_squares(measured, parts[name]) for name in ('retuned', 'after')}
    free['floor'] = _free_squares(measured, _whole(measured, after), clean)
    above = [float(np.sum(np.maximum(torque[name][0] ** 2 - floor[0] ** 2, 0.0)))
             for name in ('retuned', 'after')]
    return Gap(
        joints=likelihood.robot.joints,
        **{name: one[0] for name, one in torque.items()}, floor=floor[0],
        rest_before=torque['retuned'][1], rest_after=torque['after'][1],
        free_before=_rms(free['retuned']), free_after=_rms(free['after']),
        free_floor=_rms(free['floor']),
        energy_ratio=above[1] / above[0] if above[0] > 0.0 else 1.0)


def energy_of(likelihood, state, holdout=None):
    """
    Return the squared residual torque of a State on held-out data times that of its free runs.

    In Coulomb frictions squared and in rad^2, the geometric mean of all runs: one that slips
    decides nothing. Infinite of a model whose simulation runs away. Arguments as of `gap_of`.
    """
    measured = holdout or likelihood
    if not measured.is_followed(state.model):
        return np.inf
    runs = np.sum(_free_squares(measured, _whole(measured, state.model)), axis=1)
    free = np.exp(np.mean(np.log(np.maximum(runs, 1e-30)))) if len(runs) else 1.0
    torque, _ = _torque(measured, _parts(likelihood, state, holdout))
    return float(np.sum((torque / likelihood.coulomb) ** 2) * free)


def held_out_torque(likelihood, state, holdout=None, plausible=np.inf):
    """
    Return the residual torque of each joint in motion on held-out data, rms (n,) [N m].

    Arguments as of `gap_of`; nuisance parameters of folds may go ``plausible`` standard
    deviations.
    """
    return _torque(holdout or likelihood, _parts(likelihood, state, holdout, plausible))[0]


def torque_rms(likelihood, model):
    """Return the residual torque of each joint in motion, rms (n,) [N m], of a Fitted."""
    return _torque(likelihood, _whole(likelihood, model))[0]


def free_rms(likelihood, model):
    """Return the free-run error of each joint, rms (n,) [rad], of a Fitted; NaN without runs."""
    return _rms(_free_squares(likelihood, _whole(likelihood, model)))


def _parts(likelihood, state, holdout, plausible=np.inf):
    """Return what predicts which held-out moments: a State as it is, or refitted in folds."""
    if holdout is not None:
        return _whole(holdout, state.model)
    return _folds(likelihood, state.model, state.columns, plausible)


def _whole(likelihood, model):
    """Return robot, nuisance parameters and all settled moments (masks) of one model."""
    return [(model.robot, model.x, [whitening.settled for whitening in likelihood.whitenings])]


def _folds(likelihood, model, columns, plausible):
    """Return robot, nuisance parameters and moments (masks) of the folds of a model."""
    numbers = numbers_of(likelihood, model.robot)
    values, weight, found = values_of(model.robot, numbers), likelihood.weights(
        model.sums.groups), []
    for k, (_, step) in enumerate(_steps(likelihood, model, columns, weight, plausible)):
        robot = at_values(model.robot, numbers, values + step[len(model.x):])
        masks = [whitening.settled & (block % FOLDS == k) for whitening, block in zip(
            likelihood.whitenings, likelihood.block_at, strict=True)]
        found.append((robot, model.x + step[:len(model.x)], masks))
    return found


def _clean(likelihood, model):
    """Return null simulations of a model, Motion each."""
    constants = likelihood.constants(model.robot, model.x)
    return [null_simulation(motion, constants, np.random.default_rng(_SEED))
            for motion in likelihood.motions]


def _torque(likelihood, parts, motions=None):
    """Return residual torques (n,) of each joint in motion and at rest, rms [N m]."""
    n = likelihood.robot.n_joints
    squares, counts = np.zeros((2, n)), np.zeros((2, n))
    for robot, x, masks in parts:
        if motions:  # simulated, none of which is particular
            x = np.where(likelihood.of_recording, 0.0, x[:len(likelihood.nuisances)])
        residuals = likelihood.residuals(motions or likelihood.motions, robot, x)
        for m, (residual, mask) in enumerate(zip(residuals, masks, strict=True)):
            whitening = likelihood.whitenings[m]
            if motions:
                residual = residual + likelihood.torque_noise(m, np.random.default_rng(_SEED))
            rows = whitening.torque_rows(residual) ** 2
            still = likelihood.at_rest[m]
            for side, where in enumerate((~still & mask[:, None], still & mask[:, None])):
                squares[side] += np.sum((rows[:, :n] + rows[:, n:]) * where, axis=0)
                counts[side] += where.sum(axis=0)
    moving, still = np.sqrt(squares / np.maximum(counts, 1))
    return np.where(counts[0] > 0, moving, still), np.where(counts[1] > 0, still, np.nan)


def _rms(squares):
    """Return the root of the mean of squares of runs (S, n), NaN where there are none."""
    return np.sqrt(np.sum(squares, axis=0) / (len(squares) or np.nan))


def _free_squares(likelihood, parts, motions=None):
    """Return the mean squares of the errors of free runs (S, n) [rad^2]."""
    squares = []
    for robot, x, masks in parts:
        constants = likelihood.constants(robot, x)
        for motion, whitening, mask in zip(
                motions or likelihood.recorded(likelihood.motions, x), likelihood.whitenings,
                masks, strict=True):
            starts, link, motor = free_runs(motion, constants)
            at = np.clip(np.searchsorted(whitening.time, starts - motion.fine_time[0]), 0,
                         len(mask) - 1)
            kept = mask[at] & all_known(motion, starts)
            link, motor = (np.clip(np.nan_to_num(one[kept], nan=_FARTHEST), -_FARTHEST, _FARTHEST)
                           for one in (link, motor))
            squares.append(np.mean(link ** 2 + motor ** 2, axis=1) / 2.0)
    return np.concatenate(squares)


# --- prediction one sample ahead ----------------------------------------------------------------


def prediction_cost(likelihood, models, joint):
    """
    Return how badly models predict the equations of a joint, one sample ahead.

    A controller puts encoder noise, and its answer to the noise of the drives, into the torque: a
    late torque that makes more of that cancel looks better than the true one. No controller knows
    the noise of the next reading, though: errors of prediction are smallest for the true model,
    loop closed or not (Ljung, System Identification, 2nd ed., 1999, section 13.4). What earlier
    errors tell of the next is fitted with each model.

    Parameters
    ----------
    likelihood : Likelihood
        With the recordings.
    models : sequence of (RobotParams, ndarray)
        Robots and their nuisance parameters (P,). Only those of equal inertia compare: the
        equations are errors of readings times inertia.
    joint : str
        Whose equations; 'arm' for all.

    Returns
    -------
    ndarray, shape (M,)
        Twice the negative logarithm of the likelihood of normal errors, but for a constant; all
        zero where recordings are too short to tell.

    """
    n, joints = likelihood.robot.n_joints, likelihood.robot.joints
    at = [joints.index(joint)] if joint in joints else list(range(n))
    costs = np.zeros(len(models))
    for motion in likelihood.motions:
        fine = at_full_rate(motion)
        usable = fine.known & (np.abs(fine.time - 0.5 * (fine.time[0] + fine.time[-1]))
                               < 0.5 * np.ptp(fine.time) - _EDGE)
        for i, (robot, x) in enumerate(models):
            left = unexplained(fine, likelihood.constants(robot, x))
            for j in at:
                own = left[:, [j, n + j]]
                costs[i] += _innovation_cost(own[:, np.any(own, axis=0)], usable, fine.period)
    return costs


def _innovation_cost(left, usable, period):
    """Return the cost of residuals (T, C) less what those before tell of them."""
    memory = int(np.clip(_MEMORY / period, _FEWEST, _MOST))
    rows = np.flatnonzero(np.convolve(usable, np.ones(memory + 1), 'valid') > memory) + memory
    size = left.shape[1] * memory
    if len(rows) < _LEAST * size:
        return 0.0
    before = np.concatenate([left[rows - k] for k in range(1, memory + 1)], axis=1)
    gram, now = before.T @ before, left[rows]
    gram.flat[::size + 1] += _RIDGE * np.trace(gram) / size
    errors = now - before @ np.linalg.solve(gram, before.T @ now)
    return len(rows) * np.linalg.slogdet(errors.T @ errors / len(rows))[1]
