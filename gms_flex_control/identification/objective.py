# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How badly parameters predict the encoders, with gradient and curvature, block by block."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.data.signal_analysis import BLOCK_TIME, FRICTION_FOLDS
from gms_flex_control.dynamics import chain
from gms_flex_control.identification.coordinates import friction_record, MOST_BLOCKS
from gms_flex_control.identification.segments import (
    filled,
    moving,
    own_inertias,
    Segment,
    SETTLE_TIME,
    smooth_angle,
    torque_at_samples,
)
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.simulation import plant, predictor
import numpy as np

_LOAD_PER_STEP = 0.3  # of F_c: torque the observer corrects with per step of the encoder
_SLOWEST, _FASTEST = 2.0, 100.0  # of the observer [rad/s]
_FASTEST_STEP = 0.3   # radians of the observer per sample
_EXPLAINED = 0.3      # of the usual innovation: a block this much better is explained
_FINEST = 0.01        # of a count, likewise
_TORQUE_MEMORY = 0.1  # of what a fit leaves of the torque, at least [s]


class Bundle(NamedTuple):
    """All data of a fit and how they are looked at."""

    segments: tuple      # of Segment
    arm: ArmParams       # the links move by it
    period: float        # [s]
    half: np.ndarray     # half an encoder count (n,) [rad]
    observer: np.ndarray  # bandwidth per joint (n,) [rad/s]
    extras: tuple        # per joint a function Segment -> (T, R) of further torques, or None

    def judged(self, segment: Segment, joint: int, step: float) -> np.ndarray:
        """Return where torque judges a joint, of encoder ``step`` or noise [rad], bool (T,)."""
        return segment.tested[:, joint] & moving(segment, joint, step, self.half[joint])


def torque_memory(period: float, windows: Sequence[int]) -> float:
    """Return how many samples an error of torque lasts behind low-passes of such ``windows``."""
    return max(_TORQUE_MEMORY / period, *(2.0 * window for window in windows))


def block_length(period: float) -> int:
    """Return the samples of a block of time."""
    return max(round(BLOCK_TIME / period), 1)


def blocks_of(segment: Segment, period: float) -> np.ndarray:
    """Return the number of each sample's block of time, int (T,)."""
    return segment.first_block + np.arange(len(segment.angle)) // block_length(period)


def held_out(period: float, turn=0) -> Callable:
    """Return a function Segment -> bool (T,) of the samples not to be fitted in a turn."""
    return lambda segment: (blocks_of(segment, period) % FRICTION_FOLDS
                            == FRICTION_FOLDS - 1 - turn)


def train(period: float, turn=0) -> Callable:
    """Return a function Segment -> bool (T,) of the samples to be fitted in a turn."""
    out = held_out(period, turn)
    return lambda segment: ~out(segment)


def everything(segment: Segment) -> np.ndarray:
    """Return that all samples (T,) are chosen."""
    return np.ones(len(segment.angle), dtype=bool)


