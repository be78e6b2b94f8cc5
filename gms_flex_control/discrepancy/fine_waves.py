# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Waves over the motor angle that are finer than any guess, told by what a model leaves."""

from gms_flex_control.analysis.waves import standing_out
from gms_flex_control.discrepancy.residuals import unexplained


def fine_orders(problem, model, coarsest):
    """
    Return the orders of fine waves that stand out, largest first.

    Parameters
    ----------
    problem : Problem
        The recordings.
    model : Fitted
        What is known.
    coarsest : float
        Orders up to this are guessed anyway [1/rad of the motor angle].

    Returns
    -------
    list of tuple of float
        One tuple per joint.

    """
    constants = problem.constants(model.robot, model.x)
    left = [unexplained(path, constants) for path in problem.paths]
    n, found = model.robot.n_joints, []
    for j in range(n):
        at = j if model.robot.arm.rigid[j] else n + j
        found.append(standing_out(
            [path.motion[:, 3, j] for path in problem.paths], [rows[:, at] for rows in left],
            [path.motion[:, 4, j] for path in problem.paths], coarsest))
    return found
