# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Filters that recordings are looked at through, and waves over an angle."""

from gms_flex_control.data import signal_analysis
from gms_flex_control.data.signal_analysis import derivatives, low_pass, standing_out
import numpy as np
import pytest
from scipy.signal import savgol_filter


@pytest.mark.parametrize('window', range(2, 16))
def test_a_low_pass_has_no_phase(window):
    """What it makes of a pulse is symmetric about it, and a line stays where it is."""
    pulse = np.zeros(101)
    pulse[50] = 1.0
    seen = low_pass(pulse, window)
    np.testing.assert_allclose(seen, seen[::-1], atol=1e-15)
    assert seen.sum() == pytest.approx(1.0)
    line = np.linspace(-1.0, 3.0, 101)
    np.testing.assert_allclose(low_pass(line, window)[30:-30], line[30:-30], atol=1e-13)


def test_a_low_pass_has_lost_three_decibels_at_its_bandwidth():
    time = np.arange(4000) * 1e-3
    wave = np.sin(2.0 * np.pi * signal_analysis.low_pass_bandwidth(20, 1e-3) * time)
    ratio = np.std(low_pass(wave, 20)[500:-500]) / np.std(wave[500:-500])
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.02)


@pytest.mark.parametrize(('samples', 'window'), [(500, 17), (500, 1), (12, 17), (2, 5)])
def test_derivatives_are_those_of_scipy_up_to_both_ends(samples, window):
    period = 2e-3
    walk = np.random.default_rng(samples + window).standard_normal((samples, 2)).cumsum(axis=0)
    length = min(window, 2 * ((samples - 1) // 2) + 1)
    for order, found in enumerate(derivatives(walk, period, window)):
        expected = savgol_filter(walk, length, min(3, length - 1), order, period, axis=0)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    assert np.array_equal(*derivatives(walk, period, window, (2,)), found)


PERIOD = 4e-3


def motion(rng, seconds=80.0):
    """Return angle and rate (S,) of a motion to and fro."""
    time = np.arange(0.0, seconds, PERIOD)
    angle = 0.3 * np.sin(2 * np.pi * 0.05 * time) + 0.1 * np.sin(
        2 * np.pi * 0.17 * time + rng.uniform(0.0, 2 * np.pi))
    return angle, np.gradient(angle, PERIOD)


@pytest.mark.parametrize('order', [60.0, 200.0, 628.3])
def test_waves_below_the_noise_are_found(order):
    rng = np.random.default_rng(round(order))
    angle, rate = motion(rng)
    torque = 0.2 * np.sin(order * angle + 1.0) + rng.standard_normal(len(angle))
    torque += np.sign(rate) * 3.0  # what friction leaves
    found = standing_out([angle], [torque], [rate], 48.0)
    assert found[0] == pytest.approx(order, abs=0.25 * 2.0 * np.pi / np.ptp(angle))


@pytest.mark.parametrize('seed', range(8))
def test_noise_is_no_wave(seed):
    rng = np.random.default_rng(seed)
    angle, rate = motion(rng)
    assert standing_out([angle], [rng.standard_normal(len(angle))], [rate], 48.0) == ()
