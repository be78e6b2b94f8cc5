# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A recording at even times: angles read there, and torques held from one sample to the next."""

from gms_flex_control.data.recording import COVERED, Recording
from gms_flex_control.data.signal_analysis import means_held
from gms_flex_control.errors import BagError
import numpy as np


def even_time(recording: Recording) -> tuple[np.ndarray, float]:
    """Return evenly spaced times (T,) over a recording, and their period [s]."""
    time, period = recording.time, recording.period
    steps = np.diff(time)
    if np.abs(steps - period).max() < 1e-3 * period:
        return time, float((time[-1] - time[0]) / (len(time) - 1))
    count = int((time[-1] - time[0]) / period * (1.0 + 1e-9)) + 1
    return time[0] + period * np.arange(count), period


def resampled(recording: Recording, values: np.ndarray, time: np.ndarray,
              what: str) -> np.ndarray:
    """Return values at even times; raise BagError where most are missing."""
    known = np.isfinite(values)
    if known.mean() < 0.5:
        raise BagError(f'{recording.source}: the {what} is missing; the equations of motion '
                       'need it')
    if time is recording.time and known.all():
        return values
    return np.interp(time, recording.time[known], values[known])


def held_torque(recording: Recording, time: np.ndarray, period: float) -> np.ndarray:
    """Return the torque held from even times on (T, n) [N m]: commands, or efforts reported."""
    if not recording.has_commands and np.isfinite(recording.tau_motor).mean() <= COVERED:
        raise BagError(f'{recording.source}: neither torque commands nor joint efforts cover the '
                       'recording; record /effort_controller/commands or the effort of '
                       '/joint_states too')
    torque = recording.commanded()
    return torque if time is recording.time else mean_held(torque, recording.time, time, period)


def mean_held(torque: np.ndarray, since: np.ndarray, time: np.ndarray,
              period: float) -> np.ndarray:
    """Return the mean from each of even times (T,) on of torques (K, n) held ``since`` (K,)."""
    until = np.append(since, max(since[-1], time[-1]) + 2.0 * period)
    return means_held(torque, until, np.append(time, time[-1] + period))


def second_difference(angle: np.ndarray, period: float) -> np.ndarray:
    """Return the central second difference of angles (T, ...), zero at both ends."""
    out = np.zeros_like(angle)
    out[1:-1] = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / period ** 2
    return out


def held_triangle(torque: np.ndarray) -> np.ndarray:
    """
    Return torques (T, n) held from sample k to k + 1 as a second difference sees them.

    Under a force held over each sample, ``q[k+1] - 2 q[k] + q[k-1]`` is exactly the mean of both
    samples' accelerations times the squared period.
    """
    out = torque.copy()
    out[1:] = 0.5 * (torque[1:] + torque[:-1])
    return out
