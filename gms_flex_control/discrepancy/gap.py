# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The gap between model and measurement on data held out, before and after."""

from gms_flex_control.discrepancy.free_run import all_known, free_runs
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.result import Gap
from gms_flex_control.discrepancy.retrace import retrace
import numpy as np

_SEED = 991   # of the run in which nothing is missing, of none that the search has seen


def torque_rms(problem, robot, x, paths=None):
    """Return the held-out residual of each joint, rms behind a low-pass (n,) [N m]."""
    n = problem.robot.n_joints
    squares, count = np.zeros(2 * n), 0
    constants = problem.constants(robot, x)
    for path, whitening, out in zip(paths or problem.paths, problem.whitenings,
                                    problem.moments_held_out, strict=True):
        rows = whitening.torque_rows(unexplained(path, constants))[out]
        squares += np.sum(rows ** 2, axis=0)
        count += len(rows)
    return np.sqrt((squares[:n] + squares[n:]) / max(count, 1))


def free_rms(problem, robot, x, paths=None):
    """Return by how far half-second runs from held-out moments stray, rms (n,) [rad], or NaN."""
    return _rms(_free_squares(problem, robot, x, paths))


def _rms(squares):
    """Return the root of the mean of squares of runs (S, n), NaN where there are none."""
    return np.sqrt(np.sum(squares, axis=0) / (len(squares) or np.nan))


def _free_squares(problem, robot, x, paths=None):
    """Return the mean squares by which runs from held-out moments stray (S, n) [rad^2]."""
    constants, squares = problem.constants(robot, x), []
    for path, whitening, out in zip(paths or problem.paths, problem.whitenings,
                                    problem.moments_held_out, strict=True):
        starts, link, motor = free_runs(path, constants)
        at = np.clip(np.searchsorted(whitening.time, starts - path.fine_time[0]), 0, len(out) - 1)
        kept = out[at] & all_known(path, starts)
        link, motor = np.clip(link[kept], -10.0, 10.0), np.clip(motor[kept], -10.0, 10.0)
        squares.append(np.mean(link ** 2 + motor ** 2, axis=1) / 2.0)
    return np.concatenate(squares)


def farther(before, after):
    """Return by how many standard errors squares of runs (S, n) have grown."""
    change = np.sum(after - before, axis=1)
    if len(change) < 2 or not np.any(change):
        return 0.0
    return float(np.mean(change) / np.std(change, ddof=1) * np.sqrt(len(change)))


def gap_of(problem, found):
    """
    Return the Gap of two models.

    Parameters
    ----------
    problem : Problem
        The rows; blocks of time held out took no part in the fits.
    found : Found
        The search's end: known parameters re-tuned, and with the effects found.

    Returns
    -------
    Gap

    """
    before, after = found.before, found.model
    constants = problem.constants(after.robot, after.x)
    clean = [retrace(path, constants, np.random.default_rng(_SEED)) for path in problem.paths]
    zero = np.zeros(len(problem.knobs))
    count = problem.level * problem.held_out.sum()
    above = [max(float(np.sum(problem.rows(model.robot, model.x)[problem.held_out] ** 2)) - count,
                 0.0) for model in (before, after)]
    strays = [_free_squares(problem, model.robot, model.x) for model in (before, after)]
    return Gap(
        joints=problem.robot.joints,
        before=torque_rms(problem, problem.robot, zero),
        retuned=torque_rms(problem, before.robot, before.x),
        after=torque_rms(problem, after.robot, after.x),
        floor=torque_rms(problem, after.robot, after.x, clean),
        free_before=_rms(strays[0]), free_after=_rms(strays[1]),
        free_floor=free_rms(problem, after.robot, after.x, clean),
        energy_ratio=above[1] / above[0] if above[0] > 0.0 else 1.0,
        free_farther=farther(*strays))
