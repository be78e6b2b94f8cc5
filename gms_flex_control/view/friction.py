# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction blocks along a motion that was recorded without them."""

from gms_flex_control.compiled import compiled
from gms_flex_control.friction import gms
import numpy as np


@compiled
def _along(angle, rate, step, constants, state, displacement, torque, sticking):
    for k in range(angle.shape[0]):
        if k > 0:
            for j in range(angle.shape[1]):
                displacement[j] = angle[k, j] - angle[k - 1, j]
            gms.advance(state, displacement, rate[k], step[k], constants)
        torque[k] = state.torque
        sticking[k] = state.sticking


def blocks_along(recording, friction):
    """
    Return what the blocks of a friction model do along the recorded link angles.

    Parameters
    ----------
    recording : Recording
        Of T samples and n joints; a missing rate is differenced, a missing angle held.
    friction : FrictionParams
        Of the same joints.

    Returns
    -------
    torque, sticking : ndarray, shape (T, n, N), float32
        Torque of each block, which begins unloaded [N m], and 1 for sticking, 0 for slipping.

    Notes
    -----
    Eqs. (2) and (3). It is the model's answer, not a measurement: blocks cannot be measured.

    """
    angle = _held(recording.q_link)
    step = np.diff(recording.time, prepend=recording.time[0] - recording.period)
    rate = np.array(recording.dq_link)
    missing = ~np.isfinite(rate)
    rate[missing] = (np.diff(angle, axis=0, prepend=angle[:1]) / step[:, None])[missing]
    shape = (len(angle), *friction.stiffness.shape)
    torque, sticking = np.empty(shape, np.float32), np.empty(shape, np.float32)
    _along(np.ascontiguousarray(angle), np.ascontiguousarray(rate), step,
           gms.constants_of(friction), gms.init(friction), np.zeros(angle.shape[1]), torque,
           sticking)
    return torque, sticking


def _held(values):
    """Return values (T, n) with the last known one, first of all the first, where missing."""
    known = np.isfinite(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values))[:, None], -1), axis=0)
    first = np.where(known.any(axis=0), known.argmax(axis=0), 0)
    held = np.take_along_axis(values, np.where(last < 0, first, last), axis=0)
    return np.nan_to_num(held)
