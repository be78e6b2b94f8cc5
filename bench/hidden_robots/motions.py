# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Motions drawn from a seed: a rich one, and the two of the paper."""

from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import COEFFICIENTS, Trajectory
import numpy as np

MOTIONS = ('rich', 'sinusoid', 'polynomial', 'slow')
_ACCELERATION = {'soft': 1.5, 'stiff': 2.5}  # of the sum of tones, largest [rad/s^2]


def draw_reference(rng, motion, plant, time):
    """
    Return a reference (T, 5, 2) for two joints, at rest at the start, at ``time`` (T,) [s].

    'rich' is tones, moves of many speeds and slow reversals one after the other, 'sinusoid' and
    'polynomial' are the paper's, 'slow' is slow moves and creeping reversals with rests between
    them. A 'soft' plant is moved more gently than a 'stiff' one.
    """
    if motion == 'sinusoid':
        return builders.sinusoid(rng.uniform(0.7, 1.2, 2), rng.uniform(4.5, 7.0, 2)).sample(time)
    if motion == 'polynomial':
        repeats = int(np.ceil(time[-1] / 8.0))
        return builders.polynomial(rng.uniform(0.7, 1.3, 2), rng.uniform(3.5, 5.0),
                                   rng.uniform(1.0, 3.0), repeats).sample(time)
    if motion == 'slow':
        return slow(rng, time[-1]).sample(time)
    third = time[-1] / 3.0
    parts = [*tones(rng, 0.5, third, (0.1, 0.7), 0.9, _ACCELERATION[plant], 4),
             *tones(rng, 2.3 * third, 0.7 * third, (0.08, 0.3), 0.12, 0.4, 3),
             moves(rng, third + 0.5, 1.3 * third - 1.0, 1.5 * _ACCELERATION[plant])]
    return sum(part.sample(time) for part in parts)


# largest acceleration of a move of degree 9, times distance / duration^2, and largest speed
_STEEPEST, _FASTEST = 9.4, 2.46
# slow: speed of a stroke that creeps, and of one that travels [rad/s]; its time, and that of rests
_CREEPING, _TRAVELLING, _STROKE, _REST = (0.005, 0.1), (0.05, 0.6), (2.0, 5.0), (1.0, 3.0)


def tones(rng, start, duration, band, reach, acceleration, count):
    """
    Return ``count`` sinusoids (Trajectory) for each joint that fade in and out together.

    From ``start`` for ``duration`` [s], of frequencies within ``band`` [Hz]; ``reach`` [rad] and
    ``acceleration`` [rad/s^2] bound the sums of their amplitudes and accelerations.
    """
    fade = min(2.0, 0.25 * duration)
    reach = min(reach, acceleration * fade ** 2 / _STEEPEST)
    up = builders.hermite(builders.at_rest([0.0]), builders.at_rest([1.0]), fade)[:, 0]
    down = builders.hermite(builders.at_rest([1.0]), builders.at_rest([0.0]), fade)[:, 0]
    envelope = [builders.constant([0.0])[:, 0], up, builders.constant([1.0])[:, 0], down,
                builders.constant([0.0])[:, 0]]
    begin = np.array([0.0, start, start + fade, start + duration - fade, start + duration])
    omega = 2.0 * np.pi * np.exp(rng.uniform(*np.log(band), (count, 2)))
    share = rng.dirichlet(np.full(count, 2.0), 2).T
    amplitude = share * np.minimum(reach, acceleration / np.sum(share * omega ** 2, axis=0))
    phase = rng.uniform(0.0, 2.0 * np.pi, (count, 2))
    return [Trajectory(start=begin, scale=[1.0, fade, 1.0, fade, 1.0],
                       poly=np.zeros((5, COEFFICIENTS, 2)), envelope=envelope,
                       amplitude=[a] * 5, omega=[w] * 5,
                       phase=[p + w * (at - start) for at in begin])
            for a, w, p in zip(amplitude, omega, phase, strict=True)]


def moves(rng, start, duration, acceleration):
    """Return moves at rest-to-rest through random points, fast and slow, that end at zero."""
    polys, begin, scale = [builders.constant([0.0, 0.0])], [0.0], [1.0]
    here, time, end = np.zeros(2), start, start + duration
    while time < end - 1.5:
        there = rng.uniform(-1.1, 1.1, 2)
        quick = np.sqrt(_STEEPEST * np.max(np.abs(there - here)) / acceleration)
        taken = quick * np.exp(rng.uniform(0.0, 1.2))
        if time + taken > end - 3.0:
            there = np.zeros(2)
            taken = max(end - time, np.sqrt(_STEEPEST * np.max(np.abs(here)) / acceleration))
        polys += [builders.hermite(builders.at_rest(here), builders.at_rest(there), taken),
                  builders.constant(there)]
        begin += [time, time + taken]
        scale += [taken, 1.0]
        here, time = there, time + taken + rng.uniform(0.0, 0.8)
    return builders.polynomials(begin, scale, polys)


def slow(rng, duration):
    """Return creeping reversals and slow moves in turn, each joint at a speed of its own."""
    polys, begin, scale = [builders.constant([0.0, 0.0])], [0.0], [1.0]
    here, time, creeping = np.zeros(2), 0.5, True
    while time < duration:
        taken = rng.uniform(*_STROKE)
        speed = np.exp(rng.uniform(*np.log(_CREEPING if creeping else _TRAVELLING), 2))
        stroke = speed * taken / _FASTEST * rng.choice([-1.0, 1.0], 2)
        stroke = np.where(np.abs(here + stroke) > 1.1, -stroke, stroke)
        for way in (1.0, -1.0, 1.0) if creeping else (1.0,):
            there = here + way * stroke
            polys.append(builders.hermite(builders.at_rest(here), builders.at_rest(there), taken))
            begin.append(time)
            scale.append(taken)
            here, time = there, time + taken
        polys.append(builders.constant(here))
        begin.append(time)
        scale.append(1.0)
        time += rng.uniform(*_REST)
        creeping = not creeping
    return builders.polynomials(begin, scale, polys)
