# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Reference motions by name, and the smooth way into them from wherever the robot is."""

from functools import cache
from math import factorial, perm

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.trajectory.polynomials import COEFFICIENTS, DERIVATIVES, joined, Trajectory
import numpy as np

_PER_WAVE = 8           # segments of a period of the highest harmonic
_ALREADY_THERE = 1e-8  # what rounding leaves of a state and its derivatives


@cache
def _hermite_inverse(order):
    """Return the inverse of the conditions on the first ``order`` rows at x = 0 and 1."""
    rows = np.zeros((2 * order, 2 * order))
    for k in range(order):
        rows[k, k] = factorial(k)
        rows[order + k] = _derivative_at_one(k, 2 * order)
    return np.linalg.inv(rows)


def _derivative_at_one(k, count):
    """Return what each of ``count`` powers of x adds to derivative k at x = 1."""
    return np.array([perm(power, k) for power in range(count)], dtype=float)


def hermite(begin, end, duration) -> np.ndarray:
    """
    Return the polynomial between two states, of degree 9 for states of five rows.

    ``begin`` and ``end`` (..., k, n_joints) are value and time derivatives 1 to k - 1,
    ``duration`` (...) lies between [s]; coefficients (..., 2 k, n_joints) in powers of
    t / duration.
    """
    order = begin.shape[-2]
    scales = np.asarray(duration)[..., None, None] ** np.arange(order)[:, None]
    return _hermite_inverse(order) @ np.concatenate([begin * scales, end * scales], axis=-2)


def at_rest(q) -> np.ndarray:
    """Return the state (5, n_joints) of resting at ``q`` (n_joints,)."""
    return np.vstack([np.asarray(q, dtype=float), np.zeros((DERIVATIVES - 1, len(q)))])


def _positive(**values):
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise TrajectoryError(f'{name} must be above 0, got {value}')


def polynomials(starts, scales, polys, **options) -> Trajectory:
    """Return a trajectory of polynomial segments alone, see Trajectory."""
    m, _, n = np.shape(polys)
    flat = np.zeros((m, n))
    envelope = np.zeros((m, COEFFICIENTS))
    return Trajectory(start=starts, scale=scales, poly=polys, envelope=envelope, amplitude=flat,
                      omega=flat, phase=flat, **options)


def constant(q) -> np.ndarray:
    """Return the coefficients (10, n_joints) of staying at ``q`` (n_joints,)."""
    return np.vstack([np.asarray(q, dtype=float), np.zeros((COEFFICIENTS - 1, len(q)))])


def _straight(q, velocity):
    """Return the coefficients (10, n_joints) of leaving ``q`` at a constant velocity."""
    line = constant(q)
    line[1] = velocity
    return line


def hold(q) -> Trajectory:
    """Return a reference that stays at ``q`` (n_joints,) [rad]."""
    return polynomials([0.0], [1.0], [constant(q)], end=0.0)


def via_points(points, move_time, hold_time) -> Trajectory:
    """Return moves of degree 9 of ``move_time`` [s] through points (m, n), and rests between."""
    points = np.atleast_2d(np.asarray(points, dtype=float))
    _positive(move_time=move_time)
    if not hold_time >= 0:
        raise TrajectoryError(f'hold_time must be at least 0, got {hold_time}')
    starts, scales, polys, time = [0.0], [1.0], [constant(points[0])], hold_time
    for begin, end in zip(points[:-1], points[1:], strict=True):
        starts += [time, time + move_time]
        scales += [move_time, 1.0]
        polys += [hermite(at_rest(begin), at_rest(end), move_time), constant(end)]
        time += move_time + hold_time
    return polynomials(starts, scales, polys, end=time)


def through(times, states) -> Trajectory:
    """
    Return the motion through ``states`` (m, 5, n_joints) at rising ``times`` (m,) [s].

    NaN leaves a time derivative open: it is then the mean of those that the polynomials of degree
    2 k - 1 before and behind have there, and zero at both ends. Values sampled from a polynomial
    of low degree with some of its derivatives give that polynomial back between the ends.
    """
    times, states = np.asarray(times, dtype=float), np.array(states, dtype=float)
    durations = np.diff(times)
    if not (np.isfinite(durations) & (durations > 0.0)).all():
        raise TrajectoryError(f'times must rise from point to point, got {times.tolist()}')
    for k in range(1, DERIVATIVES):
        polys = hermite(states[:-1, :k], states[1:, :k], durations)
        rates = durations[:, None] ** -k
        at_end = _derivative_at_one(k, 2 * k) @ polys * rates
        at_begin = factorial(k) * polys[:, k] * rates
        found = np.zeros_like(states[:, k])
        found[1:-1] = (at_end[:-1] + at_begin[1:]) / 2.0
        states[:, k] = np.where(np.isnan(states[:, k]), found, states[:, k])
    polys = hermite(states[:-1], states[1:], durations)
    return polynomials(times, [*durations, 1.0], [*polys, constant(states[-1, 0])], end=times[-1])


