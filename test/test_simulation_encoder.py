# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Encoders: counts, noise, and the low-passed velocity."""

from gms_flex_control.effects import base as sig
from gms_flex_control.params.robot import EncoderParams
from gms_flex_control.simulation import encoder
import numpy as np
import pytest

pytestmark = pytest.mark.fast

PERIOD = 2e-3


def measure(angles, params, seed=0, rates=None):
    """Return what two encoders read along ``angles`` (T, 2): (T, 4, 2) as Run.measured."""
    state, constants = encoder.init(2), encoder.constants_of(params)
    rng, signals = np.random.default_rng(seed), np.zeros((2, sig.WIDTH))
    rates = np.zeros_like(angles) if rates is None else rates
    out = []
    for angle, rate in zip(angles, rates, strict=True):
        encoder.draw(state, constants, rng)
        signals[:, [sig.SENSED_LINK, sig.SENSED_LINK_RATE]] = np.stack([angle, rate], axis=1)
        signals[:, [sig.SENSED_MOTOR, sig.SENSED_MOTOR_RATE]] = np.stack(
            [2 * angle, 3 * rate], axis=1)
        encoder.measure(state, signals, PERIOD, constants)
        seen = state.output
        out.append(np.stack([seen.q_link, seen.dq_link, seen.q_motor, seen.dq_motor]))
    return np.array(out)


def test_angles_come_in_whole_counts():
    """20 000 counts a revolution: steps of 0.314 mrad, the nearest one, on both sides."""
    angles = np.random.default_rng(0).uniform(-4.0, 4.0, (200, 2))
    read = measure(angles, EncoderParams(counts=20000))
    counts = read[:, [0, 2]] / (2 * np.pi / 20000)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-8)
    half = np.pi / 20000 * (1 + 1e-9)
    assert np.abs(read[:, 0] - angles).max() <= half
    assert np.abs(read[:, 2] - 2 * angles).max() <= half


def test_an_ideal_encoder_reads_angles_and_rates_as_they_are():
    rng = np.random.default_rng(1)
    angles, rates = rng.standard_normal((20, 2)), rng.standard_normal((20, 2))
    read = measure(angles, EncoderParams(), rates=rates)
    np.testing.assert_array_equal(read, np.stack([angles, rates, 2 * angles, 3 * rates], axis=1))


@pytest.mark.parametrize('cutoff', [10.0, 50.0, 200.0])
def test_the_velocity_of_a_ramp_rises_as_a_first_order_low_pass(cutoff):
    """After k samples of velocity v the estimate is v (1 - exp(-2 pi f k T))."""
    k = np.arange(200)
    angles = np.stack([0.5 * k * PERIOD, -0.3 * k * PERIOD], axis=1)
    read = measure(angles, EncoderParams(velocity_cutoff=cutoff))
    rise = 1.0 - np.exp(-2 * np.pi * cutoff * k * PERIOD)
    np.testing.assert_allclose(read[:, 1], rise[:, None] * [0.5, -0.3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(read[:, 3], rise[:, None] * [1.0, -0.6], rtol=0, atol=1e-12)


def test_the_first_sample_has_no_velocity():
    """Wherever the encoder wakes up, it has not come there from zero."""
    read = measure(np.full((3, 2), 2.5), EncoderParams(velocity_cutoff=50.0))
    np.testing.assert_array_equal(read[:, 1], np.zeros((3, 2)))


def test_noise_has_the_stated_deviation_and_repeats_with_its_seed():
    angles, params = np.zeros((20000, 2)), EncoderParams(noise=1e-3)
    read = measure(angles, params, 7)
    again, other = (measure(angles[:200], params, seed) for seed in (7, 8))
    np.testing.assert_array_equal(read[:200], again)
    assert np.any(again != other)
    channels = np.concatenate([read[:, 0], read[:, 2]], axis=1)
    np.testing.assert_allclose(channels.std(axis=0), 1e-3, rtol=0.03)
    np.testing.assert_allclose(channels.mean(axis=0), 0.0, atol=3e-5)
    np.testing.assert_allclose(np.corrcoef(channels.T), np.eye(4), atol=0.03)


def test_noise_is_counted_too():
    """Noise of half a count leaves zero as often as a normal number lies within one sigma."""
    size = 2 * np.pi / 1000
    read = measure(np.zeros((2000, 2)), EncoderParams(counts=1000, noise=0.5 * size))[:, 0] / size
    np.testing.assert_allclose(read, np.round(read), atol=1e-12)
    assert np.mean(np.round(read) == 0) == pytest.approx(0.6827, abs=0.03)
