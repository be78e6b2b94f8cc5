# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Generalized Maxwell-Slip friction, Eqs. (2) to (5), in the corrected form of docs/model.md.

A joint is a parallel set of blocks. A sticking block is a spring driven by the displacement; it
breaks away in the direction of motion at its share of the Stribeck level and then relaxes
towards it, exactly integrated over the step. All blocks stick again when the motion turns.
"""

from functools import cache, lru_cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.params.robot import STRIBECK
from gms_flex_control.records import FLAG, FLOAT
import numpy as np

# exp(-50) vanishes beside 1 in double precision, and is slow to compute
_FULLY_DECAYED = 50.0


@compiled_part
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
    """Return the level s(dq) > 0 of Eq. (4) at velocities (..., n_joints) [N m]."""
    static, coulomb, velocity = (
        _of_direction(dq, params, name) for name in ('static', 'coulomb', 'velocity'))
    return coulomb + (static - coulomb) * np.exp(-(np.asarray(dq) / velocity) ** 2)  # Eq. (4)


def steady_friction(dq, params) -> np.ndarray:
    """Return ``sgn(dq) s(dq) + viscous dq`` of velocities (..., n_joints), Eq. (6) [N m]."""
    viscous = _of_direction(dq, params, 'viscous')
    return np.sign(dq) * stribeck_level(dq, params) + viscous * np.asarray(dq)  # Eq. (6)


FORWARD, BACKWARD = 0, 1  # rows of the direction-dependent constants


@cache
def state_layout(n, n_blocks) -> np.dtype:
    """
    Return the dtype of the memory of n joints with N blocks each.

    Fields: ``torque`` (n, N), torque F_bi carried by each block [N m]; ``sticking`` (n, N), 1
    where a block sticks; ``direction`` (n,), direction of the last motion, +1 or -1.
    """
    return records.layout(('torque', FLOAT, (n, n_blocks)), ('sticking', FLAG, (n, n_blocks)),
                          ('direction', FLOAT, (n,)))


@cache
def constants_layout(n, n_blocks) -> np.dtype:
    """Return the dtype of the kernels' constants; see FrictionParams for the meaning."""
    return records.layout(
        *((name, FLOAT, (2, n)) for name in STRIBECK),
        ('stiffness', FLOAT, (n, n_blocks)), ('weight', FLOAT, (n, n_blocks)),
        ('attraction', FLOAT, (n,)))


@lru_cache(maxsize=256)
def constants_of(params) -> np.record:
    """Return a FrictionParams as the record the kernels take."""
    pairs = {name: np.stack([getattr(params.forward, name), getattr(params.backward, name)])
             for name in STRIBECK}
    return records.build(constants_layout(*params.stiffness.shape), **pairs,
                         stiffness=params.stiffness, weight=params.weight,
                         attraction=params.attraction)


def init(params, torque=None, direction=None) -> np.record:
    """Return the friction state of joints at rest, all blocks sticking, by default unloaded."""
    return records.build(state_layout(*params.stiffness.shape), sticking=1,
                         torque=0.0 if torque is None else torque,
                         direction=1.0 if direction is None else direction)


@compiled
def level_of(j, direction, velocity, constants) -> tuple:
    """Return s(v) and ds/dv of joint ``j`` moving in ``direction`` (+1 or -1), scalars."""
    row = FORWARD if direction > 0.0 else BACKWARD
    return level_and_slope(velocity, constants.static[row, j], constants.coulomb[row, j],
                           constants.velocity[row, j])


@compiled_part
def advance_blocks(torque, sticking, turned, sign, displacement, level, decay, stiffness,
                   weight) -> None:
    """Advance the blocks (N,) of one joint in place; ``decay`` = exp(-C dt / s)."""
    for i in range(torque.shape[0]):
        if turned:
            sticking[i] = 1
        limit = sign * weight[i] * level
        if sticking[i]:
            torque[i] += stiffness[i] * displacement  # Eq. (2), integrated over the step
            if sign * torque[i] >= sign * limit:      # directional break-away, with clip
                torque[i] = limit
                sticking[i] = 0
        else:
            torque[i] = limit + (torque[i] - limit) * decay  # Eq. (3), exact over the step


@compiled_part
def advance_joint(j, state, displacement, velocity, dt, constants) -> None:
    """Advance joint ``j`` in place by ``displacement`` at ``velocity`` over ``dt``, scalars."""
    turned = displacement * state.direction[j] < 0.0
    if turned:
        state.direction[j] = -state.direction[j]
    sign = state.direction[j]
    level, _ = level_of(j, sign, velocity, constants)
    decay = np.exp(-constants.attraction[j] * dt / level)
    advance_blocks(state.torque[j], state.sticking[j], turned, sign, displacement, level, decay,
                   constants.stiffness[j], constants.weight[j])


@compiled
def advance(state, displacement, velocity, dt, constants) -> None:
    """Advance all joints in place by ``displacement`` (n,) at ``velocity`` (n,) over ``dt``."""
    for j in range(constants.attraction.shape[0]):
        advance_joint(j, state, displacement[j], velocity[j], dt, constants)


@compiled
def total(state, velocity, constants, tau) -> None:
    """Write the friction torque of all joints (n,), viscous part included, into ``tau``."""
    for j in range(constants.attraction.shape[0]):
        row = FORWARD if state.direction[j] > 0.0 else BACKWARD
        tau[j] = constants.viscous[row, j] * velocity[j]  # Eq. (5)
        for i in range(state.torque.shape[1]):
            tau[j] += state.torque[j, i]


@compiled
def _replay(angle, rate, period, constants, state, displacement, tau):
    """Write the friction torque (T, n) along ``angle`` and ``rate`` (T, n) into ``tau``."""
    for k in range(angle.shape[0]):
        if k > 0:
            for j in range(angle.shape[1]):
                displacement[j] = angle[k, j] - angle[k - 1, j]
            advance(state, displacement, rate[k], period, constants)
        total(state, rate[k], constants, tau[k])


def replay(angle, rate, period, constants) -> np.ndarray:
    """
    Return the friction torque (T, n) along a motion, blocks unloaded at its beginning [N m].

    ``angle`` and ``rate`` are (T, n) [rad, rad/s], ``period`` the sample [s], ``constants`` a
    record of `constants_layout`. Eqs. (2), (3) and (5).
    """
    n, blocks = constants.stiffness.shape
    state = records.build(state_layout(n, blocks), sticking=1, direction=1.0)
    tau = np.empty(angle.shape)
    _replay(np.ascontiguousarray(angle), np.ascontiguousarray(rate), period, constants, state,
            np.zeros(n), tau)
    return tau
