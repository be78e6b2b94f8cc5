# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""GMS driven by the desired motion alone: a feedforward that no encoder disturbs."""

from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
from gms_flex_control.control.compensation import common
from gms_flex_control.friction import gms


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave the friction the desired motion would meet; see compensation."""
    blocks = state.observer.blocks
    common.take_displacement(state, reference[0], work)
    common.take_direction(state, work)
    work.correction[:] = 0.0
    observer.advance(blocks, work.displacement, reference[1], work.smooth, work.correction,
                     work.resting, dt, constants.friction)
    gms.total(blocks, reference[1], constants.friction, work.estimate[0])
    common.filter_derivatives(state, dt, constants, work)
