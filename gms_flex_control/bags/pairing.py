# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which command, reference and estimate belong to which joint state."""

from math import factorial

import numpy as np

N_DERIVATIVES = 5  # rows of a reference: angle and its derivatives 1 to 4
_REACH = 1.5       # a reference further away than this many periods is none


def answering(stamps, received, period, answers, n):
    """
    Return the command that answers each state.

    Parameters
    ----------
    stamps, received : ndarray of int64, shape (T,)
        Header stamps and receive times of the states [ns].
    period : float
        Sample period [ns].
    answers : tuple
        ``(stamps, received, arrays)`` of the commands: lists of int or None, int, (n,).
    n : int
        Number of joints.

    Returns
    -------
    ndarray, shape (T, n)
        By the stamp a command carries (the first to arrive); one without goes to the last
        state received before it, if that is at most one period ago. NaN where none came.

    """
    command = np.full((len(stamps), n), np.nan)
    labels, times, arrays = answers
    row_of = {stamp: k for k, stamp in enumerate(stamps.tolist())}
    taken = np.full(len(stamps), False)
    for label, time, array in zip(labels, times, arrays, strict=True):
        if label is not None:
            k = row_of.get(label, -1)
        else:
            k = int(np.searchsorted(received, time, side='right')) - 1
            if k >= 0 and time - received[k] > period:
                k = -1
        if k >= 0 and not taken[k]:
            command[k], taken[k] = array, True
    return command


def reference_at(times, period, labels, arrays, n):
    """
    Return the reference at each state.

    Parameters
    ----------
    times : ndarray of int64, shape (T,)
        Times of the states [ns].
    period : float
        Sample period [ns].
    labels : sequence of int
        Times of the references [ns].
    arrays : sequence of ndarray, shape (rows, n)
        Angle and derivatives, up to five rows.
    n : int
        Number of joints.

    Returns
    -------
    ndarray, shape (T, 5, n)
        The reference of the same time; else the nearest within 1.5 periods, carried on to the
        state's time by its own derivatives. NaN where there is none.

    """
    result = np.full((len(times), N_DERIVATIVES, n), np.nan)
    if not len(arrays):
        return result
    table = np.full((len(arrays), N_DERIVATIVES, n), np.nan)
    for k, array in enumerate(arrays):
        table[k, :len(array)] = array
    labels, order = np.unique(np.asarray(labels, dtype=np.int64), return_index=True)
    table = table[order]
    right = np.clip(np.searchsorted(labels, times), 1, max(len(labels) - 1, 1))
    left, right = right - 1, np.minimum(right, len(labels) - 1)
    nearest = np.where(times - labels[left] <= labels[right] - times, left, right)
    shift = times - labels[nearest]
    near = np.abs(shift) <= _REACH * period
    result[near] = _carried_on(table[nearest[near]], shift[near] * 1e-9)
    return result


def _carried_on(table, shift):
    """Return the Taylor series of references (T, 5, n) after ``shift`` (T,) [s]."""
    known = np.nan_to_num(table)
    result = table.copy()
    for row in range(N_DERIVATIVES):
        for power in range(1, N_DERIVATIVES - row):
            weight = shift ** power / factorial(power)
            result[:, row] += weight[:, None] * known[:, row + power]
    return result


def by_stamp(stamps, other_stamps, values):
    """Return ``values`` (S, n) of ``other_stamps`` (S,) at ``stamps`` (T,), NaN where none."""
    row_of = {stamp: k for k, stamp in enumerate(stamps.tolist())}
    result = np.full((len(stamps), values.shape[1]), np.nan)
    for k, stamp in enumerate(other_stamps.tolist()):
        row = row_of.get(stamp)
        if row is not None:
            result[row] = values[k]
    return result
