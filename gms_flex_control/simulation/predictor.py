# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Link angles predicted from measured torques, drawn gently to the encoders, with derivatives.

The links of Eq. (1) move under the torques that were measured, the friction of the model and a
soft observer ``dq += l1 e``, ``ddq += l2 e`` on the innovation e, measured minus predicted. A
model that is right needs no correction, so the innovations of a whole recording, sliding,
sticking and all between, are what an identification makes small. They are never integrated for
long, so the prediction cannot drift away, and nothing measured is differentiated.

An encoder that counts says no more than an interval. The innovation is therefore the distance
to that interval, zero inside it. Taken as an angle, the reading would pull a stiff block that
breaks away within one count by half a count, most of its whole load.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.dynamics import chain
from gms_flex_control.friction import gms
import numpy as np

# rows of the friction parameters of one joint; the blocks' stiffness and weight follow
STATIC, COULOMB, VELOCITY, VISCOUS = 0, 1, 2, 3  # forward; backward 4 further
PER_DIRECTION = 4
ATTRACTION = 8
BLOCKS = 9


def parameter_rows(n_blocks, n_extra):
    """Return how many numbers describe one joint: friction, blocks and extra torques."""
    return BLOCKS + 2 * n_blocks + n_extra


@compiled
def begin(angle, rate, torque, state, q, dq, friction):
    """Start at the measured angle (n,) and ``rate`` (n,); blocks share ``torque`` as they can."""
    for j in range(q.shape[0]):
        q[j], dq[j] = angle[j], rate[j]
        state.direction[j] = 1.0 if torque[j] >= 0.0 else -1.0
        row = gms.FORWARD if torque[j] >= 0.0 else gms.BACKWARD
        load = min(max(torque[j], -friction.static[row, j]), friction.static[row, j])
        for i in range(state.torque.shape[1]):
            state.torque[j, i] = friction.weight[j, i] * load
            state.sticking[j, i] = 1


@compiled
def outside(error, half):
    """Return how far ``error`` lies outside +-``half``; zero inside."""
    if error > half:
        return error - half
    if error < -half:
        return error + half
    return 0.0


@compiled
def level_tangents(j, sign, velocity, d_velocity, directions, friction, out):
    """Write the derivative of s(v) of joint ``j`` (Eq. 4) along each direction to ``out`` (P,)."""
    row = gms.FORWARD if sign > 0.0 else gms.BACKWARD
    rows = PER_DIRECTION * row
    scale = friction.velocity[row, j]
    x = velocity / scale
    decay = np.exp(-x * x) if x * x < 50.0 else 0.0
    slope = 2.0 * x / scale * decay * (friction.static[row, j] - friction.coulomb[row, j])
    for p in range(out.shape[0]):
        out[p] = (decay * directions[rows + STATIC, p]
                  + (1.0 - decay) * directions[rows + COULOMB, p]
                  + slope * (x * directions[rows + VELOCITY, p] - d_velocity[p]))


@compiled
def advance_tangents(j, displacement, d_displacement, velocity, d_velocity, dt, state,
                     directions, friction, d_level, d_torque):
    """Advance joint ``j`` as friction.gms.advance_joint, and the derivatives of its blocks."""
    turned = displacement * state.direction[j] < 0.0
    if turned:
        state.direction[j] = -state.direction[j]
    sign = state.direction[j]
    level, _ = gms.level_of(j, sign, velocity, friction)
    level_tangents(j, sign, velocity, d_velocity, directions, friction, d_level)
    blocks, width = d_torque.shape
    attraction = friction.attraction[j]
    decay = np.exp(-attraction * dt / level)
    for i in range(blocks):
        stiffness, weight = friction.stiffness[j, i], friction.weight[j, i]
        of_stiffness, of_weight = BLOCKS + i, BLOCKS + blocks + i
        limit = sign * weight * level
        if turned:
            state.sticking[j, i] = 1
        if state.sticking[j, i]:
            state.torque[j, i] += stiffness * displacement  # Eq. (2)
            if sign * state.torque[j, i] >= sign * limit:
                state.torque[j, i], state.sticking[j, i] = limit, 0
                for p in range(width):
                    d_torque[i, p] = sign * (weight * d_level[p]
                                             + level * directions[of_weight, p])
            else:
                for p in range(width):
                    d_torque[i, p] += (stiffness * d_displacement[p]
                                       + displacement * directions[of_stiffness, p])
        else:  # Eq. (3), exact over the step
            above = (state.torque[j, i] - limit) * decay
            state.torque[j, i] = limit + above
            slower = above * dt / level
            for p in range(width):
                d_limit = sign * (weight * d_level[p] + level * directions[of_weight, p])
                d_torque[i, p] = d_limit + (d_torque[i, p] - d_limit) * decay + slower * (
                    attraction / level * d_level[p] - directions[ATTRACTION, p])


