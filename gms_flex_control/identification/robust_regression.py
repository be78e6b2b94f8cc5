# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Linear regression that a few odd rows do not bend (Huber), with errors by blocks of time."""

from collections.abc import Callable, Sequence

from gms_flex_control.data.signal_analysis import FOLDS, NORMAL_MEDIAN
from gms_flex_control.identification.uncertainty import (
    block_sums,
    clustered,
    root_of_inverse,
    unshrunk,
)
import numpy as np

_HUBER = 1.5       # residuals beyond this many standard deviations count less
_ROUNDS = 8
_OWN_SCALE = 50    # rows from which a group has a scale of its own: its median is within 15 %
SLOWEST = 0.05    # of the usual rate: below this a joint does not move
_TAILS = 4.0       # degrees of freedom of a prior: what is known may be wrong
_SAME = 1e-9       # of the largest singular value: no column of its own


def robust(columns: np.ndarray, target: np.ndarray, group: np.ndarray | None = None, *,
           by_freedom: bool = True) -> tuple:
    """
    Return the weights (S,) of rows in a robust regression (Huber), and the scale of their noise.

    That is the standard deviation of the residuals' bulk per degree of freedom, a number, or (S,)
    that of each row's ``group`` (S,): what carries a load is noisier. It is infinite where rows
    are too few for the columns. ``columns`` (S, P), ``target`` (S,). Not ``by_freedom`` it is that
    of the residuals, and more of few rows are outliers.
    """
    weights, scale = np.ones(len(target)), 1.0
    for _ in range(_ROUNDS):
        root = np.sqrt(weights) / (1.0 if group is None else scale)  # one scale changes nothing
        values, _, rank, _ = np.linalg.lstsq(columns * root[:, None], target * root, rcond=1e-10)
        off = np.abs(target - columns @ values)
        free = max(len(target) - rank, 0) / max(len(target), 1) if by_freedom else 1.0
        scale = _scale(off) if group is None else _scales(off, group)
        scale = scale / np.sqrt(free) if free else np.inf
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(off, 1e-300))
    return weights, scale


