# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
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

from gms_flex_control import friction as gms
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.dynamics import chain
import numpy as np

# rows of the friction parameters of one joint; the blocks' stiffness and weight follow
STATIC, COULOMB, VELOCITY, VISCOUS = 0, 1, 2, 3  # forward; backward 4 further
PER_DIRECTION = 4
ATTRACTION = 8
BLOCKS = 9
_SAME_POSE = 16  # samples over which the inertia of the derivatives is taken as constant


def parameter_rows(n_blocks, n_extra) -> int:
    """Return how many numbers describe one joint: friction, blocks and extra torques."""
    return BLOCKS + 2 * n_blocks + n_extra


@compiled
def begin(angle, rate, torque, period, state, q, dq, friction) -> None:
    """Start at the first angles of (T, n), ``rate`` (n,), the blocks sharing ``torque`` (n,)."""
    for j in range(q.shape[0]):
        first = 0
        while first < angle.shape[0] - 1 and np.isnan(angle[first, j]):
            first += 1
        q[j], dq[j] = angle[first, j] + 0.5 * period * rate[j], rate[j]
        state.direction[j] = 1.0 if torque[j] >= 0.0 else -1.0
        row = gms.FORWARD if torque[j] >= 0.0 else gms.BACKWARD
        load = min(max(torque[j], -friction.static[row, j]), friction.static[row, j])
        for i in range(state.torque.shape[1]):
            state.torque[j, i] = friction.weight[j, i] * load
            state.sticking[j, i] = 1


@compiled
def at_sample(q, dq, period) -> float:
    """Return the angle at a sample: ``q`` runs half a period ahead of ``dq``."""
    return q - 0.5 * period * dq


@compiled
def outside(error, half) -> float:
    """Return how far ``error`` lies outside +-``half``; zero inside."""
    if error > half:
        return error - half
    if error < -half:
        return error + half
    return 0.0


@compiled_part
def level_tangents(j, a, sign, velocity, d_dq, directions, friction, out) -> None:
    """
    Write the derivative of s(v) of joint ``j`` (Eq. 4) along each direction to ``out`` (P,).

    As in all functions here, ``a`` is the row of the joint among those carried; the first row is
    the joint whose own parameters move.
    """
    row = gms.FORWARD if sign > 0.0 else gms.BACKWARD
    rows = PER_DIRECTION * row
    scale = friction.velocity[row, j]
    x = velocity / scale
    decay = np.exp(-x * x) if x * x < 50.0 else 0.0
    slope = 2.0 * x / scale * decay * (friction.static[row, j] - friction.coulomb[row, j])
    for p in range(out.shape[0]):
        out[p] = -slope * d_dq[a, p]
    if a == 0:
        for p in range(out.shape[0]):
            out[p] += (decay * directions[rows + STATIC, p]
                       + (1.0 - decay) * directions[rows + COULOMB, p]
                       + slope * x * directions[rows + VELOCITY, p])