@compiled
def own_inertia(joint, links, work):
    """Return the diagonal entry of M of ``joint`` from the work's cosines and sines [kg m^2]."""
    inertia = 0.0
    for i in range(links.moment.shape[0]):
        for k in range(links.moment.shape[0]):
            cos_ik = work.cosine[i] * work.cosine[k] + work.sine[i] * work.sine[k]
            inertia += links.orientation[i, joint] * links.orientation[k, joint] * (
                links.coupling[i, k] * cos_ik + links.rigid_inertia[i, k])
    return inertia


@compiled
def accelerate(torque, further, joint, q, dq, state, links, friction, work):
    """Write the accelerations under ``torque`` (n,), ``further`` on ``joint`` and friction."""
    gms.total(state, dq, friction, work.friction)
    for j in range(q.shape[0]):
        work.chain.tau[j] = torque[j] - work.friction[j]  # Eq. (1), link
    work.chain.tau[joint] += further
    chain.accelerations(q, dq, links, work.chain)


@compiled
def advance_links(error, gains, period, q, dq, work):
    """Advance angles and rates (n,) by one sample; ``error`` (n,) draws them to the encoders."""
    for j in range(q.shape[0]):
        dq[j] += period * (work.chain.acceleration[j] + gains[1, j] * error[j])
        work.displacement[j] = period * dq[j]
        # where a link came to rest is drawn to the reading without loading its blocks
        q[j] += work.displacement[j] + period * gains[0, j] * error[j]


@compiled
def rate_tangents(mobility, dq, extra, state, joint, directions, friction, d_torque, d_dq, out):
    """Write the derivative of the acceleration of ``joint`` (P,) into ``out``."""
    blocks, width = d_torque.shape
    row = gms.FORWARD if state.direction[joint] > 0.0 else gms.BACKWARD
    viscous, own = friction.viscous[row, joint], PER_DIRECTION * row + VISCOUS
    first_extra = BLOCKS + 2 * blocks
    for p in range(width):
        total = -viscous * d_dq[p] - directions[own, p] * dq[joint]
        for i in range(blocks):
            total -= d_torque[i, p]
        for r in range(extra.shape[0]):
            total += extra[r] * directions[first_extra + r, p]
        out[p] = total * mobility


