# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Samples of recordings for a regression of an arm in space, behind one low-pass.

And the scales of recorded torques of which no constant is known, from the links as described.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.compiled import compiled
from gms_flex_control.data.signal_analysis import BLOCK_TIME, LINKS_WINDOW, low_pass, means_to_next
from gms_flex_control.dynamics import chain
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.arm_differences import (
    beyond_own,
    coupled_motors,
    plain_friction,
)
from gms_flex_control.identification.axis_fit import friction_regressors
from gms_flex_control.identification.inertial_parameters import link_regressors
from gms_flex_control.identification.robust_regression import solution
from gms_flex_control.identification.segments import (
    filled,
    segments_of,
    torque_at_samples,
    while_moved,
)
from gms_flex_control.params.arm import carrying
import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

_THINNING = 8       # samples of a smoothing window that are enough
_STEP = 1e-5        # of a zero, for slopes [rad]
SLIPS = (0.001, 0.002, 0.004, 0.008)  # s at the usual rate: ways after which blocks slip
SPRINGY = (0.03, 0.12, 0.5, 2.0)  # likewise: soft blocks, along a sinusoid much like an inertia
_LOW = (0.1, 0.2, 0.4)  # of the usual rate: how fast a joint leaves its friction at low speed
_BETWEEN = 4        # steps from one sample to the next of a friction that jumps
_LAG = 0.05         # by which that is late, F_c / C of common machines [s]
_SURE = 3.0        # standard errors from which a torque shows what its links require
_DESCRIBED_SD = 0.5  # of the logarithm of a scale, around what the masses described give
_ALIKE_SD = 1.0    # and of scales of the joints of one arm, around each other


class ArmSamples(NamedTuple):
    """Samples of all recordings."""

    regressor: np.ndarray  # (S, n, B)
    tip: np.ndarray        # (S, n, 10) of a load's ten numbers in the frame of the last link
    known: np.ndarray      # (S, n) torque of what is known [N m]
    slope: np.ndarray      # (S, n, n) of joint j by the angle of joint i [N m/rad]
    torque: np.ndarray     # (S, n) as recorded
    change: np.ndarray     # (S, n) of the torque over time [N m/s]
    friction: np.ndarray   # (S, n, 8)
    turning: np.ndarray    # (S, n, K) of friction that lags behind a reversal
    coupled: np.ndarray    # (S, n, 2 M) of friction of M motors that several joints turn
    rate: np.ndarray       # (S, n), 0 of a joint that is held
    acceleration: np.ndarray  # (S, n)
    block: np.ndarray      # (S,) int, of time
    recording: np.ndarray  # (S,) int


def arm_samples(recordings, robot, sides, arm, lead, slopes_of, friction=None,
                slips=SLIPS) -> tuple:
    """
    Return ArmSamples of recordings, ``friction`` (T, n) subtracted, and usual rates; or a refusal.

    ``slips`` are ways after which blocks slip, at the usual rate [s].
    """
    cut = [(r, segment) for r, recording in enumerate(recordings)
           for segment in segments_of(recording, robot, sides)]
    if friction:
        cut = [(r, replace(one, torque=one.torque - means_to_next(
            friction(one, robot.joints, recordings[r].period)))) for r, one in cut]
    pieces = [(r, replace(one, rate=one.rate * one.tested)) for (r, _), one in zip(
        cut, while_moved([one for _, one in cut], recordings, presliding=False), strict=True)]
    usual = np.sqrt(np.mean(np.concatenate([one.rate for _, one in pieces]) ** 2, axis=0))
    usual = np.maximum(usual, 1e-12)  # of a joint that is held everywhere
    motors = coupled_motors(recordings)
    parts, used, several = [], 0, len(recordings) > 1
    for r, segment in pieces:
        part = _segment_samples(segment, arm, lead, recordings[r], (usual, slips), motors,
                                slopes_of[r] if several else None)
        if part is not None:
            parts.append((*part[:-1], part[-1] + used, np.full(len(part[-1]), r)))
            used = parts[-1][-2][-1] + 1
    short = set(range(len(recordings))).difference(part[-1][0] for part in parts)
    if short:
        raise IdentificationError(
            f'{recordings[min(short)].source}: its pieces without a gap are too short for the '
            'filter of the regression; record longer')
    return ArmSamples(*(np.concatenate(part) for part in zip(*parts, strict=True))), usual


