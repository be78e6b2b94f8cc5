# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The paper's observer, corrected: GMS on the measured motion, the sign smoothed by a tanh."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
from gms_flex_control.control.compensation import common
from gms_flex_control.friction import gms
import numpy as np


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave F_hat of Eqs. (18) to (20); its derivatives follow from the model's motion."""
    blocks = state.observer.blocks
    common.take_displacement(state, measured.q_link, work)
    common.take_correction(state, constants, work)
    for j in range(constants.kd_link.shape[0]):
        slope = constants.sign_slope[j]
        work.smooth[j] = np.tanh(slope * measured.dq_link[j])
        work.slope[j] = slope * (1.0 - work.smooth[j] ** 2)
    observer.advance(blocks, work.displacement, measured.dq_link, work.smooth, work.correction,
                     work.resting, dt, constants.friction)
    gms.total(blocks, measured.dq_link, constants.friction, work.estimate[0])
