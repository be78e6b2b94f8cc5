# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The measure of residuals: how far beyond what shows where nothing is missing.

Residuals of all equations are seen together, frequency by frequency, through the inverse root of
the spectral matrix they have in null simulations, and then octave by octave and moment by moment
at the scale they have there. While a link stands, friction that slowly changes is hidden by
encoder counts, and in motion it is not. The numbers that come out are all alike, about normal,
and few.
"""

from gms_flex_control.data.signal_analysis import BLOCK_TIME, SETTLED
import numpy as np
from scipy import fft
from scipy.ndimage import minimum_filter1d, uniform_filter1d

HIGHEST = 20.0        # frequency that is looked at [Hz]
TORQUE_BAND = 8.0     # up to which torques are reported [Hz]
_BINS = 1.0           # Hz, over which a spectrum is taken as even
_OCTAVES = 4          # below HIGHEST; the rest is slow
_MOMENT = 0.3         # s, over which the scale in time is taken as even
_FEWEST = 3           # rows of an octave, likewise
_RAMP = 0.1           # s, from where an equation says nothing to where it does
_FEWEST_SEEN = 40     # residuals of a group that show a noise level


class Band:
    """
    The spectra of residual torques up to `HIGHEST`, ends and what was not read faded out.

    Of ``samples`` residuals every ``period`` [s]; ``known`` (T,) where all angles were read, bool.
    """

    def __init__(self, samples, period, known):
        length, step = samples * period, 1 << _OCTAVES
        self.rows = max(2 * min(int(HIGHEST * length), samples // 2) // step, 1) * step
        self.bins = self.rows // 2
        ramp = max(round(_RAMP / period), 1)
        self._window = (_taper(samples, round(SETTLED / period)) * uniform_filter1d(
            minimum_filter1d(known.astype(float), ramp), ramp))[:, None]

    def spectra(self, residuals) -> np.ndarray:
        """Return the spectra of residuals (..., T, C) [N m], shape (..., F, C)."""
        return fft.rfft(residuals * self._window, axis=-2)[..., :self.bins, :].copy()


class Whitening:
    """
    Turns residual torques of C equations into numbers of unit variance, the whitened residuals.

    ``clean`` (R, T, C) are residuals of R null simulations every ``period`` [s] [N m], ``floor``
    (C,) is the torque below which nothing matters, as white noise up to ``HIGHEST`` [N m];
    ``known`` (T,) where all angles were read, bool.
    """

    def __init__(self, clean, period, floor, known):
        self._samples = clean.shape[1]
        length, self._band = self._samples * period, Band(self._samples, period, known)
        self._rows, self._bins = self._band.rows, self._band.bins
        self.row_period = length / self._rows
        self._octaves = Octaves(self._rows, _OCTAVES)
        self._live = np.flatnonzero(np.any(clean, axis=(0, 1)))  # equations that say something
        spectra, floor = self._band.spectra(clean[..., self._live]), floor[self._live]
        width = max(round(_BINS * length), 1)
        power = np.einsum('rfc,rfd->fcd', spectra, spectra.conj()) / len(clean)
        power = uniform_filter1d(power.real, width, axis=0, mode='nearest') + 1j * \
            uniform_filter1d(power.imag, width, axis=0, mode='nearest')
        white = np.maximum(floor ** 2 * self._samples ** 2 / (2.0 * self._bins), 1e-30)
        self._roots = np.linalg.inv(np.linalg.cholesky(power + np.diag(white)))
        self.time = self.row_period * np.arange(self._rows)
        self.settled = self._away_from_ends(self.time)
        self.row_time = self.row_period * self._octaves.time
        self.part = np.repeat(np.arange(len(self._octaves.parts)),
                              [len(part) for part in self._octaves.parts])  # of each row
        used = self._away_from_ends(self.row_time) & known[
            np.minimum((self.row_time / period).astype(int), self._samples - 1)]
        self.scale = np.zeros((self._rows, clean.shape[2]))
        self.scale[:, self._live] = used[:, None] * self._evening(spectra, white)

    def _evening(self, spectra, white):
        """Return what makes residuals even in time (S, L)."""
        square = np.mean([self._white(one) ** 2 for one in spectra], axis=0)
        of_floor = self._octaves.spread(self._both_sides(
            np.sum(np.abs(self._roots) ** 2 * white, axis=2)))
        for part, spacing, least in zip(self._octaves.parts, self._octaves.spacings, of_floor,
                                        strict=True):
            width = max(round(_MOMENT / self.row_period / spacing), _FEWEST)
            square[part] = least + uniform_filter1d(square[part], width, axis=0, mode='nearest')
        return 1.0 / np.sqrt(square)

    def _away_from_ends(self, time):
        return (time >= SETTLED) & (time <= self.time[-1] - SETTLED)

    def _both_sides(self, spectrum):
        """Return a spectrum (F, C) with its negative frequencies (S, C)."""
        out = np.zeros((self._rows, spectrum.shape[1]), dtype=spectrum.dtype)
        out[:self._bins], out[self._bins + 1:] = spectrum, spectrum[:0:-1].conj()
        out[0] = spectrum[0].real
        return out

    def whiten(self, residual) -> np.ndarray:
        """Return residuals (T, C) [N m] as (S, C) of unit variance, at `row_time`."""
        used = np.flatnonzero(np.any(residual[:, self._live], axis=0))
        return self._even(self._band.spectra(residual[:, self._live[used]]), used)

    def whiten_spectra(self, spectra) -> np.ndarray:
        """Return the same of residuals by their spectra (F, C), of a `Band`."""
        return self._even(spectra[:, self._live], slice(None))

    def _even(self, spectra, used):
        """Return the same, of spectra of those equations alone that are not nothing."""
        out = np.zeros(self.scale.shape)
        if spectra.size:
            out[:, self._live] = self._white(spectra, used)
            out *= self.scale
        return out

    def _white(self, spectra, used=slice(None)):
        """Return what is not yet even in time (S, L), of spectra (F, U) of equations ``used``."""
        return self._in_time(np.einsum('fcd,fd->fc', self._roots[:, :, used], spectra))

    def _in_time(self, white):
        return self._octaves(self._both_sides(white)) * np.sqrt(self._rows)

    def whiten_each(self, torques, channel) -> np.ndarray:
        """Return several torques (T, K) in one equation alone, whitened (S, C, K)."""
        out = np.zeros((*self.scale.shape, torques.shape[1]))
        for at in np.flatnonzero(self._live == channel):
            white = self._roots[:, :, at, None] * self._band.spectra(torques)[:, None]
            even = self._in_time(white.reshape(len(white), -1))
            out[:, self._live] = even.reshape(len(even), len(self._live), -1)
        out *= self.scale[:, :, None]
        return out

    def low_passed(self, residual) -> np.ndarray:
        """Return residuals (T, C) behind a low-pass alone, at `row_time` [N m]."""
        padded = np.zeros((self._bins + 1, residual.shape[1]), dtype=complex)
        padded[:-1] = self._band.spectra(residual)
        padded[round(TORQUE_BAND / HIGHEST * self._bins):] = 0.0
        return fft.irfft(padded, self._rows, axis=0) * self._rows / self._samples


def _taper(samples, edge):
    window = np.ones(samples)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(edge) + 0.5) / edge)
    window[:edge], window[-edge:] = ramp, ramp[::-1]
    return window


class Octaves:
    """
    Meyer wavelets: signals of one length, split into ``levels`` octaves and the rest.

    ``samples``, a multiple of ``2 ** levels``, become as many numbers.
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
        Return the numbers (samples, C) of each part, one after the other, see `parts`.

        ``spectrum`` (samples, C) is the numpy.fft.fft of C real signals.
        """
        out = []
        for low, high in self._filters:
            out.append(_halved(spectrum * high[:, None]))
            spectrum = _halved(spectrum * low[:, None])
        return np.concatenate([fft.ifft(part, axis=0).real for part in (*out, spectrum)])

    def spread(self, power) -> np.ndarray:
        """
        Return the variance (C,) of the numbers of each part of noise.

        ``power`` (samples, C) of each frequency of numpy.fft is 1 for white noise of variance 1.
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


