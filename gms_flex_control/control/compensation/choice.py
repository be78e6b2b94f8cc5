# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The compensation that the gains name."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control.compensation import (
    disturbance,
    gms_adaptive,
    gms_desired,
    gms_paper,
    gms_tracked,
    lugre,
    none,
    stribeck,
)
from gms_flex_control.params.gains import COMPENSATIONS

(NONE, GMS_PAPER, GMS, STRIBECK, LUGRE, GMS_DESIRED, GMS_ADAPTIVE,
 DISTURBANCE_OBSERVER) = range(len(COMPENSATIONS))


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave the chosen compensation's F_hat in work.estimate; see compensation."""
    mode = constants.compensation[0]
    if mode == GMS:
        gms_tracked.estimate(state, measured, reference, dt, constants, work)
    elif mode == GMS_PAPER:
        gms_paper.estimate(state, measured, reference, dt, constants, work)
    elif mode == STRIBECK:
        stribeck.estimate(state, measured, reference, dt, constants, work)
    elif mode == LUGRE:
        lugre.estimate(state, measured, reference, dt, constants, work)
    elif mode == GMS_DESIRED:
        gms_desired.estimate(state, measured, reference, dt, constants, work)
    elif mode == GMS_ADAPTIVE:
        gms_adaptive.estimate(state, measured, reference, dt, constants, work)
    elif mode == DISTURBANCE_OBSERVER:
        disturbance.estimate(state, measured, reference, dt, constants, work)
    else:
        none.estimate(state, measured, reference, dt, constants, work)
    state.started[0] = 1.0
