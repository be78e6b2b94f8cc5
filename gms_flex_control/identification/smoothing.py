# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Zero-phase derivatives of encoder angles: torque, position and velocity without lag."""

from gms_flex_control.data.signal_analysis import quantum
import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

_ORDER = 3
_SHORTEST, _LONGEST = 0.02, 0.4  # of a window [s]
_TORQUE_NOISE = 0.02  # of the usual torque: what noise of the acceleration may amount to
_BANDWIDTH = 0.226  # of four moving averages in a row, times the length of one
_CUBIC_NOISE = np.sqrt(720.0)  # of a second derivative, times window^-2.5 and step^-2


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square, NaN of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def means_held(values: np.ndarray, ends: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """
    Return the means (T, ...) between times ``edges`` (T + 1,) of values held before.

    Each of ``values`` (K, ...) is held from one of ``ends`` (K + 1,) to the next [s].
    """
    held = (np.asarray(values).T * np.diff(ends)).T
    impulse = np.concatenate([np.zeros((1, *held.shape[1:])), np.cumsum(held, axis=0)])
    impulse = np.apply_along_axis(lambda one: np.interp(edges, ends, one), 0, impulse)
    return (np.diff(impulse, axis=0).T / np.diff(edges)).T


def smoothing_window(period: float, noise: float, inertia: float, torque: float) -> int:
    """
    Return the samples of a window behind which the acceleration's noise is a small torque.

    Odd, at least 5. ``noise`` is the standard deviation of the angle [rad], that of a count its
    step over sqrt(12); ``inertia`` [kg m^2] times the acceleration is compared with the usual
    ``torque`` [N m]; sample ``period`` [s].
    """
    allowed = max(_TORQUE_NOISE * torque, 1e-300)
    length = (_CUBIC_NOISE * noise * inertia / allowed / period ** 2) ** 0.4
    length = np.clip(length, _SHORTEST / period, _LONGEST / period)
    return max(2 * round(length / 2) + 1, 5)


def noise_of(angle: np.ndarray) -> float:
    """Return the standard deviation of an angle's noise (T,), rounding included [rad]."""
    known = angle[np.isfinite(angle)]
    spread = float(np.std(np.diff(known, 3))) / np.sqrt(20.0)
    robust = float(np.median(np.abs(np.diff(known, 3)))) / np.sqrt(20.0) / 0.6745
    return max(min(spread, quantum(known) / np.sqrt(12.0)), robust, 1e-12)


def low_pass(values: np.ndarray, window: int) -> np.ndarray:
    """
    Return values (T, ...) through a zero-phase low-pass that hides what `derivatives` do.

    Four moving averages in a row, half of the ``window`` of `derivatives` each: the passband, to
    `low_pass_bandwidth`, is where the local cubic fit leaves motion as it is. Torque and model
    compared behind it differ by the model, not by the filter.
    """
    for _ in range(4):
        values = uniform_filter1d(values, max(window // 2, 1), axis=0, mode='nearest')
    return values


def low_pass_bandwidth(window: int, period: float) -> float:
    """Return the frequency [Hz] at which `low_pass` has lost 3 dB."""
    return _BANDWIDTH / (max(window // 2, 1) * period)


def low_pass_window(bandwidth: float, period: float) -> int:
    """Return the window whose `low_pass_bandwidth` is nearest to a frequency [Hz]."""
    return 2 * max(round(_BANDWIDTH / (bandwidth * period)), 1)


def derivatives(values: np.ndarray, period: float, window: int) -> tuple:
    """
    Return values (T, ...), evenly sampled without gaps, and two derivatives, all without lag.

    All three through the same local cubic fit (Savitzky-Golay) of ``window`` samples, odd.
    """
    window = min(window, 2 * ((len(values) - 1) // 2) + 1)
    order = min(_ORDER, window - 1)
    return tuple(savgol_filter(values, window, order, deriv=k, delta=period, axis=0)
                 for k in range(3))
