# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How badly parameters predict the encoders, with gradient and curvature, block by block."""

from dataclasses import dataclass
from typing import NamedTuple

from gms_flex_control import records
from gms_flex_control.dynamics import chain
from gms_flex_control.friction import gms
from gms_flex_control.identification.coordinates import friction_record, MOST_BLOCKS
from gms_flex_control.simulation import plant, predictor
import numpy as np

BLOCK_TIME = 2.0      # samples are pooled over this for errors that are not independent [s]
SETTLE_TIME = 0.5     # at the beginning of a piece, when the blocks' load is not known [s]
_LOAD_PER_STEP = 0.035  # of F_c: torque the observer corrects with per step of the encoder
_SLOWEST, _FASTEST = 2.0, 60.0  # of the observer [rad/s]
_FASTEST_STEP = 0.3   # radians of the observer per sample
_FLOOR = 0.05         # of half a count: errors below it are as good as none


class Bundle(NamedTuple):
    """All data of a fit and how they are looked at."""

    stretches: tuple     # of Stretch
    arm: object          # ArmParams the links move by
    period: float        # [s]
    half: np.ndarray     # half an encoder count (n,) [rad]
    observer: np.ndarray  # bandwidth per joint (n,) [rad/s]
    extras: tuple        # per joint a function Stretch -> (T, R) of further torques, or None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """
    Cost of one joint's parameters.

    Parameters
    ----------
    cost : ndarray, shape (B,)
        Robust cost of each block of samples, in units of ``scale`` squared.
    gradient : ndarray, shape (B, P)
        Of each block.
    curvature : ndarray, shape (B, P, P)
        Gauss-Newton curvature of each block.
    count : ndarray, shape (B,)
        Samples of each block.
    scale : float
        Innovation that counts as usual [rad].
    spread : float
        Median size of the innovations that are not zero [rad].

    """

    cost: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    count: np.ndarray
    scale: float
    spread: float


def observer_bandwidth(arm, coulomb, half, noise, period):
    """
    Return the bandwidth of the predictor's observer.

    Parameters
    ----------
    arm : ArmParams
        Inertia of the links.
    coulomb : ndarray, shape (n_joints,)
        Rough friction level [N m].
    half : ndarray, shape (n_joints,)
        Half an encoder count [rad].
    noise : ndarray, shape (n_joints,)
        Noise of the angle [rad].
    period : float
        Sample [s].

    Returns
    -------
    ndarray, shape (n_joints,)
        [rad/s], so slow that an encoder step corrects by a small part of the friction.

    """
    still = np.zeros(arm.n_joints)
    inertia = np.diag(chain.matrices(still, still, still, still, arm).mass)
    step = np.maximum(2.0 * half, 3.0 * noise)
    wanted = np.sqrt(_LOAD_PER_STEP * coulomb / (inertia * np.maximum(step, 1e-12)))
    return np.clip(wanted, _SLOWEST, min(_FASTEST, _FASTEST_STEP / period))


def robust_scale(spread, half):
    """Return the innovation that counts as usual, from the spread of those not zero [rad]."""
    return max(1.5 * spread, _FLOOR * 2.0 * half, 1e-12)


class Objective:
    """
    Evaluates parameters of one joint against all data.

    Parameters
    ----------
    bundle : Bundle
        The data.
    joint : int
        Whose parameters move.
    others : sequence of ndarray
        Parameters of all joints; those of ``joint`` are not used.
    chosen : callable, optional
        Stretch -> bool (T,) of the samples that count; default those of tests of the joint.

    """

    def __init__(self, bundle, joint, others, chosen=None):
        self._bundle, self.joint, self._others = bundle, joint, list(others)
        self._chosen = chosen
        self._links = chain.constants_of(bundle.arm)

    def predict(self, stretch, theta, directions, sharpness):
        """Return predicted angles, innovations (T, n) and jacobian (T, P) of a stretch."""
        bundle, n = self._bundle, stretch.angle.shape[1]
        extra = self.extra(stretch)
        bandwidth = np.minimum(sharpness * bundle.observer, _FASTEST_STEP / bundle.period)
        samples, width = len(stretch.angle), directions.shape[1]
        predicted, innovation = np.empty((2, samples, n))
        jacobian = np.empty((samples, width))
        predictor.predict(
            stretch.angle, np.ascontiguousarray(stretch.rate[0]), stretch.torque, extra,
            theta[len(theta) - extra.shape[1]:], bundle.period, self._links,
            self.friction(theta), self.joint, np.ascontiguousarray(directions),
            np.stack([2.0 * bandwidth, bandwidth ** 2]), bundle.half,
            records.build(gms.state_layout(n, MOST_BLOCKS)), plant.workspace(n), predicted,
            innovation, jacobian)
        return predicted, innovation, jacobian

    def extra(self, stretch):
        """Return the further torques per unit of their coefficients, shape (T, R)."""
        make = self._bundle.extras[self.joint]
        return np.zeros((len(stretch.angle), 0)) if make is None else make(stretch)

    def friction(self, theta):
        """Return the constants of all joints, ``theta`` those of this one."""
        thetas = list(self._others)
        thetas[self.joint] = theta
        return friction_record(thetas)

    def counted(self, stretch):
        """Return which samples count, bool (T,)."""
        chosen = stretch.tested[:, self.joint].copy() if self._chosen is None else self._chosen(
            stretch) & stretch.tested[:, self.joint]
        chosen[:round(SETTLE_TIME / self._bundle.period)] = False
        return chosen & np.isfinite(stretch.angle[:, self.joint])

    def evaluate(self, coordinates, free, sharpness, scale=None):
        """
        Return the Evaluation of free numbers.

        Parameters
        ----------
        coordinates : Coordinates
            What they stand for.
        free : ndarray, shape (P,)
            The numbers.
        sharpness : float
            Factor on the observer's bandwidth.
        scale : float, optional
            Innovation that counts as usual [rad]; by default from the innovations themselves.

        """
        theta, directions = coordinates.unpack(free)
        pieces = [(stretch, counted) for stretch in self._bundle.stretches
                  if (counted := self.counted(stretch)).any()]
        scale = scale or self._scale(pieces, theta, sharpness)
        sizes, pools = [], []
        for stretch, counted in pieces:
            _, innovation, jacobian = self.predict(stretch, theta, directions, sharpness)
            error = innovation[:, self.joint]
            sizes.append(np.abs(error[counted]))
            pools += _pools(counted, error / scale, jacobian, scale, self._bundle.period)
        return Evaluation(*(np.array(part) for part in zip(*pools, strict=True)), scale,
                          _spread(sizes))

    def scale_of(self, evaluation):
        """Return the scale [rad] that the innovations of an Evaluation call for."""
        return robust_scale(evaluation.spread, self._bundle.half[self.joint])

    def _scale(self, pieces, theta, sharpness):
        """Return the scale of the innovations, from a run without derivatives."""
        none = np.zeros((len(theta), 0))
        sizes = [np.abs(self.predict(stretch, theta, none, sharpness)[1][counted, self.joint])
                 for stretch, counted in pieces]
        return robust_scale(_spread(sizes), self._bundle.half[self.joint])


def _spread(sizes):
    sizes = np.concatenate(sizes)
    sizes = sizes[sizes > 0.0]
    return float(np.median(sizes)) if len(sizes) else 0.0


def _pools(counted, error, jacobian, scale, period):
    """Yield cost, gradient, curvature and count of each block of samples."""
    length = max(round(BLOCK_TIME / period), 1)
    for begin in range(0, len(counted), length):
        rows = slice(begin, begin + length)
        keep = counted[rows] & (error[rows] != 0.0)
        if not counted[rows].any():
            continue
        off, slope = error[rows][keep], jacobian[rows][keep] / scale
        root = np.sqrt(1.0 + off ** 2)  # pseudo-Huber
        weighted = slope / np.sqrt(root)[:, None]
        yield (2.0 * np.sum(root - 1.0), slope.T @ (off / root), weighted.T @ weighted,
               int(counted[rows].sum()))
