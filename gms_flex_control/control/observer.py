# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Friction observers: the GMS model driven by the measured motion, Eqs. (18) to (20) corrected.

``gms_paper`` smooths the sign of the velocity with a tanh and differentiates the estimate
analytically. ``gms`` keeps the sign of the last motion and obtains the derivatives from a
second-order command filter on the estimate alone.
"""

from functools import cache

from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.friction import BACKWARD, FORWARD, level_of
from gms_flex_control.records import FLOAT
import numpy as np

# Part of a block's break-away level that the correction k_e s_1 / C may take away: below 1, so
# that the level of Eq. (19) stays positive.
LARGEST_CORRECTION = 0.5


@cache
def state_layout(n, n_blocks) -> np.dtype:
    """
    Return the dtype of the memory of all compensations.

    ``blocks``, the GMS state; ``filtered`` (2, n), command filter: estimate [N m] and its rate;
    ``factor`` (n, N), adapted; ``bristle`` (n,), deflection of LuGre [rad]; ``velocity`` and
    ``missing`` (n,), velocity [rad/s] and acceleration [rad/s^2] of the disturbance observer.
    """
    return records.layout(
        ('blocks', gms.state_layout(n, n_blocks)), ('filtered', FLOAT, (2, n)),
        ('factor', FLOAT, (n, n_blocks)),
        *((name, FLOAT, (n,)) for name in ('bristle', 'velocity', 'missing')))


def init(friction) -> np.record:
    """Return the memory for joints with FrictionParams, at rest."""
    return records.build(state_layout(*friction.stiffness.shape), blocks=gms.init(friction),
                         factor=1.0)


@compiled
def bounded(correction, limit) -> float:
    """Return the correction k_e s_1 limited so that break-away stays possible, Eq. (19)."""
    return min(max(correction, -limit), limit)


@compiled_part
def advance_blocks(torque, sticking, turned, sign, smooth, displacement, level, correction,
                   attraction, dt, stiffness, weight) -> None:
    """Advance the blocks (N,) of a joint, Eqs. (19), (20): ``sign`` breaks, ``smooth`` drives."""
    decay = np.exp(-attraction * dt / level)
    for i in range(torque.shape[0]):
        pushed = bounded(correction, LARGEST_CORRECTION * weight[i] * attraction) / attraction
        if turned:
            sticking[i] = 1
        limit = level * (sign * weight[i] - pushed)
        if sticking[i]:
            torque[i] += stiffness[i] * displacement
            if sign * torque[i] >= sign * limit:
                torque[i] = limit
                sticking[i] = 0
        else:
            goal = level * (smooth * weight[i] - pushed)
            torque[i] = goal + (torque[i] - goal) * decay


@compiled
def advance(blocks, displacement, velocity, smooth, correction, resting, dt, friction) -> None:
    """Advance the observed blocks of all joints in place; those of a ``resting`` one stay."""
    for j in range(friction.attraction.shape[0]):
        if resting[j]:
            continue
        turned = displacement[j] * blocks.direction[j] < 0.0
        if turned:
            blocks.direction[j] = -blocks.direction[j]
        sign = blocks.direction[j]
        level, _ = level_of(j, sign, velocity[j], friction)
        advance_blocks(blocks.torque[j], blocks.sticking[j], turned, sign, smooth[j],
                       displacement[j], level, correction[j], friction.attraction[j], dt,
                       friction.stiffness[j], friction.weight[j])


@compiled_part
def first_derivative(blocks, velocity, acceleration, smooth, correction, friction, out) -> None:
    """Write dF_hat/dt (n,) of the analytic observer into ``out``, Eqs. (19) and (20)."""
    for j in range(friction.attraction.shape[0]):
        row = FORWARD if blocks.direction[j] > 0.0 else BACKWARD
        level, _ = level_of(j, blocks.direction[j], velocity[j], friction)
        total = friction.viscous[row, j] * acceleration[j]
        for i in range(friction.weight.shape[1]):
            if blocks.sticking[j, i]:
                total += friction.stiffness[j, i] * velocity[j]
            else:
                total += slip_rate(blocks.torque[j, i], friction.weight[j, i],
                                   friction.attraction[j], smooth[j], level, correction[j])
        out[j] = total


@compiled_part
def slip_rate(torque, weight, attraction, smooth, level, correction) -> float:
    """Return dF_i/dt of a slipping block, Eq. (20)."""
    pushed = bounded(correction, LARGEST_CORRECTION * weight * attraction)
    return attraction * (weight * smooth - torque / level) - pushed


@compiled_part
def second_derivative(blocks, velocity, acceleration, jerk, smooth, correction, slope,
                      correction_rate, friction, out) -> None:
    """
    Write the second time derivative of F_hat (n,) into ``out``.

    ``slope`` (n,) is dr/dv; 0 for the sign of the last motion, because slip ends at v = 0.
    """
    for j in range(friction.attraction.shape[0]):
        row = FORWARD if blocks.direction[j] > 0.0 else BACKWARD
        level, level_slope = level_of(j, blocks.direction[j], velocity[j], friction)
        total = friction.viscous[row, j] * jerk[j]
        for i in range(friction.weight.shape[1]):
            if blocks.sticking[j, i]:
                total += friction.stiffness[j, i] * acceleration[j]
                continue
            torque, weight = blocks.torque[j, i], friction.weight[j, i]
            rate = slip_rate(torque, weight, friction.attraction[j], smooth[j], level,
                             correction[j])
            total += friction.attraction[j] * (
                weight * slope[j] * acceleration[j] - rate / level
                + torque * level_slope * acceleration[j] / level ** 2)
            if abs(correction[j]) < LARGEST_CORRECTION * weight * friction.attraction[j]:
                total -= correction_rate[j]
        out[j] = total


@compiled_part
def filter_step(filtered, goal, bandwidth, dt) -> None:
    """Advance the critically damped command filter (2, n) in place towards ``goal`` (n,)."""
    for j in range(goal.shape[0]):
        w, x, rate = bandwidth[j], filtered[0, j] - goal[j], filtered[1, j]
        decay = np.exp(-w * dt)  # exact over the step for a held goal
        filtered[0, j] = goal[j] + (x + (rate + w * x) * dt) * decay
        filtered[1, j] = (rate - w * (rate + w * x) * dt) * decay
