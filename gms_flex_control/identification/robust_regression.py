# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Linear regression that a few odd rows do not bend (Huber), with errors by blocks of time."""

from gms_flex_control.identification.uncertainty import block_sums
import numpy as np

_HUBER = 1.5       # residuals beyond this many standard deviations count less
_ROUNDS = 8
_OWN_SCALE = 50    # rows from which a group has a scale of its own: its median is within 15 %
_FOLDS = 5


def robust(columns: np.ndarray, target: np.ndarray, group: np.ndarray | None = None) -> tuple:
    """
    Return the weights (S,) of rows in a robust regression (Huber), and the residuals' scale.

    The scale is the standard deviation of their bulk, a number, or (S,) that of each row's
    ``group`` (S,): what carries a load is noisier. ``columns`` (S, P), ``target`` (S,).
    """
    weights, scale = np.ones(len(target)), 1.0
    for _ in range(_ROUNDS):
        root = np.sqrt(weights) / (1.0 if group is None else scale)  # one scale changes nothing
        values = np.linalg.lstsq(columns * root[:, None], target * root, rcond=1e-10)[0]
        off = np.abs(target - columns @ values)
        scale = _scale(off) if group is None else _scales(off, group)
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(off, 1e-300))
    return weights, scale


def _scale(off):
    return max(float(np.median(off)) / 0.6745, 1e-300) if len(off) else 1.0


def _scales(off, group):
    """Return the scale (S,) of each row's group, that of all where a group has few rows."""
    scale = np.full(len(off), _scale(off))
    for one in np.unique(group):
        rows = group == one
        if np.sum(rows) >= _OWN_SCALE:
            scale[rows] = _scale(off[rows])
    return scale


def solution(columns: np.ndarray, target: np.ndarray, block: np.ndarray) -> tuple:
    """
    Return coefficients (P,) and standard errors of a robust regression.

    Only blocks of time are independent: ``block`` (S,) has their numbers.
    """
    root = np.sqrt(robust(columns, target)[0])
    scaled, target = columns * root[:, None], target * root
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    values = inverse @ (scaled.T @ target)
    blocks = block_sums(scaled * (target - scaled @ values)[:, None], block)
    blocks = blocks[np.bincount(block, minlength=len(blocks)) > 0]
    many = len(blocks) / max(len(blocks) - 1, 1)
    return values, np.sqrt(np.diag(many * inverse @ (blocks.T @ blocks) @ inverse))


def held_out_error(columns: np.ndarray, target: np.ndarray, block: np.ndarray) -> float:
    """Return the mean error of predicting each of five sets of blocks from the others."""
    off = np.zeros(len(target))
    for fold in range(_FOLDS):
        out = block % _FOLDS == fold
        if out.any() and not out.all():
            root = np.sqrt(robust(columns[~out], target[~out])[0])
            values = np.linalg.lstsq(columns[~out] * root[:, None], target[~out] * root,
                                     rcond=1e-10)[0]
            off[out] = target[out] - columns[out] @ values
    return float(np.mean(np.abs(off)))
