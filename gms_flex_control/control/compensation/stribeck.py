# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Static friction, Eq. (6), of the measured velocity, its sign smoothed by a tanh."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control.compensation import common
import numpy as np


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave ``tanh(k_v v) s(v) + sigma_2 v``; see compensation."""
    for j in range(constants.kd_link.shape[0]):
        velocity = measured.dq_link[j]
        level, row = common.level_at(j, velocity, constants.friction)
        work.estimate[0, j] = (np.tanh(constants.sign_slope[j] * velocity) * level
                               + constants.friction.viscous[row, j] * velocity)
    common.filter_derivatives(state, dt, constants, work)