# --- groups of whitened residuals ---------------------------------------------------------------


class Groups:
    """
    What each of R whitened residuals is.

    A group is one recording (Motion, and its Whitening), one equation, one octave, links at rest
    or in motion.
    """

    def __init__(self, motions, whitenings):
        used, groups, blocks, channels, parts = [], [], [], [], []
        self.block_at, self.at_rest = [], []  # (S,), (S, n) at the times of each whitening
        self.blocks, first_group = 0, 0
        for motion, whitening in zip(motions, whitenings, strict=True):
            shape, end = whitening.scale.shape, whitening.time[-1]
            channel = np.broadcast_to(np.arange(shape[1]), shape)
            still, at_rest = (motion.standing[np.minimum(
                (time / motion.period).astype(int), len(motion.standing) - 1)]
                for time in (whitening.row_time, whitening.time))
            group = (whitening.part[:, None] * shape[1] + channel) * 2 + np.tile(still, 2)
            count = max(round(end / BLOCK_TIME), 2)
            block, block_at = (self.blocks + np.minimum(
                (time * count / end).astype(int), count - 1)
                for time in (whitening.row_time, whitening.time))
            groups.append((first_group + group).ravel())
            blocks.append(np.repeat(block, shape[1]))
            channels.append(channel.ravel())
            parts.append(np.repeat(whitening.part, shape[1]))
            used.append(whitening.scale.ravel() > 0.0)
            self.block_at.append(block_at)
            self.at_rest.append(at_rest)
            first_group += 2 * int(group.max() // 2 + 1)
            self.blocks += count
        self.used = np.flatnonzero(np.concatenate(used))
        group = np.concatenate(groups)[self.used]
        count = np.bincount(group)
        group[count[group] < _FEWEST_SEEN] &= ~1  # rests that are too few join motion
        _, self.group = np.unique(group, return_inverse=True)  # (R,)
        self.block, self.channel, self.part = (  # (R,) block, equation, octave, highest first
            np.concatenate(one)[self.used] for one in (blocks, channels, parts))
        self.recording = np.repeat(np.arange(len(used)), [len(one) for one in used])[self.used]
        self.count = np.bincount(self.group).astype(float)  # (G,)
        self._order = np.argsort(self.group, kind='stable')
        self._ends = np.concatenate([[0], np.cumsum(self.count)]).astype(int)

    def sums(self, values) -> np.ndarray:
        """Return what values (R,) add up to in each group, shape (G,)."""
        return np.bincount(self.group, values, minlength=len(self.count))

    def ordered(self, derivatives) -> np.ndarray:
        """Return derivatives (C, R) group after group, as `products` take them."""
        return derivatives[:, self._order]

    def products(self, one, other) -> np.ndarray:
        """Return products by group (G, A, B) of derivatives (A, R) and (B, R), both `ordered`."""
        found = [one[:, a:b] @ other[:, a:b].T for a, b in zip(self._ends[:-1], self._ends[1:],
                                                               strict=True)]
        return np.reshape(found, (len(found), len(one), len(other)))


class Whitener:
    """Whitened residuals of several recordings, Motions with a Whitening each, as one vector."""

    def __init__(self, motions, whitenings):
        self.whitenings, self.groups = tuple(whitenings), Groups(motions, whitenings)

    def whiten(self, residuals) -> np.ndarray:
        """Return the whitened residuals (R,) of torques (S, 2 n) along each recording."""
        return self.joined(whitening.whiten(residual) for whitening, residual in zip(
            self.whitenings, residuals, strict=True))

    def whiten_spectra(self, spectra) -> np.ndarray:
        """Return the whitened residuals (R,) of the spectra of torques of each recording."""
        return self.joined(whitening.whiten_spectra(one) for whitening, one in zip(
            self.whitenings, spectra, strict=True))

    def whiten_each(self, torques, channel) -> np.ndarray:
        """
        Return the whitened residuals (K, R) of each of several torques in one equation alone.

        ``torques`` (S, K) are along each recording.
        """
        parts = [whitening.whiten_each(one, channel).reshape(-1, one.shape[1])
                 for whitening, one in zip(self.whitenings, torques, strict=True)]
        return np.ascontiguousarray(np.concatenate(parts)[self.groups.used].T)

    def joined(self, parts) -> np.ndarray:
        """Return residuals (S, 2 n) of each recording as one vector (R,)."""
        return np.concatenate([one.ravel() for one in parts])[self.groups.used]

    def behind_low_pass(self, residuals) -> list:
        """Return torques (S, 2 n) of each recording behind the low-pass, (S', 2 n) [N m]."""
        return [whitening.low_passed(one)
                for whitening, one in zip(self.whitenings, residuals, strict=True)]

    def in_motion(self, squares) -> np.ndarray:
        """Return the mean of squares (S', 2 n) of each recording while links move (2 n,)."""
        where = [np.tile(~still, 2) & whitening.settled[:, None]
                 for still, whitening in zip(self.groups.at_rest, self.whitenings, strict=True)]
        count = sum(one.sum(axis=0) for one in where)
        return sum(np.sum(square * one, axis=0) for square, one in zip(
            squares, where, strict=True)) / np.maximum(count, 1)


class Grams:
    """Products of derivatives at any weights of Groups; the ``fixed`` (C, R) never change."""

    def __init__(self, groups, fixed):
        ordered = groups.ordered(fixed)
        self.fixed, self._group = fixed, groups.group
        self._products = groups.products(ordered, ordered)

    def weighted(self, further, weight) -> np.ndarray:
        """Return products of the fixed ones, then ``further`` (V, R), weights (G,) by group."""
        count = len(self.fixed)
        out = np.empty((count + len(further),) * 2)
        scaled = further * weight[self._group]
        out[:count, :count] = np.tensordot(weight, self._products, 1)
        out[count:, :count] = scaled @ self.fixed.T
        out[:count, count:] = out[count:, :count].T
        out[count:, count:] = scaled @ further.T
        return out
