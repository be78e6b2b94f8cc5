# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The measure of residuals: how far beyond what shows where nothing is missing.

Residuals of all equations are seen together, frequency by frequency, through the inverse root of
the spectral matrix they have in runs in which nothing is missing, and then moment by moment at
the scale they have there: at a reversal, where an encoder count hides the load of the blocks,
they count little. The rows that come out are all alike, about normal, and few.
"""

import numpy as np
from scipy.ndimage import minimum_filter1d, uniform_filter1d

HIGHEST = 20.0        # frequency that is looked at [Hz]
TORQUE_BAND = 8.0     # up to which torques are told [Hz]
_EDGE = 0.5           # at both ends, where filters are not settled [s]
_BINS = 1.0           # Hz, over which a spectrum is taken as even
_MOMENT = 0.15        # s, over which the scale in time is taken as even
_RAMP = 0.1           # s, from where an equation tells nothing to where it does


class Whitening:
    """
    Turns residual torques into rows of unit variance.

    Parameters
    ----------
    clean : ndarray, shape (R, T, C)
        Residuals of C equations in R runs in which nothing is missing [N m].
    period : float
        Sample [s].
    floor : ndarray, shape (C,)
        Torque below which nothing matters, as white noise up to ``HIGHEST`` [N m].
    seen : ndarray, shape (T, C)
        Where an equation tells something, bool.

    """

    def __init__(self, clean, period, floor, seen):
        self._samples = clean.shape[1]
        length = self._samples * period
        self._bins = min(int(HIGHEST * length), self._samples // 2)
        self._rows = 2 * self._bins
        self.row_period = length / self._rows
        ramp = max(round(_RAMP / period), 1)
        self._window = _taper(self._samples, round(_EDGE / period))[:, None] * uniform_filter1d(
            minimum_filter1d(seen.astype(float), ramp, axis=0), ramp, axis=0)
        spectra = self._spectra(clean)
        width = max(round(_BINS * length), 1)
        power = np.einsum('rfc,rfd->fcd', spectra, spectra.conj()) / len(clean)
        power = uniform_filter1d(power.real, width, axis=0, mode='nearest') + 1j * \
            uniform_filter1d(power.imag, width, axis=0, mode='nearest')
        white = floor ** 2 * self._samples ** 2 / (2.0 * self._bins)
        power = power + np.diag(np.maximum(white, 1e-30))
        self._roots = np.linalg.inv(np.linalg.cholesky(power))
        self.time = self.row_period * np.arange(self._rows)
        self.scale = self._scale_of(clean, seen[np.minimum(
            (self.time / period).astype(int), self._samples - 1)])

    def _scale_of(self, clean, seen):
        """Return what makes rows even in time (S, C), zero where they tell nothing."""
        self.scale = np.ones(seen.shape)
        rows = np.stack([self.rows_of(one) for one in clean])
        width = max(round(_MOMENT / self.row_period), 1)
        square = uniform_filter1d(np.mean(rows ** 2, axis=0), width, axis=0, mode='nearest')
        usual = np.array([np.median(column[there]) if there.any() else 0.0
                          for column, there in zip(square.T, seen.T, strict=True)])
        used = usual > 1e-12  # a rigid joint has no motor equation
        scale = used * seen / np.sqrt(np.maximum(square, np.where(used, 0.25 * usual, 1.0)))
        edge = round(_EDGE / self.row_period)
        scale[:edge] = scale[-edge:] = 0.0
        return scale

    def _spectra(self, residuals):
        return np.fft.rfft(residuals * self._window, axis=-2)[..., :self._bins, :]

    def rows_of(self, residual):
        """Return rows (S, C) of unit variance of residuals (T, C) [N m]."""
        white = np.einsum('fcd,fd->fc', self._roots, self._spectra(residual))
        white[0] = white[0].real
        padded = np.zeros((self._bins + 1, white.shape[1]), dtype=complex)
        padded[:-1] = white
        rows = np.fft.irfft(padded, self._rows, axis=0) * np.sqrt(self._rows)
        return rows * self.scale

    def torque_rows(self, residual):
        """Return residuals (T, C) behind a low-pass alone, at the times of the rows [N m]."""
        padded = np.zeros((self._bins + 1, residual.shape[1]), dtype=complex)
        padded[:-1] = self._spectra(residual)
        padded[round(TORQUE_BAND / HIGHEST * self._bins):] = 0.0
        return np.fft.irfft(padded, self._rows, axis=0) * self._rows / self._samples


def _taper(samples, edge):
    window = np.ones(samples)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(edge) + 0.5) / edge)
    window[:edge], window[-edge:] = ramp, ramp[::-1]
    return window
