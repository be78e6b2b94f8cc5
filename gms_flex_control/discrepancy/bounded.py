# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Least squares within bounds, on sums of squares that are already known."""

from gms_flex_control.compiled import compiled
import numpy as np

_SWEEPS = 400
_ENOUGH = 1e-10


@compiled
def descend(gram, right, lower, upper, x):
    """Minimise ``x' G x / 2 - b' x`` within bounds, coordinate by coordinate, in place."""
    size = x.shape[0]
    for _ in range(_SWEEPS):
        moved = 0.0
        for i in range(size):
            if gram[i, i] <= 0.0:
                continue
            slope = right[i]
            for k in range(size):
                slope -= gram[i, k] * x[k]
            value = min(max(x[i] + slope / gram[i, i], lower[i]), upper[i])
            moved = max(moved, gram[i, i] * (value - x[i]) ** 2)
            x[i] = value
        if moved < _ENOUGH:
            break


def solve(gram, right, lower, upper):
    """
    Return the minimiser of ``x' G x / 2 - b' x`` within bounds.

    Parameters
    ----------
    gram : ndarray, shape (P, P)
        Symmetric, positive semi-definite.
    right, lower, upper : ndarray, shape (P,)
        b and the bounds.

    Returns
    -------
    ndarray, shape (P,)

    """
    free = np.ones(len(right), dtype=bool)
    x = np.zeros(len(right))
    fixed = np.zeros(len(right))
    for _ in range(3 * len(right)):  # active set: quick where few bounds are met
        rest = right[free] - gram[np.ix_(free, ~free)] @ fixed[~free]
        part = gram[np.ix_(free, free)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(part), 1e-300))
        inside = scale * np.linalg.lstsq(part * np.outer(scale, scale), scale * rest,
                                         rcond=1e-12)[0]
        x[free], x[~free] = inside, fixed[~free]
        beyond = (x < lower) | (x > upper)
        if not beyond.any():
            break
        fixed[beyond] = np.clip(x, lower, upper)[beyond]
        free &= ~beyond
        if not free.any():
            x = np.clip(x, lower, upper)
            break
    x = np.clip(x, lower, upper)
    descend(np.ascontiguousarray(gram), right, lower, upper, x)  # frees what was bound too soon
    return x
