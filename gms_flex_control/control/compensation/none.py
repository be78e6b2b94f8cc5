# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""No compensation; blocks follow the measured motion, for a mode that is switched on later."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
from gms_flex_control.control.compensation import common


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave zero; see compensation."""
    common.take_displacement(state, measured.q_link, work)
    common.take_correction(state, constants, work)
    common.take_direction(state, work)
    observer.advance(state.observer.blocks, work.displacement, measured.dq_link, work.smooth,
                     work.correction, work.resting, dt, constants.friction)
    work.estimate[:] = 0.0
