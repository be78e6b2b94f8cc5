# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Base parameters of a planar chain, and the physical arm nearest to them.

The torque of a chain is linear in ``A_ij`` and the moments of dynamics.chain, and these are all
that motion identifies: masses, centres of mass and inertias of their own only as far as they make
these. The arm is then the one with positive masses and inertias that fits best, as close to the
one described as the data allow.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from gms_flex_control.dynamics.chain import constants_of
from gms_flex_control.identification.axis_fit import filtered, friction_regressors
from gms_flex_control.identification.outcome import CONFIDENT, estimated
from gms_flex_control.identification.robust_regression import robust
from gms_flex_control.identification.uncertainty import block_sums, root_of_inverse, unshrunk
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import RobotParams
import numpy as np
from scipy.optimize import least_squares

_SLOWEST = 0.05
_PRIOR_SD = 1.0     # of masses and inertias around those described, of logarithms
_COM_SD = 0.2       # of the link's length: of the centre of mass
_WIDE = 0.5
_SAME = 1e-9        # of the largest singular value: no column of its own
_DETERMINED = 0.95  # share of a parameter that the data must determine


def _base_names(n, has_gravity):
    """Return names and units of the base parameters of a chain of n joints."""
    names = [(f'arm.coupling_{i + 1}{k + 1}', 'kg m^2') for i in range(n) for k in range(i, n)]
    return names + [(f'arm.moment_{i + 1}', 'kg m') for i in range(n) if has_gravity]


def base_values(arm: ArmParams, has_gravity: bool) -> np.ndarray:
    """Return the base parameters (B,) of an arm; moments among them with gravity."""
    chain = constants_of(arm)
    upper = np.triu_indices(arm.n_joints)
    return np.concatenate([chain.coupling[upper], chain.moment if has_gravity else []])


def base_regressors(angle, rate, acceleration, arm: ArmParams, has_gravity: bool) -> np.ndarray:
    """
    Return the torque of each joint per unit of each base parameter (S, n, B).

    Along angles, rates and accelerations (S, n); the arm gives gravity and where joints read 0.
    """
    chain, n = constants_of(arm), arm.n_joints
    theta = angle @ chain.orientation.T + chain.offset
    omega, alpha = rate @ chain.orientation.T, acceleration @ chain.orientation.T
    columns = []
    for i in range(n):
        for k in range(i, n):
            torque = np.zeros(theta.shape)
            between = theta[:, i] - theta[:, k]
            torque[:, i] = np.cos(between) * alpha[:, k] + np.sin(between) * omega[:, k] ** 2
            torque[:, k] = np.cos(between) * alpha[:, i] - np.sin(between) * omega[:, i] ** 2
            columns.append(torque @ chain.orientation)
    for i in range(n if has_gravity else 0):
        torque = np.zeros(theta.shape)
        torque[:, i] = (chain.gravity[0] * np.sin(theta[:, i])
                        - chain.gravity[1] * np.cos(theta[:, i]))
        columns.append(torque @ chain.orientation)
    return np.stack(columns, axis=2)


def fit_chain(recordings: Sequence, robot: RobotParams, drives: Sequence) -> tuple:
    """
    Return the arm of a planar chain that is nearest to data and description, and errors (B,).

    Lengths, offsets, gravity and motors of rigid joints are kept. ``drives`` are Recording ->
    torque (T,) on each joint; the standard errors are of the base parameters.
    """
    arm, n = robot.arm, robot.n_joints
    has_gravity = bool(arm.gravity.any())
    angle, rate, acceleration, torque, block = _filtered(recordings, drives, n)
    torque = torque - np.where(arm.rigid, arm.motor_inertia, 0.0) * acceleration
    regressors = base_regressors(angle, rate, acceleration, arm, has_gravity)
    values, normal, pieces = regress(regressors, torque, rate, block,
                                     lambda j, rows: friction_regressors(rate[rows, j]))
    covariance = _sandwich(normal, pieces, values)
    found = nearest_arm(arm, values, np.linalg.pinv(covariance, rcond=1e-10, hermitian=True),
                        has_gravity)
    return found, np.sqrt(np.diag(covariance))


def regress(regressors, torque, rate, block, friction: Callable, precision=0.0, pull=0.0,
            weighting=None) -> tuple:
    """
    Return weighted least squares of the torque (S, n) of all joints on regressors (S, n, B).

    Each joint counts by its own noise, robustly, where it moves at ``rate`` (S, n); its friction,
    columns ``friction(joint, rows)``, is eliminated. ``precision`` (B,) is that of priors at
    ``pull`` (B,); ``weighting`` is that of `weighting_of` unless given. The values (B,), their
    normal matrix (B, B) and, for each joint, regressors, torque, numbers of blocks of time and an
    orthonormal basis of what was eliminated, scaled.
    """
    count = regressors.shape[2]
    normal = np.diag(np.broadcast_to(precision, count).astype(float))
    right = normal @ np.broadcast_to(pull, count)
    pieces = []
    for j, (rows, root) in enumerate(weighting or weighting_of(regressors, torque, rate,
                                                               friction)):
        basis, size, _ = np.linalg.svd(friction(j, rows) * root[:, None], full_matrices=False)
        basis = basis[:, size > _SAME * size[:1]]
        scaled, target = regressors[rows, j] * root[:, None], torque[rows, j] * root
        scaled = scaled - basis @ (basis.T @ scaled)
        target = target - basis @ (basis.T @ target)
        normal += scaled.T @ scaled
        right += scaled.T @ target
        pieces.append((scaled, target, block[rows], basis))
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values = np.linalg.lstsq(normal / np.outer(size, size), right / size, rcond=1e-10)[0] / size
    return values, normal, pieces