@compiled
def predict(angle, rate, torque, extra, coefficients, period, links, friction, joint, directions,
            gains, half, state, work, predicted, innovation, jacobian):
    """
    Predict one stretch of a recording, with the derivatives of one joint's prediction.

    Parameters
    ----------
    angle : ndarray, shape (T, n)
        Measured link angles [rad]; NaN where there is none, which corrects nothing.
    rate : ndarray, shape (n,)
        Link velocities at the beginning [rad/s].
    torque : ndarray, shape (T, n)
        Mean drive torque on each link from sample k to k + 1 [N m].
    extra : ndarray, shape (T, R)
        Further torques on ``joint`` per unit of their coefficient.
    coefficients : ndarray, shape (R,)
        Of the further torques.
    period : float
        Sample [s].
    links, friction : numpy.record
        From dynamics.chain.constants_of and friction.gms.constants_of.
    joint : int
        Joint whose derivatives are wanted.
    directions : ndarray, shape (9 + 2 N + R, P)
        Derivative of the joint's parameters (see STATIC ...; then stiffness, weight and
        coefficients) to P numbers of the caller's choice.
    gains : ndarray, shape (2, n)
        l1 [1/s] and l2 [1/s^2] of the observer; zeros let the prediction run freely.
    half : ndarray, shape (n,)
        Half an encoder count [rad]; 0 takes readings as exact.
    state : numpy.record
        Of friction.gms.state_layout; overwritten.
    work : numpy.record
        From simulation.plant.workspace.
    predicted, innovation : ndarray, shape (T, n)
        Filled: predicted angles, and how far the readings lie from them [rad].
    jacobian : ndarray, shape (T, P)
        Filled: derivative of the innovation of ``joint``, sign reversed; it neglects that the
        other joints move differently.

    Notes
    -----
    Link equation (1) with Eqs. (2) to (5); semi-implicit as simulation.plant.

    """
    samples, n = angle.shape
    width = directions.shape[1]
    q, dq = np.empty(n), np.empty(n)
    begin(angle[0], rate, torque[0], state, q, dq, friction)
    d_q, d_dq, d_ddq = np.zeros(width), np.zeros(width), np.zeros(width)
    d_displacement, d_level = np.zeros(width), np.zeros(width)
    d_torque = np.zeros((state.torque.shape[1], width))
    for k in range(samples):
        for j in range(n):
            predicted[k, j] = q[j]
            innovation[k, j] = outside(angle[k, j] - q[j], half[j])
        seen = 1.0 if innovation[k, joint] != 0.0 else 0.0
        for p in range(width):
            jacobian[k, p] = seen * d_q[p]
        if k == samples - 1:
            break
        further = 0.0
        for r in range(coefficients.shape[0]):
            further += coefficients[r] * extra[k, r]
        accelerate(torque[k], further, joint, q, dq, state, links, friction, work)
        rate_tangents(1.0 / own_inertia(joint, links, work.chain), dq, extra[k], state, joint,
                      directions, friction, d_torque, d_dq, d_ddq)
        advance_links(innovation[k], gains, period, q, dq, work)
        for p in range(width):
            d_dq[p] += period * (d_ddq[p] - seen * gains[1, joint] * d_q[p])
            d_displacement[p] = period * d_dq[p]
            d_q[p] += d_displacement[p] - seen * period * gains[0, joint] * d_q[p]
        for j in range(n):
            if j != joint:
                gms.advance_joint(j, state, work.displacement[j], dq[j], period, friction)
        advance_tangents(joint, work.displacement[joint], d_displacement, dq[joint], d_dq, period,
                         state, directions, friction, d_level, d_torque)


@compiled
def simulate_freely(angle, rate, torque, extra, coefficients, period, links, friction, joint,
                    gains, half, first, stride, horizon, state, freed, work, predicted):
    """
    Simulate ``horizon`` samples without correction from every ``stride``-th corrected state.

    Parameters
    ----------
    angle, rate, torque, extra, coefficients, period, links, friction, joint, gains, half, state,
    work
        As `predict`, here of the corrected prediction the simulations start from.
    first, stride, horizon : int
        The first start, samples from one to the next, and samples each goes on.
    freed : numpy.record
        Of friction.gms.state_layout; overwritten.
    predicted : ndarray, shape (S, horizon, n)
        Filled: angles from each start on [rad]; S starts fit into the stretch.

    """
    samples, n = angle.shape
    q, dq, free_q, free_dq = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    error, none = np.empty(n), np.zeros(n)
    begin(angle[0], rate, torque[0], state, q, dq, friction)
    start = 0
    for k in range(samples - 1):
        if k == first + start * stride and start < predicted.shape[0]:
            copy_state(state, q, dq, freed, free_q, free_dq)
            for step in range(horizon):
                for j in range(n):
                    predicted[start, step, j] = free_q[j]
                one_step(torque[k + step], extra[k + step], coefficients, joint, none, gains,
                         period, free_q, free_dq, freed, links, friction, work)
            start += 1
        for j in range(n):
            error[j] = outside(angle[k, j] - q[j], half[j])
        one_step(torque[k], extra[k], coefficients, joint, error, gains, period, q, dq, state,
                 links, friction, work)


@compiled
def copy_state(state, q, dq, freed, free_q, free_dq):
    """Copy blocks, angles and rates."""
    for j in range(q.shape[0]):
        free_q[j], free_dq[j] = q[j], dq[j]
        freed.direction[j] = state.direction[j]
        for i in range(state.torque.shape[1]):
            freed.torque[j, i], freed.sticking[j, i] = state.torque[j, i], state.sticking[j, i]


@compiled
def one_step(torque, extra, coefficients, joint, error, gains, period, q, dq, state, links,
             friction, work):
    """Advance links and blocks by one sample, in place."""
    further = 0.0
    for r in range(coefficients.shape[0]):
        further += coefficients[r] * extra[r]
    accelerate(torque, further, joint, q, dq, state, links, friction, work)
    advance_links(error, gains, period, q, dq, work)
    for j in range(q.shape[0]):
        gms.advance_joint(j, state, work.displacement[j], dq[j], period, friction)
