# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Encoders on both sides of the joints, and the velocity made from their counts."""

from functools import cache, lru_cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.control.cascade import measured_layout
from gms_flex_control.effects import base as sig
from gms_flex_control.records import FLOAT
import numpy as np


@cache
def state_layout(n) -> np.dtype:
    """
    Return the dtype of encoders: ``output``, what they measure, and their memory.

    ``output`` is of `control.cascade.measured_layout`; ``started`` is 0 before the first sample;
    ``normal`` (n, 2), standard normal numbers for the noise of link and motor side.
    """
    return records.layout(('output', measured_layout(n)), ('started', FLOAT, (1,)),
                          ('normal', FLOAT, (n, 2)))


LAYOUT = records.layout(('resolution', FLOAT, (1,)), ('noise', FLOAT, (1,)),
                        ('velocity_cutoff', FLOAT, (1,)))


@lru_cache(maxsize=256)
def constants_of(encoder) -> np.record:
    """Return EncoderParams as the record the kernels take."""
    resolution = 2.0 * np.pi / float(encoder.counts) if encoder.counts > 0 else 0.0
    return records.build(LAYOUT, resolution=resolution, noise=encoder.noise,
                         velocity_cutoff=encoder.velocity_cutoff)


def init(n) -> np.record:
    """Return encoders of n joints before their first sample."""
    return records.build(state_layout(n))


@compiled
def draw(state, constants, rng) -> None:
    """Draw the numbers of one sample's noise, if there is any, from a random generator."""
    if constants.noise[0] > 0.0:
        for j in range(state.normal.shape[0]):
            state.normal[j, 0] = rng.standard_normal()
            state.normal[j, 1] = rng.standard_normal()


@compiled
def _count(angle, normal, constants):
    """Return what an encoder reads of ``angle``: noise first, then whole counts."""
    if constants.noise[0] > 0.0:
        angle += constants.noise[0] * normal
    if constants.resolution[0] > 0.0:
        angle = np.round(angle / constants.resolution[0]) * constants.resolution[0]
    return angle


@compiled_part
def _velocity(velocity, change, rate, started, period, gain):
    """Return the low-passed difference quotient, or the ``rate`` without a filter gain."""
    if gain == 0.0:
        return rate
    if not started:
        return 0.0
    return velocity + gain * (change / period - velocity)


@compiled
def measure(state, signals, period, constants) -> None:
    """Write a sample of all encoders, noise from `draw`, of ``signals`` into ``state.output``."""
    measured, normal, started = state.output, state.normal, state.started[0] > 0.0
    gain = 1.0 - np.exp(-2.0 * np.pi * constants.velocity_cutoff[0] * period)
    for j in range(measured.q_link.shape[0]):
        angle = _count(signals[j, sig.SENSED_LINK], normal[j, 0], constants)
        measured.dq_link[j] = _velocity(
            measured.dq_link[j], angle - measured.q_link[j], signals[j, sig.SENSED_LINK_RATE],
            started, period, gain)
        measured.q_link[j] = angle
        angle = _count(signals[j, sig.SENSED_MOTOR], normal[j, 1], constants)
        measured.dq_motor[j] = _velocity(
            measured.dq_motor[j], angle - measured.q_motor[j], signals[j, sig.SENSED_MOTOR_RATE],
            started, period, gain)
        measured.q_motor[j] = angle
    state.started[0] = 1.0
