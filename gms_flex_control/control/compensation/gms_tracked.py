# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Mode gms: GMS on reference plus slow deviation, sign of the last motion, command filter.

The reference is trusted for fast motion and the encoder for slow deviation from it: one encoder
count can be longer than the whole presliding range.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
from gms_flex_control.control.compensation import common
from gms_flex_control.friction import gms
import numpy as np

# How fast a deviation from the reference moves the observer's blocks [rad/s].
DEVIATION_BANDWIDTH = 10.0


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave F_hat of Eqs. (18) to (20) with filtered derivatives; see compensation."""
    blocks = state.observer.blocks
    gain = 1.0 - np.exp(-DEVIATION_BANDWIDTH * dt)
    for j in range(constants.kd_link.shape[0]):
        if not state.started[0]:
            state.deviation[j] = state.error[j]
        state.deviation[j] += gain * (state.error[j] - state.deviation[j])
        work.scratch[j] = reference[0, j] + state.deviation[j]
    common.take_displacement(state, work.scratch, work)
    common.take_correction(state, constants, work)
    common.take_direction(state, work)
    observer.advance(blocks, work.displacement, measured.dq_link, work.smooth, work.correction,
                     work.resting, dt, constants.friction)
    gms.total(blocks, measured.dq_link, constants.friction, work.estimate[0])
    common.filter_derivatives(state, dt, constants, work)
