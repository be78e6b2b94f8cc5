# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Steady-state friction: the Stribeck curve of each direction of motion."""

from gms_flex_control.compiled import compiled
import numpy as np

# exp(-50) vanishes beside 1 in double precision, and is slow to compute
_FULLY_DECAYED = 50.0


@compiled
def level_and_slope(v, static, coulomb, velocity) -> tuple:
    """Return s(v) and ds/dv of one joint in one direction (Eq. 4), all scalars."""
    x = v / velocity
    if x * x > _FULLY_DECAYED:
        return coulomb, 0.0
    decay = (static - coulomb) * np.exp(-x * x)
    return coulomb + decay, -2.0 * x / velocity * decay  # Eq. (4)


def _of_direction(dq, params, name):
    forward, backward = getattr(params.forward, name), getattr(params.backward, name)
    return np.where(np.asarray(dq) >= 0, forward, backward)


def stribeck_level(dq, params) -> np.ndarray:
    """
    Return the Stribeck level s(dq) > 0 of FrictionParams at velocities (..., n_joints) [N m].

    ``static`` at rest, falling to ``coulomb`` at speed: Eq. (4) with the direction-dependent
    values of Table 1; zero counts as forward. The sign of motion enters in Eq. (3), not here.
    """
    static, coulomb, velocity = (
        _of_direction(dq, params, name) for name in ('static', 'coulomb', 'velocity'))
    return coulomb + (static - coulomb) * np.exp(-(np.asarray(dq) / velocity) ** 2)  # Eq. (4)


def steady_friction(dq, params) -> np.ndarray:
    """
    Return the friction torque at constant velocities (..., n_joints) [N m].

    ``sgn(dq) s(dq) + viscous dq``, Eq. (6), with FrictionParams; zero at rest.
    """
    viscous = _of_direction(dq, params, 'viscous')
    return np.sign(dq) * stribeck_level(dq, params) + viscous * np.asarray(dq)  # Eq. (6)
