# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Adaptive GMS with parameter projection, after Nilkhamhang and Sano (2006).

Scaling k_i and alpha_i of a block by one factor scales its torque by it, at every motion: GMS is
linear in such factors. They follow the gradient ``-gamma F_i s_1`` and are kept within bounds. The
gain gamma is such that a joint whose blocks all slip moves its estimate as fast as k_e would.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
from gms_flex_control.control.compensation import common
from gms_flex_control.friction import gms

# Bounds of a block's factor.
LEAST, MOST = 0.4, 1.8


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave the adapted friction of the measured motion; see compensation."""
    blocks, factor, friction = state.observer.blocks, state.observer.factor, constants.friction
    common.take_displacement(state, measured.q_link, work)
    common.take_correction(state, constants, work)
    common.take_direction(state, work)
    n, n_blocks = factor.shape
    for j in range(n):
        work.scratch[j] = work.correction[j]
        work.correction[j] = 0.0  # it moves the factors, not the blocks
    observer.advance(blocks, work.displacement, measured.dq_link, work.smooth, work.correction,
                     work.resting, dt, friction)
    for j in range(n):
        row = gms.FORWARD if blocks.direction[j] > 0.0 else gms.BACKWARD
        gain = (n_blocks / friction.static[row, j]) ** 2
        total = friction.viscous[row, j] * measured.dq_link[j]
        for i in range(n_blocks):
            step = dt * gain * blocks.torque[j, i] * work.scratch[j]
            factor[j, i] = common.limited(factor[j, i] - step, LEAST, MOST)
            total += factor[j, i] * blocks.torque[j, i]
        work.estimate[0, j] = total
    common.filter_derivatives(state, dt, constants, work)