def polynomial(amplitude, move_time, hold_time, repeats=1) -> Trajectory:
    """Return ``repeats`` moves to ``amplitude`` (n,) [rad] and back; times as of `via_points`."""
    far = np.asarray(amplitude, dtype=float)
    return via_points([np.zeros_like(far), *[far, np.zeros_like(far)] * int(repeats)],
                      move_time, hold_time)


def sinusoid(amplitude, period, *, phase=0.0, ramp_time=None) -> Trajectory:
    """Return ``amplitude sin(2 pi t / period + phase)`` [rad, s], ramped in, without end."""
    amplitude, period, phase = (
        np.atleast_1d(x).astype(float)
        for x in np.broadcast_arrays(np.atleast_1d(amplitude), period, phase))
    for value in period:
        _positive(period=value)
    ramp_time = 0.5 * period.max() if ramp_time is None else ramp_time
    _positive(ramp_time=ramp_time)
    omega, n = 2.0 * np.pi / period, len(amplitude)
    ramp = hermite(at_rest([0.0]), at_rest([1.0]), ramp_time)[:, 0]
    return Trajectory(
        start=[0.0, ramp_time], scale=[ramp_time, 1.0], poly=np.zeros((2, COEFFICIENTS, n)),
        envelope=np.stack([ramp, constant([1.0])[:, 0]]), amplitude=[amplitude] * 2,
        omega=[omega] * 2, phase=[phase, phase + omega * ramp_time])


def fourier(sine, cosine, period, *, repeats=1, ramp_time=2.0) -> Trajectory:
    """
    Return a Fourier series between two rests at zero.

    ``sine`` and ``cosine`` (n_harmonics, n_joints) are of harmonics 1, 2, ... [rad], ``period`` of
    the first harmonic [s], ``ramp_time`` from rest into the series, and out of it [s]. Its
    segments are the polynomials of degree 9 through value and four derivatives, eight for a period
    of the highest harmonic: they differ from the series by less than 1e-9 of it.
    """
    sine, cosine = np.atleast_2d(sine).astype(float), np.atleast_2d(cosine).astype(float)
    _positive(period=period, ramp_time=ramp_time)
    if sine.shape != cosine.shape:
        raise TrajectoryError(f'sine and cosine need as many harmonics of each joint, got '
                              f'{sine.shape} and {cosine.shape}')
    knots = _PER_WAVE * len(sine) * int(repeats)
    time = period * int(repeats) / knots * np.arange(knots + 1)
    omega = 2.0 * np.pi / period * np.arange(1, len(sine) + 1)
    turn, rate = omega * time[:, None], omega ** np.arange(DERIVATIVES)[:, None]
    shift = 0.5 * np.pi * np.arange(DERIVATIVES)[:, None]  # of each derivative
    states = (np.sin(turn[:, None] + shift) * rate) @ sine + (
        np.cos(turn[:, None] + shift) * rate) @ cosine
    still = at_rest(np.zeros(sine.shape[1]))[None]
    times = np.concatenate([[0.0], ramp_time + time, [2.0 * ramp_time + time[-1]]])
    return through(times, np.concatenate([still, states, still]))


def velocity_levels(velocities, durations, *, settle_time=0.5) -> Trajectory:
    """Return velocities (m, n) [rad/s] held ``durations`` (m,), changed in ``settle_time`` [s]."""
    velocities = np.atleast_2d(np.asarray(velocities, dtype=float))
    durations = np.atleast_1d(np.asarray(durations, dtype=float))
    if len(durations) != len(velocities):
        raise TrajectoryError(f'{len(velocities)} velocities need as many durations, '
                              f'got {len(durations)}')
    if not (np.all(durations > 0) and settle_time > 0):
        raise TrajectoryError(f'durations and settle_time must be above 0, got '
                              f'{durations.tolist()} and {settle_time}')
    state = at_rest(np.zeros(velocities.shape[1]))
    starts, scales, polys, time = [], [], [], 0.0
    for velocity, duration in zip([*velocities, 0.0 * velocities[0]], [*durations, 1.0],
                                  strict=True):
        held = at_rest(state[0] + 0.5 * settle_time * (state[1] + velocity))
        held[1] = velocity
        starts += [time, time + settle_time]
        scales += [settle_time, 1.0]
        polys += [hermite(state, held, settle_time), _straight(held[0], velocity)]
        time += settle_time + duration
        state = held.copy()
        state[0] += velocity * duration
    return polynomials(starts, scales, polys, end=starts[-1])


