# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The clock by which a robot was sampled, behind the stamps that its samples got.

A drive samples at even times; its driver stamps late, by what the operating system makes of it. A
late stamp puts a moving joint where it was not, by speed times lateness: far more than encoders
do. Which it is the angles say: true times make them smooth.
"""

from dataclasses import replace

from gms_flex_control.data.recording import Recording
import numpy as np

_EVEN = 1e-3       # of a period: stamps nearer than that to their clock stay as they are
_EARLY = 0.3       # of a period by which a stamp may be before its sample; late ones fill the rest
_OFF = 0.02        # relative, by which the median step may miss the period
_FEWEST = 16       # samples that show a clock
_BEGIN = 256       # samples in which the period is looked for first, then in four times as many
_STEP = 0.125      # periods by which candidates differ over all samples


def on_even_clock(recording: Recording) -> Recording:
    """
    Return a Recording with its samples at even times if its angles are smoother so.

    Of lost samples the times stay free. Stamps that are the true times of uneven samples stay, as
    those do of angles too coarse or too still to show the difference.
    """
    stamps, period = recording.time, recording.period
    if len(stamps) < _FEWEST or np.abs(np.diff(stamps) - period).max() < _EVEN * period:
        return recording
    slots, period = _slots(stamps)
    even = period * slots
    if np.ptp(stamps - even) < _EVEN * period:
        return recording
    angles = [one for one in (*recording.q_link.T, *recording.q_motor.T)
              if np.isfinite(one).sum() > _FEWEST]
    if sum(_roughness(angle, even, period) - _roughness(angle, stamps, period)
           for angle in angles) >= 0.0:
        return recording
    return replace(recording, time=even)


def _slots(stamps):
    """Return at which even time each sample was taken (T,), increasing from 0, and the period."""
    period = _period(stamps)
    turns = (stamps - stamps[0]) / period
    turns -= np.angle(np.sum(np.exp(2j * np.pi * turns))) / (2.0 * np.pi)
    order = np.arange(len(stamps))
    slots = np.floor(turns + _EARLY).astype(int) - order
    slots = np.minimum.accumulate(slots[::-1])[::-1] + order  # later than a period: the one before
    slots -= slots[0]
    return slots, float(np.polyfit(slots, stamps, 1)[0])


def _period(stamps):
    """Return the period with which stamps (T,) agree best in phase, that of a clock [s]."""
    period, off, count = float(np.median(np.diff(stamps))), _OFF, _BEGIN
    while True:
        time = stamps[:count] - stamps[0]
        step = _STEP * period / time[-1]
        rates = (1.0 + step * np.arange(-int(off / step) - 1, int(off / step) + 2)) / period
        period = 1.0 / max(rates, key=lambda rate: abs(np.sum(np.exp(2j * np.pi * rate * time))))
        if count >= len(stamps):
            return period
        off, count = 4.0 * step, 4 * count


def _roughness(angle, time, period):
    """Return the logarithm of the mean squared third difference of an angle at even times."""
    known = np.isfinite(angle)
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period * (1.0 + 1e-9)) + 1)
    squares = np.diff(np.interp(grid, time[known], angle[known]), 3) ** 2
    return float(np.log(max(np.mean(squares), 1e-300)))
