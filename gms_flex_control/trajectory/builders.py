# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Reference motions by name, and the smooth way into them from wherever the robot is."""

from dataclasses import replace
from functools import cache
from math import factorial, perm

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.trajectory.segments import COEFFICIENTS, DERIVATIVES, Trajectory
import numpy as np

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


def hermite(begin, end, duration):
    """
    Return the polynomial between two states, of degree 9 for states of five rows.

    Parameters
    ----------
    begin, end : ndarray, shape (..., k, n_joints)
        Value and time derivatives, 1 to 4 for k = 5, at both ends.
    duration : float or ndarray, shape (...)
        Time between them [s].

    Returns
    -------
    ndarray, shape (..., 2 k, n_joints)
        Coefficients in powers of t / duration.

    """
    order = begin.shape[-2]
    scales = np.asarray(duration)[..., None, None] ** np.arange(order)[:, None]
    return _hermite_inverse(order) @ np.concatenate([begin * scales, end * scales], axis=-2)


def at_rest(q):
    """Return the state (5, n_joints) of resting at ``q`` (n_joints,)."""
    return np.vstack([np.asarray(q, dtype=float), np.zeros((DERIVATIVES - 1, len(q)))])


def _positive(**values):
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise TrajectoryError(f'{name} must be above 0, got {value}')


def polynomials(starts, scales, polys, **options):
    """Return a trajectory of polynomial segments alone, see Trajectory."""
    m, _, n = np.shape(polys)
    flat = np.zeros((m, n))
    envelope = np.zeros((m, COEFFICIENTS))
    return Trajectory(start=starts, scale=scales, poly=polys, envelope=envelope, amplitude=flat,
                      omega=flat, phase=flat, **options)


def constant(q):
    """Return the coefficients (10, n_joints) of staying at ``q`` (n_joints,)."""
    return np.vstack([np.asarray(q, dtype=float), np.zeros((COEFFICIENTS - 1, len(q)))])


def hold(q):
    """Return a reference that stays at ``q`` (n_joints,) [rad]."""
    return polynomials([0.0], [1.0], [constant(q)], end=0.0)


def via_points(points, move_time, hold_time):
    """
    Return rest-to-rest moves of degree 9 through points, with holds between.

    Parameters
    ----------
    points : ndarray, shape (m, n_joints)
        Angles to rest at, the first one included [rad].
    move_time, hold_time : float
        Duration of each move and of each rest, also the first [s].

    Returns
    -------
    Trajectory
        Holds the last point at its end.

    """
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


