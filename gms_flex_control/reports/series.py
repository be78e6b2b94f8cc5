# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Lines of a chart: one abscissa for all, and few enough points to carry in a file."""

import numpy as np


def merge_grids(x, lines):
    """
    Put lines with different abscissae on their union.

    Parameters
    ----------
    x : array_like, shape (T,)
        Abscissa of the lines that bring none.
    lines : sequence of (label, x or None, y)
        Each y of the length of its own x.

    Returns
    -------
    grid : ndarray, shape (N,)
        Union of all abscissae.
    values : list of ndarray, shape (N,)
        The lines on it: linear between their samples, NaN outside and beside a NaN.

    Raises
    ------
    ValueError
        If lengths differ or an abscissa is empty, not finite or does not increase.

    """
    pairs = []
    for label, own, y in lines:
        abscissa = _checked(x if own is None else own, label)
        y = np.asarray(y, dtype=float)
        if y.shape != abscissa.shape:
            raise ValueError(f'series {label!r}: y has shape {y.shape}, x {abscissa.shape}')
        pairs.append((abscissa, y))
    if not pairs:
        raise ValueError('a chart needs at least one series')
    grid = pairs[0][0]
    for abscissa, _ in pairs[1:]:
        if not np.array_equal(abscissa, grid):
            grid = np.union1d(grid, abscissa)
    return grid, [y if abscissa is grid or np.array_equal(abscissa, grid) else
                  np.interp(grid, abscissa, y, left=np.nan, right=np.nan)
                  for abscissa, y in pairs]


def decimate(x, values, limit):
    """
    Return lines with at most ``limit`` points that keep every peak.

    Parameters
    ----------
    x : ndarray, shape (N,)
        Increasing abscissa.
    values : sequence of ndarray, shape (N,)
        The lines.
    limit : int
        Points to keep.

    Returns
    -------
    x : ndarray, shape (M,)
        Unchanged if N <= limit, else first and last abscissa of limit / 2 buckets.
    values : list of ndarray, shape (M,)
        Per bucket the smallest and largest value in the order they occur.

    """
    if len(x) <= limit:
        return x, list(values)
    edges = np.linspace(0, len(x), limit // 2 + 1).astype(int)
    first, last = edges[:-1], edges[1:] - 1
    return np.column_stack([x[first], x[last]]).ravel(), [
        _extremes(y, edges) for y in values]


def _extremes(y, edges):
    finite = np.isfinite(y)
    low = np.minimum.reduceat(np.where(finite, y, np.inf), edges[:-1])
    high = np.maximum.reduceat(np.where(finite, y, -np.inf), edges[:-1])
    # which of the two comes first: compare the position of each in its bucket
    bucket = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    position = np.arange(len(y))
    size = len(y)
    at_low = np.minimum.reduceat(np.where(y == low[bucket], position, size), edges[:-1])
    at_high = np.minimum.reduceat(np.where(y == high[bucket], position, size), edges[:-1])
    pair = np.where((at_low <= at_high)[:, None], np.column_stack([low, high]),
                    np.column_stack([high, low]))
    pair[~np.isfinite(pair)] = np.nan
    return pair.ravel()


def _checked(x, label):
    x = np.asarray(x, dtype=float)
    if x.ndim != 1 or not x.size or not np.all(np.isfinite(x)) or np.any(np.diff(x) <= 0):
        raise ValueError(f'series {label!r}: the abscissa must be finite and increase '
                         f'(shape {x.shape}); plot a loop as a figure instead')
    return x