def numbered(segments: Sequence[Segment], period: float) -> list[Segment]:
    """Return segments with their blocks of time numbered; the last of few is held out."""
    counts = [max(len(segment.angle) * period // BLOCK_TIME, 1.0) for segment in segments]
    begin = max(FRICTION_FOLDS - int(sum(counts)), 0)
    firsts = begin + np.concatenate([[0], np.cumsum(counts)]).astype(int)
    return [replace(segment, first_block=int(first))
            for segment, first in zip(segments, firsts[:-1], strict=True)]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Innovations of one joint in B blocks of time, and how P parameters would change them."""

    square: np.ndarray     # (B,), mean square of the innovations [rad^2]
    gradient: np.ndarray   # (B, P), sum of derivative of the prediction times innovation
    curvature: np.ndarray  # (B, P, P), sum of derivative times derivative
    count: np.ndarray      # (B,), samples
    seen: np.ndarray       # (B,), samples whose innovation is not zero
    floor: float           # innovation below which a block counts as explained [rad]

    @property
    def dispersion(self) -> float:
        """Return the weighted square of an innovation that is not zero, on average."""
        return float(np.sum(self.weight * self.square * self.count) / max(self.seen.sum(), 1))

    @property
    def cost(self) -> np.ndarray:
        """
        Return the cost of each block, shape (B,).

        Every block has a noise level of its own, unknown: its likelihood, the level profiled
        out, is ``count / 2 log(square)``. So blocks at rest, where a prediction is right to a
        hundredth of a count, are not drowned by fast ones, and a disturbed one spoils little.
        """
        return 0.5 * self.count * np.log1p(self.square / self.floor ** 2)

    @property
    def weight(self) -> np.ndarray:
        """Return the weight of each block, the inverse of its variance, shape (B,) [1/rad^2]."""
        return 1.0 / (self.floor ** 2 + self.square)


def coarser(bundle: Bundle, period: float) -> Bundle:
    """Return a bundle sampled no more often than every ``period`` [s], torques averaged."""
    factor = int(period / bundle.period * (1.0 + 1e-6))
    if factor <= 1:
        return bundle
    return bundle._replace(period=factor * bundle.period, segments=tuple(
        _thinned(segment, factor) for segment in bundle.segments))


def _thinned(segment, factor):
    samples = len(segment.angle) // factor * factor
    thin = {name: getattr(segment, name)[:samples:factor]
            for name in ('angle', 'rate', 'acceleration', 'tested', 'phase')}
    means = {name: getattr(segment, name)[:samples].reshape(
        -1, factor, segment.torque.shape[1]).mean(axis=1) for name in ('torque', 'factor')}
    return replace(segment, window=max(segment.window // factor, 1), **thin, **means)


def observer_bandwidth(arm: ArmParams, coulomb, half, noise, period: float) -> np.ndarray:
    """
    Return the bandwidth of the predictor's observer (n,) [rad/s].

    So slow that an encoder step corrects by a small part of the friction level ``coulomb`` (n,)
    [N m]; ``half`` an encoder count and ``noise`` of the angle (n,) [rad], sample ``period`` [s].
    """
    inertia = own_inertias(arm)
    step = np.maximum(2.0 * half, 3.0 * noise)
    wanted = np.sqrt(_LOAD_PER_STEP * coulomb / (inertia * np.maximum(step, 1e-12)))
    return np.clip(wanted, _SLOWEST, min(_FASTEST, _FASTEST_STEP / period))


def friction_torque(segment: Segment, arm: ArmParams) -> np.ndarray:
    """
    Return the friction torque of each link by its equation of motion, (T, n_joints) [N m].

    It opposes positive motion. Eq. (1), link: ``F_f = K (q2 - q1) - M q1'' - C q1' - g``; the
    arm is rigid where the motor's torque drives the link.
    """
    angle = filled(segment.angle)
    return torque_at_samples(segment) - chain.inverse_dynamics(
        angle, segment.rate, segment.acceleration, arm)


def friction_along(segment: Segment, joint: int, period: float) -> Callable:
    """Return a function of a joint's parameters: its friction (T,) along smoothed motion [N m]."""
    rate, factor = segment.rate[:, [joint]], segment.factor[:, joint]
    angle = smooth_angle(rate, period)
    return lambda theta: factor * gms.replay(angle, rate, period, friction_record([theta]))[:, 0]


class Objective:
    """
    Evaluates parameters of one joint against all data of a Bundle.

    ``thetas`` are the parameters of all joints, those of ``joint`` unused; ``chosen`` Segment ->
    bool (T,) are the samples that count, by default those of tests of the joint. All links of a
    chain move; of axes that do not act on each other only the joint's own.
    """

    def __init__(self, bundle: Bundle, joint: int, thetas: Sequence[np.ndarray], chosen=None):
        self.bundle, self.joint, self.thetas, self._chosen = bundle, joint, list(thetas), chosen
        together = bundle.arm.kind == 'planar'
        self._moved = list(range(bundle.arm.n_joints)) if together else [joint]
        self._own = self._moved.index(joint)
        self._links = chain.constants_of(bundle.arm if together else bundle.arm.axis(joint))
        self._carried = np.array([self._own, *(k for k in range(len(self._moved))
                                               if k != self._own)])

    def of(self, chosen=None, bundle=None) -> Self:
        """Return the Objective of ``chosen`` samples, default all, of a Bundle or its own."""
        return Objective(bundle or self.bundle, self.joint, self.thetas, chosen)

    def predict(self, segment, theta, directions=None,
                sharpness=1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return predicted angles, innovations (T,) and their Jacobian (T, P), contiguous."""
        directions = np.zeros((len(theta), 0)) if directions is None else directions
        samples, n, width = len(segment.angle), len(self._moved), directions.shape[1]
        predicted, innovation = np.empty((2, samples, n))
        jacobian = np.empty((samples, width))
        predictor.predict(
            *self._given(segment, theta), self._carried if width else self._carried[:1],
            np.ascontiguousarray(directions), *self._observer(sharpness),
            records.build(gms.state_layout(n, MOST_BLOCKS)), plant.workspace(n), predicted,
            innovation, jacobian)
        return predicted[:, self._own], innovation[:, self._own], jacobian

    def simulate_freely(self, segment, theta, first: int, stride: int, horizon: int,
                        starts: int) -> np.ndarray:
        """Return the joint's angles (starts, horizon) of `predictor.simulate_freely`."""
        n = len(self._moved)
        predicted, blocks = np.empty((starts, horizon, n)), gms.state_layout(n, MOST_BLOCKS)
        predictor.simulate_freely(
            *self._given(segment, theta), self._own, *self._observer(), first, stride, horizon,
            records.build(blocks), records.build(blocks), plant.workspace(n), predicted)
        return predicted[:, :, self._own]

    def resistance_along(self, segment) -> Callable:
        """Return a function of parameters: friction (T,) as `friction_along`, less others."""
        friction = friction_along(segment, self.joint, self.bundle.period)
        extra = self.extra(segment)
        return lambda theta: friction(theta) - extra @ theta[len(theta) - extra.shape[1]:]

    def resistance(self, segment, theta) -> np.ndarray:
        """Return friction of the joint (T,) along the smoothed motion, less further torques."""
        return self.resistance_along(segment)(theta)

    def measured(self, segment) -> np.ndarray:
        """Return what the joint's equation of motion says of its friction (T,) [N m]."""
        return friction_torque(segment, self.bundle.arm)[:, self.joint]

    def _given(self, segment, theta):
        """Return what is known of a segment and its links, as the predictor takes it."""
        extra = self.extra(segment)
        return (*(np.ascontiguousarray(part[..., self._moved]) for part in (
            segment.angle, segment.rate[0], segment.torque, segment.factor)), extra,
            theta[len(theta) - extra.shape[1]:], self.bundle.period, self._links,
            friction_record([theta if k == self.joint else self.thetas[k]
                             for k in self._moved]))

    def _observer(self, sharpness=1.0):
        """Return gains of rate and angle (2, n), so many times as fast if samples allow."""
        bandwidth = np.minimum(sharpness * self.bundle.observer[self._moved],
                               _FASTEST_STEP / self.bundle.period)
        return np.stack([2.0 * bandwidth, bandwidth ** 2]), self.bundle.half[self._moved]

    def extra(self, segment) -> np.ndarray:
        """Return the further torques per unit of their coefficients, shape (T, R)."""
        make = self.bundle.extras[self.joint]
        return (np.zeros((len(segment.angle), 0)) if make is None else
                np.ascontiguousarray(make(segment)))

    def counted(self, segment) -> np.ndarray:
        """Return which samples count, bool (T,)."""
        chosen = segment.tested[:, self.joint].copy() if self._chosen is None else self._chosen(
            segment) & segment.tested[:, self.joint]
        chosen[:round(SETTLE_TIME / self.bundle.period)] = False
        return chosen & np.isfinite(segment.angle[:, self.joint])

    @property
    def counts(self) -> bool:
        """Return whether any sample counts."""
        return any(self.counted(segment).any() for segment in self.bundle.segments)

    def evaluate(self, coordinates, free, sharpness, floor=None, *,
                 derivatives=True) -> Evaluation:
        """
        Return the Evaluation of free numbers.

        ``sharpness`` is a factor on the observer's bandwidth; ``floor`` [rad] is by default as
        `floor_of` finds it here; without ``derivatives`` gradient and curvature have no columns.
        """
        theta, directions = coordinates.unpack(free)
        directions = directions if derivatives else directions[:, :0]
        pools = []
        for segment in self.bundle.segments:
            counted = self.counted(segment)
            if counted.any():
                _, innovation, jacobian = self.predict(segment, theta, directions, sharpness)
                pools += _pools(counted, innovation, jacobian, self.bundle.period)
        arrays = [np.array(part) for part in zip(*pools, strict=True)]
        return Evaluation(*arrays, floor or self.floor_of(arrays[0]))

    def memory(self, coordinates, free, longest: float) -> float:
        """Return how many samples an innovation remembers, up to ``longest`` [s]; 1: white."""
        theta, directions = coordinates.unpack(free)
        period = self.bundle.period
        lags, length = round(longest / period), block_length(period)
        total = np.zeros(lags)
        for segment in self.bundle.segments:
            counted = self.counted(segment)
            if counted.sum() < 2 * lags:
                continue
            error = np.where(counted, self.predict(segment, theta, directions[:, :0])[1], 0.0)
            blocks = np.add.reduceat(error ** 2, np.arange(0, len(error), length))
            level = np.sqrt(np.repeat(blocks, length)[:len(error)] / length)
            scaled = np.divide(error, level, out=np.zeros_like(error), where=level > 0.0)
            power = np.abs(np.fft.rfft(scaled, 2 * len(scaled))) ** 2
            total += np.fft.irfft(power)[:lags]
        if total[0] <= 0.0:
            return 1.0
        correlation = total / total[0]
        end = np.argmax(correlation < 0.05) or lags
        return float(1.0 + 2.0 * correlation[1:end].sum())

    @property
    def fastest(self) -> float:
        """Return the largest speed of the joint [rad/s]."""
        return max(np.abs(one.rate[:, self.joint]).max() for one in self.bundle.segments)

    def floor_of(self, square) -> float:
        """Return the floor [rad] that mean squares of blocks (B,) call for."""
        usual = np.sqrt(np.median(square))
        return max(_EXPLAINED * usual, self.finest, 1e-12)

    @property
    def finest(self) -> float:
        """Return the innovation [rad] below which the steps of the predictor are what errs."""
        return _FINEST * 2.0 * self.bundle.half[self.joint]


def _pools(counted, error, jacobian, period):
    """Yield mean square, gradient, curvature and both counts of each block of samples."""
    length = block_length(period)
    for begin in range(0, len(counted), length):
        rows = slice(begin, begin + length)
        count = int(counted[rows].sum())
        if not count:
            continue
        keep = counted[rows] & (error[rows] != 0.0)
        off, slope = error[rows][keep], jacobian[rows][keep]
        yield off @ off / count, slope.T @ off, slope.T @ slope, count, int(keep.sum())
