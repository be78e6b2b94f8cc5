# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Signals taken apart by octave and moment: nothing lost, and everything in its place."""

from gms_flex_control.discrepancy.octaves import Octaves
import numpy as np
import pytest


@pytest.fixture(scope='module')
def octaves():
    return Octaves(320, 4)


def numbers_of(octaves, signals):
    return octaves(np.fft.fft(signals, axis=0))


def test_numbers_are_a_turned_view_of_the_samples(octaves):
    """The transform of the unit matrix is orthonormal: all is kept, nothing told twice."""
    matrix = numbers_of(octaves, np.eye(320))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(320), atol=1e-12)
    assert [len(part) for part in octaves.parts] == [160, 80, 40, 20, 20]


@pytest.mark.parametrize('part', range(5))
def test_a_tone_is_found_in_its_octave(octaves, part):
    """In the middle of a band, whose edges are those of halved sampling rates."""
    highest = 0.5 / 2 ** part
    frequency = round((0.75 if part < 4 else 0.5) * highest * 320) / 320
    tone = np.sin(2.0 * np.pi * frequency * np.arange(320) + 0.3)[:, None]
    numbers = numbers_of(octaves, tone)[:, 0]
    assert np.sum(numbers[octaves.parts[part]] ** 2) > 0.99 * np.sum(tone ** 2)


@pytest.mark.parametrize('moment', [100, 101, 163])
def test_a_knock_is_found_where_it_was(octaves, moment):
    """The mean time of its squares is that of the knock, to a number of each octave."""
    knock = np.zeros((320, 1))
    knock[moment] = 1.0
    squares = numbers_of(octaves, knock)[:, 0] ** 2
    for part, spacing in zip(octaves.parts, octaves.spacings, strict=True):
        mean = squares[part] @ octaves.time[part] / squares[part].sum()
        assert abs(mean - moment) <= spacing


def test_the_spread_of_coloured_noise_is_foreseen(octaves):
    """Many runs of noise behind a difference, whose power is 4 sin(w / 2)^2."""
    power = 4.0 * np.sin(np.pi * np.arange(320) / 320)[:, None] ** 2
    white = np.random.default_rng(3).standard_normal((320, 2000))
    numbers = numbers_of(octaves, white - np.roll(white, 1, axis=0))
    for part, foreseen in zip(octaves.parts, octaves.spread(power), strict=True):
        assert np.mean(numbers[part] ** 2) == pytest.approx(foreseen[0], rel=0.05)
