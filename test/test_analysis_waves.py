# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Waves over an angle, found by how they were made."""

from gms_flex_control.data.signal_analysis import standing_out
import numpy as np
import pytest

pytestmark = pytest.mark.fast

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


def test_a_wave_of_several_recordings_is_found():
    rng, takes = np.random.default_rng(5), []
    for _ in range(3):
        angle, rate = motion(rng, 30.0)
        takes.append((angle, 0.2 * np.sin(300.0 * angle) + rng.standard_normal(len(angle)), rate))
    angles, torques, rates = zip(*takes, strict=True)
    assert standing_out(angles, torques, rates, 48.0)[0] == pytest.approx(300.0, abs=3.0)


@pytest.mark.parametrize('seed', range(20))
def test_noise_is_no_wave(seed):
    rng = np.random.default_rng(seed)
    angle, rate = motion(rng)
    assert standing_out([angle], [rng.standard_normal(len(angle))], [rate], 48.0) == ()


def test_a_joint_that_stands_has_none():
    still = np.zeros(1000)
    assert standing_out([still], [still], [still], 48.0) == ()
