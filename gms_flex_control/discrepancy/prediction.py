# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How well a model predicts the next reading, which tells a lag of the torque from a delay.

The two differ above the frequencies that residuals are measured at, where all is noise of the
encoders; and a controller puts that noise into the torque, so a late torque that makes more of it
cancel in the equations looks better than the true one. No controller knows the noise of the next
reading, though: errors of prediction are smallest for the true model, loop closed or not (Ljung,
System Identification, 2nd ed., 1999, section 13.4). What earlier errors tell of the next is fitted
with each model.
"""

from gms_flex_control.discrepancy.path import at_full_rate
from gms_flex_control.discrepancy.residuals import unexplained
import numpy as np

_MEMORY = 0.08        # of earlier errors that the next is predicted from [s]
_FEWEST, _MOST = 8, 60  # samples of it
_EDGE = 0.5           # at both ends, where smoothing is not settled [s]
_LEAST = 4            # rows per number that is fitted, for anything to be told
_RIDGE = 1e-12        # of the mean square


def prediction_cost(problem, models, joint):
    """
    Return how badly models predict the equations of a joint, one sample ahead.

    Parameters
    ----------
    problem : Problem
        With the recordings.
    models : sequence of (RobotParams, ndarray)
        Robots and their knobs (P,). Only those of equal inertia compare: the equations are errors
        of readings times inertia.
    joint : str
        Whose equations.

    Returns
    -------
    ndarray, shape (M,)
        Twice the negative logarithm of the likelihood of normal errors, but for a constant; all
        zero where recordings are too short to tell.

    """
    n, j = problem.robot.n_joints, problem.robot.joints.index(joint)
    costs = np.zeros(len(models))
    for path in problem.paths:
        fine = at_full_rate(path)
        usable = fine.known & (np.abs(fine.time - 0.5 * (fine.time[0] + fine.time[-1]))
                               < 0.5 * np.ptp(fine.time) - _EDGE)
        for i, (robot, x) in enumerate(models):
            left = unexplained(fine, problem.constants(robot, x))[:, [j, n + j]]
            costs[i] += _innovation_cost(left[:, np.any(left, axis=0)], usable, fine.period)
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
