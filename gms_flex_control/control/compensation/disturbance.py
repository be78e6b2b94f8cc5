# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
A disturbance observer: friction is what the links lack of the model's acceleration.

It knows no friction model. An observer of the link velocities with both poles of its error at
BANDWIDTH estimates the acceleration that is missing; M(q) times it is the friction.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.control.compensation import common
from gms_flex_control.dynamics import chain
import numpy as np

BANDWIDTH = 30.0  # [rad/s]


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave the torque that the link equation (1) lacks; see compensation."""
    links, found = constants.chain, state.observer
    n = constants.kd_link.shape[0]
    work.chain.tau[:] = work.spring
    chain.accelerations(measured.q_link, measured.dq_link, links, work.chain)
    pole = np.exp(-BANDWIDTH * dt)
    for j in range(n):
        if not state.started[0] or dt <= 0.0:
            found.velocity[j] = measured.dq_link[j]
            continue
        error = measured.dq_link[j] - found.velocity[j]
        found.missing[j] += (1.0 - pole) ** 2 / dt * error
        found.velocity[j] += 2.0 * (1.0 - pole) * error + dt * (
            work.chain.acceleration[j] + found.missing[j])
    chain.mass_times(found.missing, links, work.chain, work.scratch)
    for j in range(n):
        work.estimate[0, j] = -work.scratch[j]
    common.filter_derivatives(state, dt, constants, work)