@compiled_part
def advance_tangents(j, a, displacement, d_displacement, velocity, d_dq, dt, state, directions,
                     friction, d_level, d_torque) -> None:
    """Advance joint ``j`` as friction.advance_joint, and the derivatives of its blocks."""
    turned = displacement * state.direction[j] < 0.0
    if turned:
        state.direction[j] = -state.direction[j]
    sign = state.direction[j]
    level, _ = gms.level_of(j, sign, velocity, friction)
    level_tangents(j, a, sign, velocity, d_dq, directions, friction, d_level)
    attraction = friction.attraction[j]
    decay = np.exp(-attraction * dt / level)
    blocks, width = d_torque.shape[1:]
    for i in range(blocks):
        stiffness, weight = friction.stiffness[j, i], friction.weight[j, i]
        if weight == 0.0:  # there for the shape of the record alone
            continue
        limit = sign * weight * level
        share = slower = 0.0  # a slipping block keeps a share of its derivative, one breaking none
        if turned:
            state.sticking[j, i] = 1
        if state.sticking[j, i]:
            state.torque[j, i] += stiffness * displacement  # Eq. (2)
            if sign * state.torque[j, i] < sign * limit:
                for p in range(width):
                    d_torque[a, i, p] += stiffness * d_displacement[p]
                if a == 0:
                    for p in range(width):
                        d_torque[a, i, p] += displacement * directions[BLOCKS + i, p]
                continue
            state.torque[j, i], state.sticking[j, i] = limit, 0
        else:  # Eq. (3), exact over the step
            above = (state.torque[j, i] - limit) * decay
            state.torque[j, i] = limit + above
            share, slower = decay, above * dt / level
        follows = sign * weight * (1.0 - share) + slower * attraction / level
        for p in range(width):
            d_torque[a, i, p] = share * d_torque[a, i, p] + follows * d_level[p]
        if a == 0:
            scaled = sign * level * (1.0 - share)
            for p in range(width):
                d_torque[a, i, p] += (scaled * directions[BLOCKS + blocks + i, p]
                                      - slower * directions[ATTRACTION, p])


@compiled_part
def mobility(carried, links, work, out) -> None:
    """Write the inverse of M between the ``carried`` joints, all others held, to ``out``."""
    m = carried.shape[0]
    chain.mass_between(carried, links, work, out)
    for pivot in range(m):  # Gauss-Jordan; M is positive definite
        reciprocal = 1.0 / out[pivot, pivot]
        out[pivot, pivot] = 1.0
        for b in range(m):
            out[pivot, b] *= reciprocal
        for a in range(m):
            if a != pivot:
                factor = out[a, pivot]
                out[a, pivot] = 0.0
                for b in range(m):
                    out[a, b] -= factor * out[pivot, b]


@compiled_part
def accelerate(torque, factor, further, joint, period, q, dq, half, state, links, friction,
               work) -> None:
    """
    Write accelerations under ``torque``, friction times ``factor`` (n,), and ``further``.

    Where an encoder counts (``half`` above 0), viscous friction is that of the rate in the middle
    of a sample. Taken at its beginning it passes for inertia, which noise hides, but no counts.
    """
    gms.total(state, dq, friction, work.friction)
    for j in range(q.shape[0]):
        work.chain.tau[j] = torque[j] - factor[j] * work.friction[j]  # Eq. (1), link
        row = gms.FORWARD if state.direction[j] > 0.0 else gms.BACKWARD
        middle = 0.5 * period if half[j] > 0.0 else 0.0
        work.chain.implicit[j] = middle * factor[j] * friction.viscous[row, j]
    work.chain.tau[joint] += further
    chain.accelerations(q, dq, links, work.chain)


@compiled_part
def advance_links(error, gains, period, q, dq, work) -> None:
    """Advance angles and rates (n,) by one sample; ``error`` (n,) draws them to the encoders."""
    for j in range(q.shape[0]):
        dq[j] += period * (work.chain.acceleration[j] + gains[1, j] * error[j])
        work.displacement[j] = period * dq[j]
        # where a link came to rest is drawn to the reading without loading its blocks
        q[j] += work.displacement[j] + period * gains[0, j] * error[j]


@compiled_part
def torque_tangents(j, a, k, rate, factor, extra, state, directions, friction, d_torque, d_dq,
                    out) -> None:
    """
    Write the derivative of the torque on joint ``j`` at sample ``k`` into row a of ``out``.

    ``rate`` is that of its viscous friction.
    """
    blocks, width = d_torque.shape[1:]
    row = gms.FORWARD if state.direction[j] > 0.0 else gms.BACKWARD
    viscous, rows = friction.viscous[row, j], PER_DIRECTION * row + VISCOUS
    for p in range(width):
        out[a, p] = -viscous * d_dq[a, p]
    for i in range(blocks):  # rows in the outer loop: the inner one is then vectorised
        if friction.weight[j, i] != 0.0:
            for p in range(width):
                out[a, p] -= d_torque[a, i, p]
    if a == 0:
        for p in range(width):
            out[a, p] -= directions[rows, p] * rate
    for p in range(width):
        out[a, p] *= factor[k, j]
    if a == 0:
        for r in range(extra.shape[1]):
            for p in range(width):
                out[a, p] += extra[k, r] * directions[BLOCKS + 2 * blocks + r, p]


