# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The friction compensations, chosen by name.

Each takes the arguments of control.cascade.tick, advances its memory in ``state.observer`` and
leaves F_hat and two time derivatives in ``work.estimate`` (3, n); ``gms_paper`` alone leaves the
derivatives to the model's acceleration and jerk.
"""

from gms_flex_control import friction as gms
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.control import observer
from gms_flex_control.dynamics import chain
from gms_flex_control.params.gains import COMPENSATIONS
import numpy as np

(NONE, GMS_PAPER, GMS, STRIBECK, LUGRE, GMS_DESIRED, GMS_ADAPTIVE,
 DISTURBANCE_OBSERVER) = range(len(COMPENSATIONS))
# How fast a deviation from the reference moves the blocks of mode gms [rad/s].
DEVIATION_BANDWIDTH = 10.0
# Both poles of the error of the disturbance observer [rad/s].
DISTURBANCE_BANDWIDTH = 30.0
# Bounds of a block's adapted factor.
LEAST_FACTOR, LARGEST_FACTOR = 0.4, 1.8


@compiled
def estimate(state, measured, reference, dt, constants, work) -> None:
    """Leave the F_hat of the chosen compensation in ``work.estimate``."""
    mode = constants.compensation[0]
    if mode == GMS:
        _gms(state, measured, reference, dt, constants, work)
    elif mode == GMS_PAPER:
        _gms_paper(state, measured, dt, constants, work)
    elif mode == STRIBECK:
        _stribeck(measured, constants, work)
    elif mode == LUGRE:
        _lugre(state, measured, constants, work)
    elif mode == GMS_DESIRED:
        _gms_desired(state, reference, dt, constants, work)
    elif mode == GMS_ADAPTIVE:
        _gms_adaptive(state, measured, dt, constants, work)
    elif mode == DISTURBANCE_OBSERVER:
        _disturbance_observer(state, measured, dt, constants, work)
    else:
        _none(state, measured, dt, constants, work)
    if mode == NONE:
        work.estimate[:] = 0.0
    elif mode != GMS_PAPER:
        _filter_derivatives(state, dt, constants, work)
    state.started[0] = 1.0


@compiled_part
def _none(state, measured, dt, constants, work):
    """Blocks follow the measured motion, for a mode that is switched on later."""
    _take_displacement(state, measured.q_link, work)
    _take_correction(state, constants, work)
    _take_direction(state, work)
    observer.advance(state.observer.blocks, work.displacement, measured.dq_link, work.smooth,
                     work.correction, work.resting, dt, constants.friction)


@compiled_part
def _gms(state, measured, reference, dt, constants, work):
    """
    GMS on reference plus slow deviation, sign of the last motion, command filter.

    The reference is trusted for fast motion and the encoder for slow deviation from it: one
    encoder count can be longer than the whole presliding range.
    """
    gain = 1.0 - np.exp(-DEVIATION_BANDWIDTH * dt)
    for j in range(constants.kd_link.shape[0]):
        if not state.started[0]:
            state.deviation[j] = state.error[j]
        state.deviation[j] += gain * (state.error[j] - state.deviation[j])
        work.scratch[j] = reference[0, j] + state.deviation[j]
    _take_displacement(state, work.scratch, work)
    _take_correction(state, constants, work)
    _take_direction(state, work)
    _gms_torque(state, measured.dq_link, dt, constants, work)


@compiled_part
def _gms_paper(state, measured, dt, constants, work):
    """GMS on the measured motion, the sign smoothed by a tanh: the paper's, corrected."""
    _take_displacement(state, measured.q_link, work)
    _take_correction(state, constants, work)
    for j in range(constants.kd_link.shape[0]):
        slope = constants.sign_slope[j]
        work.smooth[j] = np.tanh(slope * measured.dq_link[j])
        work.slope[j] = slope * (1.0 - work.smooth[j] ** 2)
    _gms_torque(state, measured.dq_link, dt, constants, work)


@compiled_part
def _gms_desired(state, reference, dt, constants, work):
    """GMS driven by the desired motion alone: a feedforward that no encoder disturbs."""
    _take_displacement(state, reference[0], work)
    _take_direction(state, work)
    work.correction[:] = 0.0
    _gms_torque(state, reference[1], dt, constants, work)


@compiled_part
def _gms_torque(state, velocity, dt, constants, work):
    """Advance the blocks and write their F_hat, Eqs. (18) to (20)."""
    blocks = state.observer.blocks
    observer.advance(blocks, work.displacement, velocity, work.smooth, work.correction,
                     work.resting, dt, constants.friction)
    gms.total(blocks, velocity, constants.friction, work.estimate[0])


@compiled_part
def _gms_adaptive(state, measured, dt, constants, work):
    """
    Adaptive GMS with parameter projection, after Nilkhamhang and Sano (2006).

    Scaling k_i and alpha_i of a block by one factor scales its torque by it, at every motion: GMS
    is linear in such factors. They follow the gradient ``-gamma F_i s_1`` within bounds. The gain
    gamma lets a joint whose blocks all slip move its estimate as fast as k_e would.
    """
    blocks, factor, friction = state.observer.blocks, state.observer.factor, constants.friction
    _take_displacement(state, measured.q_link, work)
    _take_correction(state, constants, work)
    _take_direction(state, work)
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
            factor[j, i] = min(max(factor[j, i] - step, LEAST_FACTOR), LARGEST_FACTOR)
            total += factor[j, i] * blocks.torque[j, i]
        work.estimate[0, j] = total


