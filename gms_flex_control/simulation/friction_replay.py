# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction torque along a motion that was measured."""

from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.friction import gms
import numpy as np


@compiled
def replay_kernel(angle, rate, period, constants, state, displacement, tau):
    """Write the friction torque (T, n) along ``angle`` and ``rate`` (T, n) into ``tau``."""
    for k in range(angle.shape[0]):
        if k > 0:
            for j in range(angle.shape[1]):
                displacement[j] = angle[k, j] - angle[k - 1, j]
            gms.advance(state, displacement, rate[k], period, constants)
        gms.total(state, rate[k], constants, tau[k])


def replay(angle, rate, period, constants):
    """
    Return the friction torque of links moved along a given path.

    Parameters
    ----------
    angle, rate : ndarray, shape (T, n_joints)
        Path [rad] and its derivative [rad/s].
    period : float
        Sample [s].
    constants : numpy.record
        Of friction.gms.constants_layout.

    Returns
    -------
    ndarray, shape (T, n_joints)
        Friction torque, viscous part included [N m]; blocks begin unloaded.

    Notes
    -----
    Eqs. (2), (3) and (5).

    """
    n, blocks = constants.stiffness.shape
    state = records.build(gms.state_layout(n, blocks), sticking=1, direction=1.0)
    tau = np.empty(angle.shape)
    replay_kernel(np.ascontiguousarray(angle), np.ascontiguousarray(rate), period, constants,
                  state, np.zeros(n), tau)
    return tau