@compiled
def predict(angle, rate, torque, factor, extra, coefficients, period, links, friction, carried,
            directions, gains, half, state, work, predicted, innovation, jacobian) -> None:
    """
    Predict one segment of a recording, with the derivatives of one joint's prediction.

    Link equation (1) with Eqs. (2) to (5); semi-implicit as simulation.plant, but for viscous
    friction where encoders count, see `accelerate`.

    Parameters
    ----------
    angle, torque : ndarray, shape (T, n)
        Measured link angles, NaN where absent, which corrects nothing [rad]; mean drive
        torque on each link from sample k to k + 1 [N m].
    rate : ndarray, shape (n,)
        Link velocities at the beginning [rad/s].
    factor : ndarray, shape (T, n)
        Of the friction that the parameters describe.
    extra, coefficients : ndarray, shape (T, R) and (R,)
        Further torques on ``joint`` per unit of their coefficient, and the coefficients.
    period : float
        Sample [s].
    links, friction : numpy.record
        From dynamics.chain.constants_of and friction.constants_of.
    carried : ndarray of int, shape (m,)
        First the joint whose parameters move, then those that its motion moves; the others
        are taken as not reacting to the parameters.
    directions : ndarray, shape (9 + 2 N + R, P)
        Derivative of the joint's parameters (see STATIC ...; then stiffness, weight and
        coefficients) to P numbers of the caller's choice.
    gains : ndarray, shape (2, n)
        l1 [1/s] and l2 [1/s^2] of the observer; zeros let the prediction run freely.
    half : ndarray, shape (n,)
        Half an encoder count [rad]; 0 takes readings as exact.
    state, work : numpy.record
        Of friction.state_layout and simulation.plant.work_layout; overwritten.
    predicted, innovation, jacobian : ndarray, shape (T, n), (T, n) and (T, P)
        Filled: predicted angles, how far the readings lie from them [rad], and the derivative of
        the innovation of the first carried joint, sign reversed.

    """
    samples, n = angle.shape
    m, width, joint = len(carried), directions.shape[1], carried[0]
    q, dq = np.empty(n), np.empty(n)
    begin(angle, rate, torque[0], period, state, q, dq, friction)
    d_q, d_dq, d_push = np.zeros((m, width)), np.zeros((m, width)), np.zeros((m, width))
    d_seen = np.zeros((m, width))
    d_displacement, d_level = np.zeros(width), np.zeros(width)
    d_torque = np.zeros((m, state.torque.shape[1], width))
    yielding, seen = np.empty((m, m)), np.empty(m)
    for k in range(samples):
        for j in range(n):
            predicted[k, j] = at_sample(q[j], dq[j], period)
            innovation[k, j] = outside(angle[k, j] - predicted[k, j], half[j])
        for a in range(m):
            seen[a] = 1.0 if innovation[k, carried[a]] != 0.0 else 0.0
            for p in range(width):
                d_seen[a, p] = seen[a] * (d_q[a, p] - 0.5 * period * d_dq[a, p])
        for p in range(width):
            jacobian[k, p] = d_seen[0, p]
        if k == samples - 1:
            break
        accelerate(torque[k], factor[k], further_torque(coefficients, extra[k]), joint, period,
                   q, dq, half, state, links, friction, work)
        if k % _SAME_POSE == 0:
            mobility(carried, links, work.chain, yielding)
        for a in range(m):
            j = carried[a]
            middle = 0.5 * period * work.chain.acceleration[j] if half[j] > 0.0 else 0.0
            torque_tangents(j, a, k, dq[j] + middle, factor, extra, state, directions, friction,
                            d_torque, d_dq, d_push)
        advance_links(innovation[k], gains, period, q, dq, work)
        for a in range(m):
            j = carried[a]
            for p in range(width):
                d_dq[a, p] -= period * gains[1, j] * d_seen[a, p]
            for b in range(m):
                for p in range(width):
                    d_dq[a, p] += period * yielding[a, b] * d_push[b, p]
            for p in range(width):
                d_displacement[p] = period * d_dq[a, p]
                d_q[a, p] += d_displacement[p] - period * gains[0, j] * d_seen[a, p]
            advance_tangents(j, a, work.displacement[j], d_displacement, dq[j], d_dq, period,
                             state, directions, friction, d_level, d_torque)
        for j in range(n):
            if not is_among(j, carried):
                gms.advance_joint(j, state, work.displacement[j], dq[j], period, friction)


