# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Zero-phase derivatives of encoder angles: torque, position and velocity without lag."""

from gms_flex_control.analysis.signals import quantum
import numpy as np
from scipy.signal import savgol_filter

_ORDER = 3
_SHORTEST, _LONGEST = 0.03, 0.3  # of a window [s]
_STEPS = 12  # encoder steps a window should span at the usual speed


def smoothing_window(period, angle):
    """
    Return the samples of a window that sees the motion through the encoder's steps.

    Parameters
    ----------
    period : float
        Sample [s].
    angle : ndarray, shape (T,)
        Measured angle [rad].

    Returns
    -------
    int
        Odd, at least 5.

    """
    speed = np.median(np.abs(angle[50:] - angle[:-50])) / (50 * period) if len(angle) > 100 else 0
    wanted = _STEPS * quantum(angle) / speed if speed > 0.0 else _LONGEST
    length = float(np.clip(wanted, _SHORTEST, _LONGEST))
    return max(2 * round(length / period / 2) + 1, 5)


def derivatives(values, period, window):
    """
    Return values and their first and second derivatives, smoothed without lag.

    Parameters
    ----------
    values : ndarray, shape (T,)
        Evenly sampled, without gaps.
    period : float
        Sample [s].
    window : int
        Samples of the local cubic fit (Savitzky-Golay), odd.

    Returns
    -------
    tuple of ndarray, shape (T,)
        Value, rate and acceleration, all through the same filter.

    """
    window = min(window, 2 * ((len(values) - 1) // 2) + 1)
    order = min(_ORDER, window - 1)
    return tuple(savgol_filter(values, window, order, deriv=k, delta=period) for k in range(3))
