# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which command, reference and estimate belong to which joint state."""

from math import factorial
from typing import NamedTuple

import numpy as np

N_DERIVATIVES = 5  # rows of a reference: angle and its derivatives 1 to 4
_REACH = 1.5       # a reference further away than this many periods is none
_BLOCK = 2**15     # samples that are worked on at once, for the sake of memory


class Answers(NamedTuple):
    """
    Commands in the order they were received.

    Parameters
    ----------
    stamps : ndarray of int64, shape (S,)
        Stamps of the states they answer [ns].
    stamped : ndarray of bool, shape (S,)
        Whether there is one.
    received : ndarray of int64, shape (S,)
        Receive times [ns].
    values : ndarray, shape (S, n)
        Torques [N m].

    """

    stamps: np.ndarray
    stamped: np.ndarray
    received: np.ndarray
    values: np.ndarray


def answering(stamps, received, period, answers, n):
    """
    Return the command that answers each state.

    Parameters
    ----------
    stamps, received : ndarray of int64, shape (T,)
        Header stamps and receive times of the states [ns].
    period : float
        Sample period [ns].
    answers : Answers
        The commands.
    n : int
        Number of joints.

    Returns
    -------
    ndarray, shape (T, n)
        By the stamp a command carries (the first to arrive); one without goes to the last
        state received before it, if that is at most one period ago. NaN where none came.

    """
    command = np.full((len(stamps), n), np.nan)
    row = np.full(len(answers.stamps), -1)
    row[answers.stamped] = _row_of(answers.stamps[answers.stamped], stamps)
    times = answers.received[~answers.stamped]
    before = np.searchsorted(received, times, side='right') - 1
    row[~answers.stamped] = np.where(times - received[before] <= period, before, -1)
    rows, first = np.unique(row, return_index=True)
    first = first[rows >= 0]
    command[row[first]] = answers.values[first]
    return command


def _row_of(wanted, stamps):
    """Return where each of ``wanted`` is in the increasing ``stamps``, -1 where it is not."""
    row = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    return np.where(stamps[row] == wanted, row, -1)


def reference_at(times, period, labels, table):
    """
    Return the reference at each state.

    Parameters
    ----------
    times : ndarray of int64, shape (T,)
        Times of the states [ns].
    period : float
        Sample period [ns].
    labels : ndarray of int64, shape (S,)
        Times of the references [ns].
    table : ndarray, shape (S, 5, n)
        Angle and derivatives, NaN where there is none.

    Returns
    -------
    ndarray, shape (T, 5, n)
        The reference of the same time; else the nearest within 1.5 periods, carried on to the
        state's time by its own derivatives. NaN where there is none.

    """
    result = np.full((len(times), *table.shape[1:]), np.nan)
    if not len(table):
        return result
    labels, order = np.unique(labels, return_index=True)
    for start in range(0, len(times), _BLOCK):
        block = slice(start, start + _BLOCK)
        nearest, shift = _nearest(times[block], labels)
        near = np.abs(shift) <= _REACH * period
        result[block][near] = _carried_on(table[order[nearest[near]]], shift[near] * 1e-9)
    return result


def _nearest(times, labels):
    """Return which of the increasing ``labels`` is nearest and how much later the time is."""
    right = np.clip(np.searchsorted(labels, times), 1, max(len(labels) - 1, 1))
    left, right = right - 1, np.minimum(right, len(labels) - 1)
    nearest = np.where(times - labels[left] <= labels[right] - times, left, right)
    return nearest, times - labels[nearest]


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
    result = np.full((len(stamps), values.shape[1]), np.nan)
    row = _row_of(other_stamps, stamps)
    result[row[row >= 0]] = values[row >= 0]
    return result
