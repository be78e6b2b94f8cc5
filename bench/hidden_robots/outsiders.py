# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Disturbances from outside the catalogue, drawn from a seed."""

from bench.hidden_robots.kernels import outside
from bench.hidden_robots.sizes import angle, between
from bench.hidden_robots.truth import Disturbance
import numpy as np
from scipy.signal import lfilter

NAMES = outside.NAMES[1:]


def draw_values(rng, name, k):
    """
    Return the numbers of a disturbance of 15 to 60 % of the joint's friction, torque first.

    ``k`` are the Figures of its joint; of a friction step the first is a ratio.
    """
    size = between(rng, 0.15, 0.6) * k.static
    place = float(rng.uniform(0.6 * k.lowest, 0.6 * k.highest))
    span = k.highest - k.lowest
    if name.startswith('periodic'):
        return size, 2.0 * np.pi * between(rng, 0.7, 6.0), angle(rng)
    if name == 'local_bump':
        return size * float(rng.choice([-1.0, 1.0])), place, span * rng.uniform(0.02, 0.08)
    if name == 'friction_step':
        return between(rng, 0.25, 0.7), k.duration * rng.uniform(0.35, 0.65)
    if name == 'sliding_cogging':
        return 0.5 * size, float(rng.integers(4, 25)), angle(rng), between(rng, 0.3, 2.0)
    if name == 'stick_at_angle':
        return 1.5 * size, place, span * rng.uniform(0.01, 0.04)
    if name == 'speed_band':
        return size, k.speed * rng.uniform(0.6, 1.2), k.speed * rng.uniform(0.1, 0.2)
    return (size,)


def draw_course(rng, name, samples, period):
    """Return the random course (samples,) of a disturbance, of about unit size; or zeros."""
    course = np.zeros(samples)
    if name.startswith('random'):
        forget = np.exp(-2.0 * np.pi * between(rng, 0.5, 5.0) * period)
        course = lfilter([1.0 - forget], [1.0, -forget], rng.standard_normal(samples))
        return course / course.std()
    if name == 'knocks':
        for start in rng.integers(0, samples, max(3, int(samples * period / 1.5))):
            width = max(int(rng.uniform(0.02, 0.08) / period), 1)
            course[start:start + width] = 2.0 * rng.choice([-1.0, 1.0])
    if name == 'two_state_bias':
        turns = np.sort(rng.integers(0, samples, max(2, int(samples * period / 6.0))))
        course[:] = np.where(np.searchsorted(turns, np.arange(samples)) % 2, 1.0, -0.3)
    return course


def draw_disturbance(rng, name, joint, k, samples, period):
    """Return a Disturbance called ``name`` on the joint of index ``joint`` with Figures ``k``."""
    values = tuple(float(value) for value in draw_values(rng, name, k))
    return Disturbance(name, joint, values, draw_course(rng, name, samples, period))
