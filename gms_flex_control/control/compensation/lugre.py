# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The LuGre model on the measured motion: ``dz/dt = v - sigma_0 abs(v) z / s(v)``.

sigma_0 is the stiffness of all blocks together. sigma_1 is 0: the friction of this package has no
damping of the bristles, and an estimate of it would be positive feedback of a noisy velocity.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.control.compensation import common
import numpy as np


@compiled
def advance(bristle, displacement, stiffness, level):
    """Return the deflection z after a displacement, exact for a constant level."""
    if displacement == 0.0:
        return bristle
    end = level / stiffness if displacement > 0.0 else -level / stiffness
    return end + (bristle - end) * np.exp(-stiffness * abs(displacement) / level)


@compiled
def estimate(state, measured, reference, dt, constants, work):
    """Leave ``sigma_0 z + sigma_2 v``; see compensation."""
    bristle, friction = state.observer.bristle, constants.friction
    common.take_displacement(state, measured.q_link, work)
    for j in range(constants.kd_link.shape[0]):
        velocity, stiffness = measured.dq_link[j], friction.stiffness[j].sum()
        level, row = common.level_at(j, velocity, friction)
        if stiffness > 0.0:
            bristle[j] = advance(bristle[j], work.displacement[j], stiffness, level)
        work.estimate[0, j] = stiffness * bristle[j] + friction.viscous[row, j] * velocity
    common.filter_derivatives(state, dt, constants, work)