@compiled_part
def _stribeck(measured, constants, work):
    """Write static friction, Eq. (6), ``tanh(k_v v) s(v) + sigma_2 v``."""
    for j in range(constants.kd_link.shape[0]):
        velocity = measured.dq_link[j]
        level, row = _level_at(j, velocity, constants.friction)
        work.estimate[0, j] = (np.tanh(constants.sign_slope[j] * velocity) * level
                               + constants.friction.viscous[row, j] * velocity)


@compiled_part
def _lugre(state, measured, constants, work):
    """
    Estimate by LuGre on the measured motion, ``dz/dt = v - sigma_0 abs(v) z / s(v)``.

    sigma_0 is the stiffness of all blocks together. sigma_1 is 0: the friction of this package
    has no damping of the bristles, and an estimate of it would be positive feedback of a noisy
    velocity.
    """
    bristle, friction = state.observer.bristle, constants.friction
    _take_displacement(state, measured.q_link, work)
    for j in range(constants.kd_link.shape[0]):
        velocity, stiffness = measured.dq_link[j], friction.stiffness[j].sum()
        level, row = _level_at(j, velocity, friction)
        if stiffness > 0.0:
            bristle[j] = advance_bristle(bristle[j], work.displacement[j], stiffness, level)
        work.estimate[0, j] = stiffness * bristle[j] + friction.viscous[row, j] * velocity


@compiled
def advance_bristle(bristle, displacement, stiffness, level) -> float:
    """Return the deflection z after a displacement, exact for a constant level."""
    if displacement == 0.0:
        return bristle
    end = level / stiffness if displacement > 0.0 else -level / stiffness
    return end + (bristle - end) * np.exp(-stiffness * abs(displacement) / level)


@compiled_part
def _disturbance_observer(state, measured, dt, constants, work):
    """Friction is what the links lack of the model's acceleration; no friction model is known."""
    links, found = constants.chain, state.observer
    for j in range(constants.kd_link.shape[0]):
        work.chain.tau[j] = work.spring[j]
    chain.accelerations(measured.q_link, measured.dq_link, links, work.chain)
    pole = np.exp(-DISTURBANCE_BANDWIDTH * dt)
    for j in range(constants.kd_link.shape[0]):
        if not state.started[0] or dt <= 0.0:
            found.velocity[j] = measured.dq_link[j]
            continue
        error = measured.dq_link[j] - found.velocity[j]
        found.missing[j] += (1.0 - pole) ** 2 / dt * error
        found.velocity[j] += 2.0 * (1.0 - pole) * error + dt * (
            work.chain.acceleration[j] + found.missing[j])
    chain.mass_times(found.missing, links, work.chain, work.scratch)
    for j in range(constants.kd_link.shape[0]):
        work.estimate[0, j] = -work.scratch[j]


@compiled_part
def _take_displacement(state, seen, work):
    """Write how far ``seen`` (n,) has moved since the tick before into work.displacement."""
    for j in range(work.displacement.shape[0]):
        if not state.started[0]:
            state.q_before[j] = seen[j]
        work.displacement[j] = seen[j] - state.q_before[j]
        state.q_before[j] = seen[j]


@compiled_part
def _take_correction(state, constants, work):
    """Write k_e s_1 into work.correction; 0 where the error is that of a limited torque."""
    for j in range(constants.kd_link.shape[0]):
        work.correction[j] = constants.observer_gain[j] * work.sliding[j]
        if state.saturated[j]:
            work.correction[j] = 0.0


@compiled_part
def _take_direction(state, work):
    """Write the sign of the last motion, this displacement included, into work.smooth."""
    blocks = state.observer.blocks
    for j in range(work.displacement.shape[0]):
        turned = work.displacement[j] * blocks.direction[j] < 0.0
        work.smooth[j] = -blocks.direction[j] if turned else blocks.direction[j]
        work.slope[j] = 0.0


@compiled_part
def _filter_derivatives(state, dt, constants, work):
    """Write the derivatives of F_hat from the command filter that follows it."""
    filtered = state.observer.filtered
    observer.filter_step(filtered, work.estimate[0], constants.filter_bandwidth, dt)
    for j in range(constants.kd_link.shape[0]):
        bandwidth = constants.filter_bandwidth[j]
        offset = work.estimate[0, j] - filtered[0, j]
        work.estimate[1, j] = filtered[1, j]
        work.estimate[2, j] = bandwidth * (bandwidth * offset - 2.0 * filtered[1, j])


@compiled_part
def _level_at(j, velocity, friction):
    """Return s(v) and the row of the direction of joint ``j`` moving with ``velocity``."""
    row = gms.FORWARD if velocity >= 0.0 else gms.BACKWARD
    level, _ = gms.level_of(j, 1.0 if velocity >= 0.0 else -1.0, velocity, friction)
    return level, row