def heavy_tailed(off: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Return inverse variances of priors with the tails of Student's distribution, where off."""
    return (_TAILS + 1.0) / (_TAILS * sd ** 2 + off ** 2)


def _scale(off):
    return max(float(np.median(off)) / NORMAL_MEDIAN, 1e-300) if len(off) else 1.0


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
    root = np.sqrt(robust(columns, target, by_freedom=False)[0])
    scaled, target = columns * root[:, None], target * root
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    values = inverse @ (scaled.T @ target)
    blocks = block_sums(scaled * (target - scaled @ values)[:, None], block)
    blocks = blocks[np.bincount(block, minlength=len(blocks)) > 0]
    many = len(blocks) / max(len(blocks) - 1, 1)
    return values, np.sqrt(np.diag(many * inverse @ (blocks.T @ blocks) @ inverse))


def first_coefficient(columns: np.ndarray, target: np.ndarray, block: np.ndarray,
                      memory: float) -> tuple[float, float]:
    """
    Return the first coefficient of a robust regression, and its standard error.

    By blocks of time, no smaller than if ``memory`` samples counted as one and others not.
    """
    weights, scale = robust(columns, target)
    if not np.isfinite(scale):
        return 0.0, np.inf
    root = np.sqrt(weights)
    scaled = columns * root[:, None]
    values = np.linalg.lstsq(scaled, target * root, rcond=1e-10)[0]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    scores = block_sums(scaled * (target * root - scaled @ values)[:, None], block)
    return float(values[0]), float(np.sqrt(clustered(
        scale ** 2 * inverse, scores / scale ** 2, memory)[0, 0]))


def held_out_error(columns: np.ndarray, target: np.ndarray, block: np.ndarray) -> float:
    """Return the mean error of predicting each of five sets of blocks from the others."""
    off = np.zeros(len(target))
    for fold in range(FOLDS):
        out = block % FOLDS == fold
        if out.any() and not out.all():
            root = np.sqrt(robust(columns[~out], target[~out], by_freedom=False)[0])
            values = np.linalg.lstsq(columns[~out] * root[:, None], target[~out] * root,
                                     rcond=1e-10)[0]
            off[out] = target[out] - columns[out] @ values
    return float(np.mean(np.abs(off)))


def regress(regressors, torque, block, friction: Callable, weighting: Sequence, precision=0.0,
            pull=0.0, expected=None) -> tuple:
    """
    Return weighted least squares of the torque (S, n) of all joints on regressors (S, n, B).

    Each joint counts by the ``weighting`` of `weighting_of`; its friction, columns
    ``friction(joint, rows)``, is eliminated. ``precision`` (B,) is that of priors at ``pull``
    (B,). The values (B,), their normal matrix (B, B) and, for each joint, regressors, torque,
    numbers of blocks of time and an orthonormal basis of what was eliminated, scaled.
    ``expected(joint)`` (K, F) are sums of what is eliminated that are 0 within one standard
    deviation: further rows, of block -1.
    """
    count = regressors.shape[2]
    normal = np.diag(np.broadcast_to(precision, count).astype(float))
    right = normal @ np.broadcast_to(pull, count)
    pieces = []
    for j, (rows, root) in enumerate(weighting):
        own, samples = friction(j, rows) * root[:, None], len(root)
        own = own if expected is None else np.concatenate([own, expected(j)])
        basis, size, _ = np.linalg.svd(own, full_matrices=False)
        basis = basis[:, size > _SAME * size[:1]]
        further = len(own) - samples
        scaled = np.pad(regressors[rows, j] * root[:, None], ((0, further), (0, 0)))
        target = np.pad(torque[rows, j] * root, (0, further))
        scaled = scaled - basis @ (basis.T @ scaled)
        target = target - basis @ (basis.T @ target)
        normal += scaled.T @ scaled
        right += scaled.T @ target
        pieces.append((scaled, target, np.pad(block[rows], (0, further), constant_values=-1),
                       basis))
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values = np.linalg.lstsq(normal / np.outer(size, size), right / size, rcond=1e-10)[0] / size
    return values, normal, pieces


def block_scores(pieces: Sequence, values: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the `unshrunk` scores (blocks, B) at ``values`` of what `regress` returns."""
    half = root_of_inverse(normal)
    count = 1 + max(block.max(initial=0) for _, _, block, _ in pieces)
    at = own = len(half)
    total = at + sum(basis.shape[1] for *_, basis in pieces)
    scores, share = np.zeros((count, total)), np.zeros((count, total, total))
    for scaled, target, block, basis in pieces:
        columns, left = np.concatenate([scaled @ half, basis], axis=1), target - scaled @ values
        places = np.r_[:own, at:at + basis.shape[1]]
        at += basis.shape[1]
        for k in np.unique(block[block >= 0]):
            rows = columns[block == k]
            scores[k, places] += rows.T @ left[block == k]
            share[k][np.ix_(places, places)] += rows.T @ rows
    return np.linalg.solve(half.T, unshrunk(scores, share)[:, :own].T).T


def weighting_of(regressors, torque, rate, friction: Callable, group=None) -> list:
    """
    Return for each joint where it moves (S,) and the roots of the weights there.

    Each ``group`` (S,) of rows, such as a recording, counts by its own noise: what friction
    leaves, or friction and regressors together where rows are enough for these.
    """
    found = []
    for j in range(torque.shape[1]):
        rows = np.abs(rate[:, j]) > SLOWEST * np.sqrt(np.mean(rate[:, j] ** 2))
        own = friction(j, rows)
        both = np.concatenate([regressors[rows, j], own], axis=1)
        weights, scale = min((robust(
            columns[:, columns.any(axis=0)], torque[rows, j],
            None if group is None else group[rows]) for columns in (own, both)),
            key=lambda one: np.median(one[1]) if rows.any() else 0.0)
        found.append((rows, np.sqrt(weights) / scale))
    return found
