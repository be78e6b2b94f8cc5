# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The matrices of an arm one by one, from the kernels that never form them."""

from typing import NamedTuple

from gms_flex_control import records
from gms_flex_control.dynamics.chain import (
    accelerations,
    constants_of,
    reference_torque,
    work_layout,
)
import numpy as np


class ChainMatrices(NamedTuple):
    """M, C and g with first and second time derivatives, in joint coordinates."""

    mass: np.ndarray         # (n, n) M(q1) [kg m^2]
    dmass: np.ndarray
    ddmass: np.ndarray
    coriolis: np.ndarray     # (n, n) C(q1, dq1) of the Christoffel symbols: dM/dt - 2 C is skew
    dcoriolis: np.ndarray
    ddcoriolis: np.ndarray
    gravity: np.ndarray      # (n,) g(q1) [N m]
    dgravity: np.ndarray
    ddgravity: np.ndarray


def _fill_matrices(q, dq, ddq, d3q, links, work, mass, coriolis, gravity):
    """Write M and C, (3, n, n) each, and g (3, n), with two time derivatives, by columns."""
    n = q.shape[0]
    accelerations(q, dq, links, work)  # for the pose
    still, unit, column = np.zeros((3, n)), np.zeros((3, n)), np.empty((3, n))
    reference_torque(dq, ddq, d3q, still, still, links, work, gravity)
    for j in range(n):
        unit[0, j] = 1.0
        for matrix, rate, acceleration in ((mass, still, unit), (coriolis, unit, still)):
            reference_torque(dq, ddq, d3q, rate, acceleration, links, work, column)
            matrix[:, :, j] = column - gravity
        unit[0, j] = 0.0


def matrices(q, dq, ddq, d3q, arm) -> ChainMatrices:
    """
    Return M, C, g and their time derivatives, left side of the link equation (1).

    ``q`` to ``d3q`` are the link angles and their derivatives (n_joints,); motor inertia of
    rigid joints of the ArmParams is part of M.
    """
    n = arm.n_joints
    gravity, mass, coriolis = np.empty((3, n)), np.empty((3, n, n)), np.empty((3, n, n))
    _fill_matrices(*(np.array(x, dtype=float) for x in (q, dq, ddq, d3q)), constants_of(arm),
                   records.build(work_layout(n)), mass, coriolis, gravity)
    return ChainMatrices(*mass, *coriolis, *gravity)