@compiled_part
def is_among(j, carried) -> bool:
    """Return whether joint ``j`` is among ``carried`` (m,)."""
    for a in range(carried.shape[0]):
        if carried[a] == j:
            return True
    return False


@compiled_part
def further_torque(coefficients, extra) -> float:
    """Return the sum of further torques, coefficients (R,) times ``extra`` (R,)."""
    total = 0.0
    for r in range(coefficients.shape[0]):
        total += coefficients[r] * extra[r]
    return total


@compiled
def simulate_freely(angle, rate, torque, factor, extra, coefficients, period, links, friction,
                    joint, gains, half, first, stride, horizon, state, freed, work,
                    predicted) -> None:
    """
    Simulate ``horizon`` samples without correction from corrected states, see `predict`.

    The simulations start at sample ``first`` and every ``stride`` further; ``extra`` acts on
    ``joint``. ``predicted`` (S, horizon, n) gets the angles from each of the S starts that fit
    into the segment [rad]; ``freed`` is overwritten as ``state``.
    """
    samples, n = angle.shape
    q, dq, free_q, free_dq = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    error, none = np.empty(n), np.zeros(n)
    begin(angle, rate, torque[0], period, state, q, dq, friction)
    start = 0
    for k in range(samples - 1):
        if k == first + start * stride and start < predicted.shape[0]:
            copy_state(state, q, dq, freed, free_q, free_dq)
            for step in range(horizon):
                for j in range(n):
                    predicted[start, step, j] = at_sample(free_q[j], free_dq[j], period)
                one_step(torque[k + step], factor[k + step], extra[k + step], coefficients, joint,
                         none, gains, period, free_q, free_dq, half, freed, links, friction, work)
            start += 1
        for j in range(n):
            error[j] = outside(angle[k, j] - at_sample(q[j], dq[j], period), half[j])
        one_step(torque[k], factor[k], extra[k], coefficients, joint, error, gains, period, q, dq,
                 half, state, links, friction, work)


@compiled_part
def copy_state(state, q, dq, freed, free_q, free_dq) -> None:
    """Copy blocks, angles and rates."""
    for j in range(q.shape[0]):
        free_q[j], free_dq[j] = q[j], dq[j]
        freed.direction[j] = state.direction[j]
        for i in range(state.torque.shape[1]):
            freed.torque[j, i], freed.sticking[j, i] = state.torque[j, i], state.sticking[j, i]


@compiled_part
def one_step(torque, factor, extra, coefficients, joint, error, gains, period, q, dq, half, state,
             links, friction, work) -> None:
    """Advance links and blocks by one sample, in place."""
    accelerate(torque, factor, further_torque(coefficients, extra), joint, period, q, dq, half,
               state, links, friction, work)
    advance_links(error, gains, period, q, dq, work)
    for j in range(q.shape[0]):
        gms.advance_joint(j, state, work.displacement[j], dq[j], period, friction)
