# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What several compensations do alike: displacement, correction, command filter."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
import numpy as np


@compiled
def take_displacement(state, seen, work):
    """Write how far ``seen`` (n,) has moved since the tick before into work.displacement."""
    for j in range(work.displacement.shape[0]):
        if not state.started[0]:
            state.q_before[j] = seen[j]
        work.displacement[j] = seen[j] - state.q_before[j]
        state.q_before[j] = seen[j]


@compiled
def take_correction(state, constants, work):
    """Write k_e s_1 into work.correction; none where the error is that of a limited torque."""
    for j in range(constants.kd_link.shape[0]):
        work.correction[j] = constants.observer_gain[j] * work.sliding[j]
        if state.saturated[j]:
            work.correction[j] = 0.0  # the error is then not the observer's fault


@compiled
def take_direction(state, work):
    """Write the sign of the last motion, this displacement included, into work.smooth."""
    blocks = state.observer.blocks
    for j in range(work.displacement.shape[0]):
        turned = work.displacement[j] * blocks.direction[j] < 0.0
        work.smooth[j] = -blocks.direction[j] if turned else blocks.direction[j]
        work.slope[j] = 0.0


@compiled
def filter_derivatives(state, dt, constants, work):
    """Take the derivatives of F_hat from the command filter that follows it."""
    filtered = state.observer.filtered
    observer.filter_step(filtered, work.estimate[0], constants.filter_bandwidth, dt)
    for j in range(constants.kd_link.shape[0]):
        bandwidth = constants.filter_bandwidth[j]
        offset = work.estimate[0, j] - filtered[0, j]
        work.estimate[1, j] = filtered[1, j]
        work.estimate[2, j] = bandwidth * (bandwidth * offset - 2.0 * filtered[1, j])


@compiled
def level_at(j, velocity, friction):
    """Return s(v) and the row of the direction of joint ``j`` moving with ``velocity``."""
    row = observer.FORWARD if velocity >= 0.0 else observer.BACKWARD
    level, _ = observer.level_of(j, 1.0 if velocity >= 0.0 else -1.0, velocity, friction)
    return level, row


@compiled
def limited(value, low, high):
    """Return ``value`` within ``low`` and ``high``."""
    return np.minimum(np.maximum(value, low), high)