def through(times, states):
    """
    Return the motion through states, of which derivatives may be left open.

    Parameters
    ----------
    times : ndarray, shape (m,)
        Of the states, rising [s].
    states : ndarray, shape (m, 5, n_joints)
        Value and time derivatives 1 to 4; NaN where a derivative is open.

    Returns
    -------
    Trajectory
        Continuous in all derivatives to the fourth, holds the last value at its end.

    Notes
    -----
    An open derivative k is the mean of those that the polynomials of degree 2 k - 1 before and
    behind have there; at both ends it is zero. Values sampled from a polynomial of low degree
    with some of its derivatives give that polynomial back between the ends.

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
    return polynomials(times, [*durations, 1.0], [*polys, constant(states[-1, 0])],
                       end=times[-1])


def polynomial(amplitude, move_time, hold_time, repeats=1):
    """
    Return the paper's polynomial reference: to ``amplitude`` and back, with holds.

    Parameters
    ----------
    amplitude : ndarray, shape (n_joints,)
        Angle of the far rest; the near one is zero [rad].
    move_time, hold_time : float
        Durations [s].
    repeats : int
        How often it goes there and back.

    Returns
    -------
    Trajectory

    """
    far = np.asarray(amplitude, dtype=float)
    return via_points([np.zeros_like(far), *[far, np.zeros_like(far)] * int(repeats)],
                      move_time, hold_time)


def sinusoid(amplitude, period, *, phase=0.0, ramp_time=None):
    """
    Return ``amplitude sin(2 pi t / period + phase)``, its amplitude ramped in smoothly.

    Parameters
    ----------
    amplitude, period, phase : ndarray, shape (n_joints,) or float
        Of each joint [rad, s, rad].
    ramp_time : float, optional
        Duration of the ramp [s]; default half the longest period.

    Returns
    -------
    Trajectory
        Without end.

    """
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


def constant_velocity(velocity, travel, *, settle_time=0.5):
    """
    Return one stroke of constant velocity between two rests.

    Parameters
    ----------
    velocity : ndarray, shape (n_joints,)
        Signed velocity [rad/s]; joints with 0 stay.
    travel : float
        Angle covered at constant velocity by the fastest joint [rad].
    settle_time : float
        Duration of speeding up and of slowing down [s].

    Returns
    -------
    Trajectory
        Begins at angle zero.

    """
    velocity = np.asarray(velocity, dtype=float)
    _positive(travel=travel, settle_time=settle_time, velocity=np.max(np.abs(velocity)))
    cruise = travel / np.max(np.abs(velocity))
    state = at_rest(np.zeros_like(velocity))
    moving = state.copy()
    moving[0], moving[1] = 0.5 * velocity * settle_time, velocity
    leaving = moving.copy()
    leaving[0] += velocity * cruise
    end = at_rest(leaving[0] + 0.5 * velocity * settle_time)
    straight = constant(moving[0])
    straight[1] = velocity
    stop = settle_time + cruise
    return polynomials(
        [0.0, settle_time, stop, stop + settle_time], [settle_time, 1.0, settle_time, 1.0],
        [hermite(state, moving, settle_time), straight, hermite(leaving, end, settle_time),
         constant(end[0])], end=stop + settle_time)


def sliding(velocity, modulation, period, duration, *, settle_time=1.0):
    """
    Return sliding at varying velocity without reversal.

    Parameters
    ----------
    velocity : ndarray, shape (n_joints,)
        Mean velocity [rad/s].
    modulation : float
        Relative amplitude of the variation, 0 to below 1.
    period : float
        Of the variation [s].
    duration : float
        Of the sliding [s].
    settle_time : float
        Duration of speeding up and of slowing down [s].

    Returns
    -------
    Trajectory
        ``dq = velocity (1 + modulation sin(2 pi t / period))`` between two rests.

    """
    velocity = np.asarray(velocity, dtype=float)
    _positive(period=period, duration=duration, settle_time=settle_time)
    if not 0 <= modulation < 1:
        raise TrajectoryError(f'modulation must be at least 0 and below 1, got {modulation}: '
                              'the motion would reverse')
    omega = 2.0 * np.pi / period
    swing = -velocity * modulation / omega  # integral of the variation, cosine phase
    line = constant(np.zeros_like(velocity))
    line[1] = velocity
    body = Trajectory(start=[0.0], scale=[1.0], poly=[line], envelope=[constant([1.0])[:, 0]],
                      amplitude=[swing], omega=[np.full_like(velocity, omega)],
                      phase=[np.full_like(velocity, 0.5 * np.pi)])
    return _between_rests(body, duration, settle_time)


def _between_rests(body, duration, settle_time):
    """Return ``body`` from 0 to ``duration`` with smooth ways in from and out to rest."""
    first, last = body.sample(0.0), body.sample(duration)
    into = at_rest(first[0] - 0.5 * settle_time * first[1])
    out = at_rest(last[0] + 0.5 * settle_time * last[1])
    ways = polynomials(
        [0.0, settle_time + duration, 2 * settle_time + duration],
        [settle_time, settle_time, 1.0],
        [hermite(into, first, settle_time), hermite(last, out, settle_time), constant(out[0])])
    parts = [_take(ways, slice(0, 1)), body.shifted(settle_time), _take(ways, slice(1, 3))]
    return _joined(parts, end=2 * settle_time + duration)


def torque_ramp(amplitude, rate, repeats=1):
    """
    Return slow open-loop torque ramps between plus and minus an amplitude.

    Parameters
    ----------
    amplitude : ndarray, shape (n_joints,)
        Largest torque [N m].
    rate : float
        Slope of the joint with the largest amplitude [N m/s].
    repeats : int
        Number of cycles.

    Returns
    -------
    Trajectory
        Of quantity 'effort', from zero to zero.

    """
    amplitude = np.asarray(amplitude, dtype=float)
    _positive(rate=rate, amplitude=np.max(np.abs(amplitude)))
    quarter = np.max(np.abs(amplitude)) / rate
    levels = [0.0, *[1.0, -1.0] * int(repeats), 0.0]
    starts, polys, time = [], [], 0.0
    for begin, end in zip(levels[:-1], levels[1:], strict=True):
        line = constant(begin * amplitude)
        line[1] = np.sign(end - begin) * amplitude / quarter
        starts, polys = [*starts, time], [*polys, line]
        time += abs(end - begin) * quarter
    return polynomials([*starts, time], np.ones(len(starts) + 1),
                       [*polys, constant(0.0 * amplitude)], end=time, quantity='effort')


def _take(trajectory, segments):
    names = ('start', 'scale', 'poly', 'envelope', 'amplitude', 'omega', 'phase')
    return replace(trajectory, **{name: getattr(trajectory, name)[segments] for name in names})


def _joined(parts, *, end):
    names = ('start', 'scale', 'poly', 'envelope', 'amplitude', 'omega', 'phase')
    return replace(parts[0], end=end, **{
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def approach(state, trajectory, time, *, duration=2.0):
    """
    Return ``trajectory`` entered smoothly from a state at a given time.

    Parameters
    ----------
    state : ndarray, shape (5, n_joints)
        Reference and derivatives now; at rest where the robot is if there was none.
    trajectory : Trajectory
        What to do, its own time beginning at 0.
    time : float
        Now [s].
    duration : float
        Time for the way to its beginning; not taken where it already is there [s].

    Returns
    -------
    Trajectory
        Continuous in all derivatives to the fourth. An effort starts at once.

    """
    begin = trajectory.sample(0.0)
    there = np.allclose(state, begin, rtol=0.0, atol=_ALREADY_THERE)
    if trajectory.quantity == 'effort' or there:
        return trajectory.shifted(time)
    _positive(duration=duration)
    way = polynomials([time], [duration], [hermite(state, begin, duration)])
    moved = trajectory.shifted(time + duration)
    return _joined([way, moved], end=moved.end)