def _segment_samples(segment, arm, lead, recording, ways, motors, slopes_of):
    """Return what ArmSamples has of a segment, blocks from 0; None of one too short."""
    every = 2 * (segment.window // (2 * _THINNING)) + 1
    window = max(max(segment.window, round(LINKS_WINDOW / recording.period)) // every, 1)
    motion, torque = _differences(segment, every, recording.period)
    angle = motion[0]
    if len(angle) <= 4 * window:
        return None
    rate = np.ascontiguousarray(segment.rate[every:-every:every][:len(angle)])
    friction, turning, coupled = _friction(segment, every, recording, *ways, motors)
    torque = low_pass(torque, window)
    loaded = carrying(arm, recording.operation.load)
    if len(lead):
        regressor = link_regressors(*motion, arm, recording.coupling)[:, :, lead]
        known = np.zeros(rate.shape)
        if recording.operation.load is not None:
            known = chain.inverse_dynamics(*motion, loaded) - chain.inverse_dynamics(*motion, arm)
    else:
        regressor = np.zeros((*rate.shape, 0))
        known = chain.inverse_dynamics(*motion, loaded)
        if recording.coupling is not None:
            known += beyond_own(motion[2], np.where(arm.rigid, arm.motor_inertia, 0.0),
                                recording.coupling)
    tip = np.zeros((*rate.shape, 10))
    if recording.operation.load_unknown:
        last = 10 * (arm.n_joints - 1)
        tip = link_regressors(*motion, arm)[:, :, last:last + 10]
    slope = np.zeros((*rate.shape, arm.n_joints))
    if slopes_of is not None:
        for i, step in enumerate(_STEP * np.eye(arm.n_joints)):
            # torque of the true angle, which is the reading less the zero
            slope[:, :, i] = (
                chain.inverse_dynamics(angle - step, *motion[1:], slopes_of)
                - chain.inverse_dynamics(angle + step, *motion[1:], slopes_of)) / (2.0 * _STEP)
    regressor, tip, known, slope, friction, turning, coupled, acceleration = (
        low_pass(one, window) for one in (
            regressor, tip, known, slope, friction, turning, coupled, motion[2]))
    block = (every * np.arange(len(rate)) * recording.period / BLOCK_TIME).astype(int)
    inner = slice(2 * window, -2 * window, max(window // 2, 1))
    change = np.gradient(torque, every * recording.period, axis=0)
    return tuple(part[inner] for part in (regressor, tip, known, slope, torque, change, friction,
                                          turning, coupled, rate, acceleration,
                                          block))


def _friction(segment, every, recording, usual, slips, motors):
    """Return regressors of friction (S, n, 8), of what lags behind it, and of coupled motors."""
    period = recording.period / _BETWEEN
    rate, angle = (_interpolated(one) for one in (segment.rate, filled(segment.angle)))

    def weighted(fine):
        fine = uniform_filter1d(fine, 2 * _BETWEEN + 1, axis=0, mode='nearest')
        return _weighted(fine[::_BETWEEN], every)
    friction = np.stack([weighted(friction_regressors(*one)) for one in zip(
        rate.T, usual, strict=True)], axis=1)
    turning = np.stack([weighted(_turning(*one, slips, period)) for one in zip(
        angle.T, rate.T, usual, strict=True)], axis=1)
    coupled = np.zeros((*friction.shape[:2], 2 * len(motors)))
    for k, m in enumerate(motors):
        own = weighted(plain_friction(rate @ recording.coupling[m]))
        coupled[:, :, 2 * k:2 * k + 2] = own[:, None] * recording.coupling[m][:, None]
    return friction, turning, coupled


def _interpolated(values):
    """Return values (S, n) with further ones between the samples."""
    samples = np.arange(len(values))
    fine = np.arange(_BETWEEN * (len(values) - 1) + 1) / _BETWEEN
    return np.stack([np.interp(fine, samples, column) for column in values.T], axis=1)


def _turning(angle, rate, usual, ways, period):
    """
    Return regressors (S, K) of friction that depends on the way and the time before.

    Where a joint reverses it accelerates most: what is left out here is taken for inertia.
    Presliding is that of blocks which slip after given ways, as strong as one likes (Maxwell
    slip), so that a joint may turn again before all of them slip; friction at low speed is late.
    """
    slips, kept = np.empty((len(rate), len(ways))), np.exp(-period / _LAG)
    _slip(angle, usual * np.array(ways), slips)
    low = np.sign(rate)[:, None] * np.exp(-(rate[:, None] / (usual * np.array(_LOW))) ** 2)
    late, _ = lfilter([1.0 - kept], [1.0, -kept], low, axis=0, zi=kept * low[:1])
    return np.concatenate([slips, late], axis=1)


@compiled
def _slip(angle, ways, out) -> None:
    """Write the deflection of blocks over ``ways`` (K,) that they slip at into ``out`` (S, K)."""
    for k in range(ways.shape[0]):
        out[0, k] = 0.0
        for i in range(1, angle.shape[0]):
            at = out[i - 1, k] + (angle[i] - angle[i - 1]) / ways[k]
            out[i, k] = min(max(at, -1.0), 1.0)


def _differences(segment, every, period):
    """
    Return angle, rate and acceleration (S, n) of every so many samples, and the torque there.

    Of a torque that is held between samples, a second difference of the angle is the mean over
    both sides, weighted by a triangle; the torque is weighted likewise, so that no filter comes
    between them.
    """
    angle = uniform_filter1d(filled(segment.angle), every, axis=0, mode='nearest')[::every]
    before, at, after, step = angle[:-2], angle[1:-1], angle[2:], every * period
    motion = at, (after - before) / (2.0 * step), (after - 2.0 * at + before) / step ** 2
    return tuple(map(np.ascontiguousarray, motion)), _weighted(torque_at_samples(segment), every)


def _weighted(values, every):
    """Return values (T, ...) of every so many samples, weighted as `_differences` says."""
    for _ in range(3):  # a triangle, and the mean of which angles are differences
        values = uniform_filter1d(values, every, axis=0, mode='nearest')
    return values[::every][1:-1]


def described_scales(samples: ArmSamples, described: np.ndarray, own: Callable,
                     unknown: Sequence[int], names: Sequence[str]) -> tuple:
    """
    Return what is recorded per true torque, and the prior deviations of its logarithm, (U,) each.

    Of the joints ``unknown`` (U,), beside torques of the links as ``described`` (S, n) [N m].
    Regressors ``own(joint, samples)`` and motor inertia are left open. A joint whose links the
    motion hardly loads is taken to have a scale like the others'. IdentificationError, of the
    torque with its name of ``names`` (n,), where one goes against its links or none shows what
    they require.
    """
    found, error = np.empty((2, len(unknown)))  # a recorded torque per N m of its links
    for k, j in enumerate(unknown):
        regressors = np.concatenate([described[:, j:j + 1], samples.acceleration[:, j:j + 1],
                                     own(j, slice(None))], axis=1)
        (found[k], *_), (error[k], *_) = solution(regressors, samples.torque[:, j], samples.block)
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
