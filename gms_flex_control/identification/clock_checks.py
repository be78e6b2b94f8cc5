# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Faults of the time stamps: lost samples, jumps of the clock, stamps that are not the time."""

from gms_flex_control.data.signals import quantum
from gms_flex_control.identification.findings import Finding
import numpy as np

FASTEST, SLOWEST = 2e-5, 0.2  # plausible periods [s]
LOST_WARN, LOST_REFUSE = 0.003, 0.3  # shares of all samples
GAP_WARN = 0.05               # a single gap worth a word [s]
_ON_GRID = 0.1                # a step of a steady clock is this near a multiple of the period
_SHORT = 0.55                 # of a period: sooner than jitter puts a sample
_CLUSTER = 10                 # short steps near each other are no late message
_BESIDE = 10                  # samples that tell the velocity beside a gap


def clock(signals):
    """
    Look the time stamps over.

    Parameters
    ----------
    signals : Signals
        The recording.

    Returns
    -------
    list of Finding
        Kinds 'clock' and 'dropped'.

    """
    steps, period = np.diff(signals.time), signals.period
    if not FASTEST <= period <= SLOWEST:
        return [Finding('clock', '', 'refuse', f'{signals.source}: the median sample period is '
                        f'{period:.4g} s; are the stamps in another unit than seconds?')]
    multiple = np.rint(steps / period)
    steady = np.mean((np.abs(steps / period - multiple) < _ON_GRID) & (multiple > 0)) > 0.9
    gaps = np.flatnonzero(steps > (1.5 if steady else 1.8) * period)
    jumps = np.array([k for k in gaps if steps[k] > 3 * period and _continues(signals, k)],
                     dtype=int)
    found = []
    if jumps.size:
        found.append(_jumped(signals, steps, jumps))
    found += _short_steps(signals, steps, steady)
    found += _lost(signals, steps, np.setdiff1d(gaps, jumps))
    return found


def _jumped(signals, steps, jumps):
    worst = jumps[np.argmax(steps[jumps])]
    return Finding('clock', '', 'refuse', f'{signals.source}: the clock jumps ahead '
                   f'{jumps.size} times, most by {steps[worst]:.4g} s at '
                   f'{signals.time[worst]:.3f} s, while the joints move on by one period only; '
                   'correct the stamps or cut the recording there')


def _continues(signals, k):
    """Tell whether motion goes on over step k as if only one period had passed."""
    time, gap = signals.time, signals.time[k + 1] - signals.time[k]
    first, last = max(0, k - _BESIDE), min(len(time) - 1, k + 1 + _BESIDE)
    if k == first or last == k + 1:
        return False
    votes = []
    for j in range(len(signals.joints)):
        q = signals.q_link[:, j]
        before = (q[k] - q[first]) / (time[k] - time[first])
        after = (q[last] - q[k + 1]) / (time[last] - time[k + 1])
        mean, gone = 0.5 * (before + after), q[k + 1] - q[k]
        steady = abs(before - after) < 0.3 * abs(mean)
        if steady and abs(mean) * gap > 10 * quantum(q[first:last + 1]):
            votes.append(abs(gone - mean * signals.period) < 0.2 * abs(mean) * gap)
    return bool(votes) and all(votes)


def _short_steps(signals, steps, steady):
    """Find stamps closer than the sampling really was, as when the clock is set back."""
    short = np.flatnonzero(steps < _SHORT * signals.period)
    if steady and short.size >= 3:
        wrong = sum(_contradicts(signals, steps, short, j) for j in range(len(signals.joints)))
        if wrong >= 3:
            yield Finding('clock', '', 'refuse', f'{signals.source}: {short.size} stamps follow '
                          f'the one before too soon, the first at '
                          f'{signals.time[short[0]]:.3f} s, and the motion contradicts them: '
                          'the clock was set back or samples are out of order; correct the '
                          'stamps or cut the recording there')
            return
        dense = len(short) > _CLUSTER and np.min(short[_CLUSTER:] - short[:-_CLUSTER]) < (
            5 * _CLUSTER)
        if dense or short.size > 0.001 * len(steps):
            yield Finding('clock', '', 'warn', f'{signals.source}: {short.size} stamps follow '
                          'the one before too soon, the first at '
                          f'{signals.time[short[0]]:.3f} s; was the clock set back there? If '
                          'so, cut the recording')
            return
    spread = float(np.subtract(*np.quantile(steps, [0.9, 0.1]))) / signals.period
    if spread > 1.0 and not steady:
        yield Finding('clock', '', 'warn', f'{signals.source}: the sample period is irregular '
                      f'({spread:.1f} periods between the 10 % and 90 % quantiles); stamp the '
                      'samples when they are taken')


def _contradicts(signals, steps, short, j):
    """Return at how many short steps joint j moves otherwise than its velocity says."""
    q, time = signals.q_link[:, j], signals.time
    first = np.maximum(short - 3 * _BESIDE, 0)
    last = np.minimum(short + 1 + 3 * _BESIDE, len(time) - 1)
    velocity = (q[last] - q[first]) / (time[last] - time[first])
    fast = np.abs(velocity) * signals.period > 3 * quantum(q)
    error = np.abs(q[short + 1] - q[short] - velocity * steps[short])
    return int(np.sum(fast & (error > 0.3 * np.abs(velocity) * signals.period)))


def _lost(signals, steps, gaps):
    if not gaps.size:
        return
    lost = int(np.sum(np.rint(steps[gaps] / signals.period) - 1))
    share = lost / (lost + len(signals.time))
    worst = gaps[np.argmax(steps[gaps])]
    if share >= LOST_REFUSE:
        severity = 'refuse'
    elif (share >= LOST_WARN and lost >= 3) or steps[worst] > max(
            GAP_WARN, 5 * signals.period):
        severity = 'warn'
    else:
        return
    yield Finding('dropped', '', severity, f'{signals.source}: {lost} samples '
                  f'({100 * share:.2g} %) are missing in {gaps.size} gaps, the longest '
                  f'{1e3 * steps[worst]:.4g} ms at {signals.time[worst]:.3f} s; they are '
                  'bridged only where short: record with less load or a higher priority')
