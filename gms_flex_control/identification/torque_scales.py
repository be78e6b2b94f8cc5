# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Scales of recorded torques of which no constant is known, from the links as described."""

from collections.abc import Callable, Sequence

from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.arm_rows import Rows
from gms_flex_control.identification.robust_regression import solution
import numpy as np

_SURE = 3.0        # standard errors from which a torque shows what its links require
_DESCRIBED_SD = 0.5  # of the logarithm of a scale, around what the masses described give
_ALIKE_SD = 1.0    # and of scales of the joints of one arm, around each other


def described_scales(rows: Rows, described: np.ndarray, own: Callable, unknown: Sequence[int],
                     names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what is recorded per true torque, and the prior deviations of its logarithm, (U,) each.

    Of the joints ``unknown`` (U,), beside torques of the links as ``described`` (S, n) [N m].
    Columns ``own(joint, rows)`` and motor inertia are left open. A joint whose links the motion
    hardly loads is taken to have a scale like the others'. IdentificationError, of the torque with
    its name of ``names`` (n,), where one goes against its links or none shows what they require.
    """
    found, error = np.array([_scale_of(rows, described, own, j) for j in unknown]).T
    against = np.flatnonzero(found < -_SURE * error)
    if len(against):
        first = against[0]
        raise IdentificationError(
            f'{names[unknown[first]]} goes against what its links require ({found[first]:.3g} per '
            'N m): its sign is reversed, or its torque constant is negative; state it in '
            'recording.yaml')
    seen = found > _SURE * error
    if not seen.any():
        raise IdentificationError(
            f'{names[unknown[0]]} and of the others do not show what links require, so that no '
            'torque constant can be found: state torque_constant in recording.yaml, or move '
            'against gravity')
    logs = np.log(np.where(seen, found, np.nan))
    mean, precision = np.nanmean(logs), _DESCRIBED_SD ** -2 * seen
    total = precision + _ALIKE_SD ** -2
    shrunk = (precision * np.where(seen, logs, mean) + mean * _ALIKE_SD ** -2) / total
    return np.exp(shrunk), 1.0 / np.sqrt(total)


def _scale_of(rows, described, own, j):
    """Return a recorded torque per N m of its links, and its standard error."""
    columns = np.concatenate([described[:, j:j + 1], rows.acceleration[:, j:j + 1],
                              own(j, slice(None))], axis=1)
    values, errors = solution(columns, rows.torque[:, j], rows.block)
    return values[0], errors[0]
