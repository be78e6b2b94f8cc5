# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Signals as waves of each octave and moment: the discrete Meyer wavelets.

As many numbers as samples, orthonormal: sums of squares stay. Every octave is told as often as it
needs to be, so that what is slow is placed in time only coarsely and what is quick finely.
"""

import numpy as np


class Octaves:
    """
    Takes signals of one length apart.

    Parameters
    ----------
    samples : int
        Of a signal; a multiple of ``2 ** levels``.
    levels : int
        How many octaves below half of the sampling rate; one number beside them for the rest.

    """

    def __init__(self, samples, levels):
        self._filters, times, spacings = [], [], []
        for level in range(levels):
            angle = 2.0 * np.pi * np.arange(samples >> level) / (samples >> level)
            low, high = _low(angle), np.exp(1j * angle) * _low(angle + np.pi)
            self._filters.append((low, high))
            spacing = 2 << level
            times.append(spacing * (np.arange(samples // spacing) + 0.5))
            spacings.append(spacing)
        times.append(spacing * np.arange(samples // spacing))
        spacings.append(spacing)
        self.parts = np.split(np.arange(samples), np.cumsum([len(part) for part in times])[:-1])
        self.time = np.concatenate(times)  # of each number, in samples
        self.spacings = spacings           # of the numbers of each part, in samples

    def __call__(self, spectrum):
        """
        Return the numbers of each part, one after the other.

        Parameters
        ----------
        spectrum : ndarray, shape (samples, C)
            numpy.fft.fft of C real signals.

        Returns
        -------
        ndarray, shape (samples, C)
            The highest octave first; see `parts`.

        """
        out = []
        for low, high in self._filters:
            out.append(_halved(spectrum * high[:, None]))
            spectrum = _halved(spectrum * low[:, None])
        return np.concatenate([np.fft.ifft(part, axis=0).real for part in (*out, spectrum)])

    def spread(self, power):
        """
        Return the variance of the numbers of each part of noise.

        Parameters
        ----------
        power : ndarray, shape (samples, C)
            Of each frequency of numpy.fft, 1 where it is that of white noise of variance 1.

        Returns
        -------
        list of ndarray, shape (C,)

        """
        out = []
        for low, high in self._filters:
            out.append(np.mean(power * np.abs(high[:, None]) ** 2, axis=0))
            power = _halved(power * np.abs(low[:, None]) ** 2)
        return [*out, np.mean(power, axis=0)]


def _halved(spectrum):
    """Return the spectrum (samples / 2, C) of every other sample."""
    half = len(spectrum) // 2
    return 0.5 * (spectrum[:half] + spectrum[half:])


def _low(angle):
    """Return the low-pass of the Meyer wavelet at angular frequencies per sample."""
    away = np.abs((angle + np.pi) % (2.0 * np.pi) - np.pi)
    x = np.clip(3.0 * away / np.pi - 1.0, 0.0, 1.0)
    smooth = x ** 4 * (35.0 - 84.0 * x + 70.0 * x ** 2 - 20.0 * x ** 3)
    return np.sqrt(2.0) * np.cos(0.5 * np.pi * smooth)
