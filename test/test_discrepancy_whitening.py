# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The measure of residuals: octaves that lose nothing, rows that are white and of one size."""

from gms_flex_control.discrepancy.whitening import Octaves, Whitening
import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d


@pytest.fixture(scope='module')
def octaves():
    return Octaves(320, 4)


def test_numbers_are_a_turned_view_of_the_samples(octaves):
    """The transform of the unit matrix is orthonormal: all is kept, nothing reported twice."""
    matrix = octaves(np.fft.fft(np.eye(320), axis=0))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(320), atol=1e-12)
    assert [len(part) for part in octaves.parts] == [160, 80, 40, 20, 20]


def test_rows_of_even_noise_are_white_and_of_unit_variance():
    """Coloured noise that two equations share: rows of a run that was not measured are plain."""
    rng, period = np.random.default_rng(0), 4e-3
    white = rng.standard_normal((7, 10000, 2)) @ [[1.0, 0.8], [0.0, 0.5]]
    noise = white - 0.9 * np.roll(white, 1, axis=1)
    noise[..., 1] = uniform_filter1d(noise[..., 1], 5, axis=1)
    whitening = Whitening(noise[:6], period, np.zeros(2), np.ones(noise.shape[1], dtype=bool))
    rows = whitening.whiten(noise[6])
    rows = rows[np.any(rows, axis=1)]
    assert np.all(np.abs(rows.var(axis=0) - 1.0) < 0.15)
    allowed = 4.0 / np.sqrt(len(rows)) + 0.03
    for lag in (1, 2, 3, 10):
        assert np.all(np.abs(np.mean(rows[lag:] * rows[:-lag], axis=0)) < allowed)
    assert abs(np.mean(rows[:, 0] * rows[:, 1])) < allowed
    assert np.mean(np.abs(rows) > 1.96) == pytest.approx(0.05, abs=0.02)


def test_rows_of_torques_in_one_equation_are_those_of_residuals_without_any_other():
    """Two equations share their noise, a third is always zero: it stays so."""
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((6, 4000, 2)) @ [[1.0, 0.0, 0.8], [0.0, 0.0, 0.5]]
    whitening = Whitening(noise, 4e-3, np.full(3, 0.1), np.ones(4000, dtype=bool))
    torques = rng.standard_normal((4000, 5))
    for channel in range(3):
        residuals = np.zeros((5, 4000, 3))
        residuals[:, :, channel] = torques.T
        rows = whitening.whiten_each(torques, channel)
        assert np.any(rows) == (channel != 1) and not np.any(rows[:, 1])
        np.testing.assert_allclose(rows, np.stack([
            whitening.whiten(one) for one in residuals], axis=-1), rtol=0, atol=1e-12)


def test_where_an_equation_says_nothing_its_residual_counts_nothing():
    """A torque of a thousand times the noise while a link stands changes no row elsewhere."""
    noise = np.random.default_rng(2).standard_normal((7, 10000, 1))
    known = np.ones(10000, dtype=bool)
    known[4000:6000] = False
    whitening = Whitening(noise[:6], 4e-3, np.zeros(1), known)
    stuck = noise[6].copy()
    stuck[4000:6000] += 1000.0
    rows = whitening.whiten(stuck)
    np.testing.assert_allclose(rows, whitening.whiten(noise[6]), rtol=1e-9, atol=1e-9)
    inside = (whitening.row_time > 16.01) & (whitening.row_time < 23.99)
    reported = rows[~inside & np.any(rows, axis=1)]
    assert not np.any(rows[inside]) and reported.var() == pytest.approx(1.0, abs=0.2)


def test_slow_noise_of_rests_does_not_hide_what_is_slow_in_motion():
    """Torque as large as white noise, which at rest wanders slowly by twenty times as much."""
    rng, period = np.random.default_rng(5), 4e-3
    noise = rng.standard_normal((7, 15000, 1))
    slow = uniform_filter1d(rng.standard_normal(noise.shape), 250, axis=1)
    resting = (np.arange(15000) % 3000 < 900)[:, None]
    noise += 20.0 * slow / slow.std() * uniform_filter1d(resting.astype(float), 100, axis=0)
    whitening = Whitening(noise[:6], period, np.zeros(1), np.ones(noise.shape[1], dtype=bool))
    torque = np.sign(np.sin(2.0 * np.pi * 0.2 * period * np.arange(15000)))[:, None]
    assert np.sum(whitening.whiten(torque) ** 2) > 0.1 * np.sum(torque[~resting] ** 2)
    rows = whitening.whiten(noise[6])
    assert rows[np.any(rows, axis=1)].var() == pytest.approx(1.0, abs=0.25)


def test_a_floor_makes_all_below_it_small():
    """Noise a tenth of the floor counts a hundredth; noise far above is hardly changed."""
    noise = np.random.default_rng(1).standard_normal((7, 10000, 1))
    share = 20.0 / 125.0  # of the power of white noise that lies below 20 Hz
    for floor, level in ((10.0, 0.01), (0.1, 1.0)):
        whitening = Whitening(noise[:6], 4e-3, np.array([floor * np.sqrt(share)]),
                              np.ones(noise.shape[1], dtype=bool))
        whitening.scale[:] = 1.0
        assert whitening.whiten(noise[6]).var() == pytest.approx(level, rel=0.1)
