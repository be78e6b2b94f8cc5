# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The paper's method in the shape of the default one, so that the same results come of it."""

from gms_flex_control.identification.coordinates import Coordinates, N_STEADY
from gms_flex_control.identification.default_method import Candidate, JointFit, prior_of
from gms_flex_control.identification.objective import Objective
from gms_flex_control.identification.paper_method import fit_paper, N_BLOCKS
from gms_flex_control.identification.result import CONFIDENT
from gms_flex_control.identification.uncertainty import Spread
from gms_flex_control.simulation.predictor import (
    ATTRACTION,
    BLOCKS,
    COULOMB,
    PER_DIRECTION,
    STATIC,
    VELOCITY,
    VISCOUS,
)
import numpy as np

NOT_HELD_OUT = ('the method of the paper uses all of the data: its errors are of data held out '
                'only where --holdout names recordings')


def paper_fits(bundle, half):
    """
    Identify every joint as section 4 of the paper does.

    Parameters
    ----------
    bundle : Bundle
        All data.
    half : ndarray, shape (n_joints,)
        Half an encoder count [rad].

    Returns
    -------
    fits : list of JointFit
        One per joint.
    spreads : list of Spread
        From the intervals of the least-squares steps; NaN for the block stiffnesses.

    """
    papers = [fit_paper(bundle.stretches, bundle.arm, j, bundle.period, half[j])
              for j in range(bundle.arm.n_joints)]
    thetas = [paper.theta for paper in papers]
    fits = [_joint_fit(bundle, j, thetas) for j in range(len(papers))]
    return fits, [_spread(paper, fit) for paper, fit in zip(papers, fits, strict=True)]


def _joint_fit(bundle, joint, thetas):
    theta, coordinates = thetas[joint], Coordinates(N_BLOCKS)
    both = [[theta[row], theta[PER_DIRECTION + row]]
            for row in (STATIC, COULOMB, VELOCITY, VISCOUS)]
    both[3] = np.maximum(both[3], 1e-9 * theta[COULOMB])
    static = np.mean(both[0])
    stiffness = np.maximum(theta[BLOCKS:BLOCKS + N_BLOCKS], 1e-12 * static)
    free = coordinates.pack(*both, theta[ATTRACTION], static / N_BLOCKS / stiffness)
    evaluation = Objective(bundle, joint, thetas).evaluate(coordinates, free, 1.0)
    cost = float(evaluation.cost.sum() / evaluation.count.sum())
    candidate = Candidate(N_BLOCKS, False, cost, 0.0, coordinates, free)
    return JointFit(coordinates, free, prior_of(coordinates, free), evaluation, candidate,
                    (candidate,), True, np.zeros(len(free)))


def _spread(paper, fit):
    """Return the Spread that the paper's intervals stand for, independent of each other."""
    variance = np.full(fit.coordinates.size, np.nan)
    deviation = [np.nan if interval is None else (interval.high - interval.low) / 2 / CONFIDENT
                 for interval in paper.intervals]
    theta = paper.theta
    for at in (0, PER_DIRECTION):
        drop = max(theta[at + STATIC] - theta[at + COULOMB], 1e-3 * theta[at + COULOMB])
        rest = deviation[at + STATIC] ** 2 - deviation[at + COULOMB] ** 2
        variance[at] = (deviation[at + COULOMB] / theta[at + COULOMB]) ** 2
        variance[at + 1] = max(rest, 0.0) / drop ** 2
        for row in (VELOCITY, VISCOUS):
            variance[at + row] = (deviation[at + row] / max(theta[at + row], 1e-12)) ** 2
    variance[N_STEADY - 1] = (deviation[ATTRACTION] / theta[ATTRACTION]) ** 2
    return Spread(np.diag(variance), np.ones(len(fit.free)))