def sliding(velocity, modulation, period, duration, *, settle_time=1.0) -> Trajectory:
    """
    Return ``dq = velocity (1 + modulation sin(2 pi t / period))`` between two rests.

    ``velocity`` (n_joints,) [rad/s], ``modulation`` from 0 to below 1, so that nothing reverses;
    the sliding lasts ``duration``, speeding up and slowing down ``settle_time`` each [s].
    """
    velocity = np.asarray(velocity, dtype=float)
    _positive(period=period, duration=duration, settle_time=settle_time)
    if not 0 <= modulation < 1:
        raise TrajectoryError(f'modulation must be at least 0 and below 1, got {modulation}: '
                              'the motion would reverse')
    omega = 2.0 * np.pi / period
    swing = -velocity * modulation / omega  # integral of the variation, cosine phase
    body = Trajectory(
        start=[0.0], scale=[1.0], poly=[_straight(np.zeros_like(velocity), velocity)],
        envelope=[constant([1.0])[:, 0]], amplitude=[swing],
        omega=[np.full_like(velocity, omega)], phase=[np.full_like(velocity, 0.5 * np.pi)])
    first, last = body.sample(0.0), body.sample(duration)
    into = at_rest(first[0] - 0.5 * settle_time * first[1])
    out = at_rest(last[0] + 0.5 * settle_time * last[1])
    ways = polynomials(
        [0.0, settle_time + duration, 2 * settle_time + duration],
        [settle_time, settle_time, 1.0],
        [hermite(into, first, settle_time), hermite(last, out, settle_time), constant(out[0])])
    return joined([ways.part(slice(0, 1)), body.shifted(settle_time), ways.part(slice(1, 3))],
                  end=2 * settle_time + duration)


def torque_levels(levels, rate) -> Trajectory:
    """
    Return open-loop torques from zero through ``levels`` (m, n_joints) and back [N m].

    ``rate`` is the mean slope of the joint that changes most [N m/s]; the steepest is 2.5 times
    that, and at each level it is zero: a torque that jumps, or whose slope does, makes a motor on
    a spring ring.
    """
    if not rate > 0:
        raise TrajectoryError(f'rate must be above 0, got {rate}')
    levels = np.atleast_2d(np.asarray(levels, dtype=float))
    zero = np.zeros((1, levels.shape[1]))
    points = np.vstack([zero, levels, zero])
    starts, scales, polys, time = [], [], [], 0.0
    for begin, end in zip(points[:-1], points[1:], strict=True):
        duration = np.max(np.abs(end - begin)) / rate
        if duration > 0.0:
            starts, scales = [*starts, time], [*scales, duration]
            polys = [*polys, hermite(at_rest(begin), at_rest(end), duration)]
            time += duration
    return polynomials([*starts, time], [*scales, 1.0], [*polys, constant(zero[0])], end=time,
                       quantity='effort')


def approach(state, trajectory, time, *, duration=2.0) -> Trajectory:
    """
    Return ``trajectory``, its own time beginning at 0, entered smoothly from a state.

    ``state`` (5, n_joints) is the reference with its derivatives at ``time`` [s], at rest where
    the robot is without one. The way to the beginning takes ``duration`` [s] and is left
    out where the state is there; an effort starts at once.
    """
    begin = trajectory.sample(0.0)
    there = np.allclose(state, begin, rtol=0.0, atol=_ALREADY_THERE)
    if trajectory.quantity == 'effort' or there:
        return trajectory.shifted(time)
    _positive(duration=duration)
    way = polynomials([time], [duration], [hermite(state, begin, duration)])
    moved = trajectory.shifted(time + duration)
    return joined([way, moved], end=moved.end)


def braked(state, time, *, duration=2.0) -> Trajectory:
    """Return the way to rest from a state as of `approach`, as far as half its speed would go."""
    goal = state[0] + 0.5 * duration * state[1]
    return approach(state, hold(goal), time, duration=duration)