def block_scores(pieces: Sequence, values: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the `unshrunk` scores (blocks, B) at ``values`` of what `regress` returns."""
    half, count = root_of_inverse(normal), 1 + max(block.max() for _, _, block, _ in pieces)
    at = own = len(half)
    total = at + sum(basis.shape[1] for *_, basis in pieces)
    scores, share = np.zeros((count, total)), np.zeros((count, total, total))
    for scaled, target, block, basis in pieces:
        columns, left = np.concatenate([scaled @ half, basis], axis=1), target - scaled @ values
        places = np.r_[:own, at:at + basis.shape[1]]
        at += basis.shape[1]
        for k in np.unique(block):
            rows = columns[block == k]
            scores[k, places] += rows.T @ left[block == k]
            share[k][np.ix_(places, places)] += rows.T @ rows
    return np.linalg.solve(half.T, unshrunk(scores, share)[:, :own].T).T


def weighting_of(regressors, torque, rate, friction: Callable, group=None) -> list:
    """
    Return for each joint where it moves (S,) and the roots of the weights there.

    Each ``group`` (S,) of rows, such as a recording, counts by its own noise.
    """
    found = []
    for j in range(torque.shape[1]):
        rows = np.abs(rate[:, j]) > _SLOWEST * np.sqrt(np.mean(rate[:, j] ** 2))
        columns = np.concatenate([regressors[rows, j], friction(j, rows)], axis=1)
        columns = columns[:, columns.any(axis=0)]
        weights, scale = robust(columns, torque[rows, j], None if group is None else group[rows])
        found.append((rows, np.sqrt(weights) / scale))
    return found


def _filtered(recordings, drives, n):
    parts = []
    for channels, block in filtered(recordings, lambda one: (
            one.q_link.T, [drive(one) for drive in drives])):
        parts.append([*(np.stack([getattr(part, name) for part in channels[:n]], axis=1)
                        for name in ('value', 'first', 'second')),
                      np.stack([part.value for part in channels[n:]], axis=1), block])
    return [np.concatenate(part) for part in zip(*parts, strict=True)]


def _sandwich(normal, pieces, values):
    """Return the covariance (B, B) if only blocks of time are independent."""
    inverse = np.linalg.pinv(normal, rcond=1e-10, hermitian=True)
    middle = np.zeros(normal.shape)
    for scaled, target, block, _ in pieces:
        sums = block_sums(scaled * (target - scaled @ values)[:, None], block)
        middle += sums.T @ sums
    return inverse @ middle @ inverse + 1e-8 * np.diag(values ** 2)


def nearest_arm(arm: ArmParams, values: np.ndarray, precision: np.ndarray,
                has_gravity: bool) -> ArmParams:
    """
    Return the arm of positive masses and inertias that makes base parameters (B,) best.

    ``precision`` (B, B) says how sure they are; what the data leave open stays near ``arm``.
    """
    n, root = arm.n_joints, np.linalg.cholesky(
        precision + 1e-12 * np.diag(np.diag(precision) + 1e-300)).T
    reach = np.maximum(arm.length, np.abs(arm.com))

    def changed(x):
        return replace(arm, mass=arm.mass * np.exp(x[:n]),
                       inertia=arm.inertia * np.exp(x[n:2 * n]),
                       com=arm.com + reach * _COM_SD * x[2 * n:])

    def residual(x):
        return np.concatenate([root @ (base_values(changed(x), has_gravity) - values),
                               x / _PRIOR_SD])
    return changed(least_squares(residual, np.zeros(3 * n)).x)


def base_estimates(values, covariance, determined, n: int, has_gravity: bool) -> tuple:
    """Return the Estimates of base parameters (B,), ``determined`` (B,) their share."""
    rows = []
    for (name, unit), value, variance, share in zip(
            _base_names(n, has_gravity), values, np.diag(covariance), determined, strict=True):
        error = float(np.sqrt(variance))
        known = CONFIDENT * error < _WIDE * abs(value) and share > _DETERMINED
        rows.append(estimated(name, unit, value, error, (
            'a base parameter: masses, centres of mass and inertias count only as far as they '
            'make it') if known else (
            'only its sum with others is identifiable where the joints move one at a time: '
            'faster motion of all joints together identifies it'), bool(known)))
    return tuple(rows)
