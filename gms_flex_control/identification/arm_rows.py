# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Samples of recordings for a regression of an arm in space, behind one low-pass."""

from typing import NamedTuple

from gms_flex_control.data.signal_analysis import low_pass
from gms_flex_control.dynamics import chain
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.arm_differences import (
    beyond_own,
    coupled_motors,
    plain_friction,
)
from gms_flex_control.identification.axis_fit import friction_regressors
from gms_flex_control.identification.inertial_parameters import link_regressors
from gms_flex_control.identification.objective import BLOCK_TIME
from gms_flex_control.identification.segments import filled, segments_of, torque_at_samples
from gms_flex_control.params.arm import carrying
import numpy as np
from scipy.ndimage import uniform_filter1d

_THINNING = 8       # samples of a smoothing window that are enough
_STEP = 1e-5        # of a zero, for slopes [rad]
_TURNED = (0.003, 0.01, 0.03)  # s at the usual rate: how far from a reversal friction turns over


class Rows(NamedTuple):
    """Samples of all recordings."""

    regressor: np.ndarray  # (S, n, B)
    tip: np.ndarray        # (S, n, 10) of a load's ten numbers in the frame of the last link
    known: np.ndarray      # (S, n) torque of what is known [N m]
    slope: np.ndarray      # (S, n, n) of joint j by the angle of joint i [N m/rad]
    torque: np.ndarray     # (S, n) as recorded
    change: np.ndarray     # (S, n) of the torque over time [N m/s]
    friction: np.ndarray   # (S, n, 8)
    turning: np.ndarray    # (S, n, 3) of friction that lags behind a reversal
    coupled: np.ndarray    # (S, n, 2 M) of friction of M motors that several joints turn
    rate: np.ndarray       # (S, n)
    block: np.ndarray      # (S,) int, of time
    recording: np.ndarray  # (S,) int


def rows_of(recordings, robot, sides, arm, lead, slopes_of) -> tuple:
    """
    Return the Rows of recordings, ``slopes_of`` the arms of the slopes, and usual rates.

    Raises IdentificationError where the low-pass leaves nothing of a recording.
    """
    pieces = [(r, segment) for r, recording in enumerate(recordings)
              for segment in segments_of(recording, robot, sides)]
    usual = np.sqrt(np.mean(np.concatenate([one.rate for _, one in pieces]) ** 2, axis=0))
    motors = coupled_motors(recordings)
    parts, used, several = [], 0, len(recordings) > 1
    for r, segment in pieces:
        part = _segment_rows(segment, arm, lead, recordings[r], usual, motors,
                             slopes_of[r] if several else None)
        if part is not None:
            parts.append((*part[:-1], part[-1] + used, np.full(len(part[-1]), r)))
            used = parts[-1][-2][-1] + 1
    short = set(range(len(recordings))).difference(part[-1][0] for part in parts)
    if short:
        raise IdentificationError(
            f'{recordings[min(short)].source}: its pieces without a gap are too short for the '
            'filter of the regression; record longer')
    return Rows(*(np.concatenate(part) for part in zip(*parts, strict=True))), usual


def _segment_rows(segment, arm, lead, recording, usual, motors, slopes_of):
    """
    Return what Rows has of a segment but the recording, blocks counted from 0.

    None of a segment so short that the low-pass sees its ends everywhere.
    """
    every = 2 * (segment.window // (2 * _THINNING)) + 1
    window = max(segment.window // every, 1)
    motion, torque = _differences(segment, every, recording.period)
    angle = motion[0]
    if len(angle) <= 4 * window:
        return None
    rate = np.ascontiguousarray(segment.rate[every:-every:every][:len(angle)])
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
    friction = np.stack([friction_regressors(*one) for one in zip(rate.T, usual, strict=True)],
                        axis=1)
    turning = np.stack([_turning(*one) for one in zip(angle.T, rate.T, usual, strict=True)],
                       axis=1)
    coupled = np.zeros((*rate.shape, 0))
    for m in motors:
        own = plain_friction(rate @ recording.coupling[m])
        coupled = np.concatenate([coupled, own[:, None] * recording.coupling[m][:, None]], axis=2)
    regressor, tip, known, slope, friction, turning, coupled = (low_pass(one, window) for one in (
        regressor, tip, known, slope, friction, turning, coupled))
    block = (every * np.arange(len(rate)) * recording.period / BLOCK_TIME).astype(int)
    inner = slice(2 * window, -2 * window, max(window // 2, 1))
    change = np.gradient(torque, every * recording.period, axis=0)
    return tuple(part[inner] for part in (regressor, tip, known, slope, torque, change, friction,
                                          turning, coupled, rate, block))


def _turning(angle, rate, usual):
    """
    Return columns (S, 3) of friction that turns over along the way from a reversal.

    Presliding, and friction that lags behind its curve: where a joint reverses it accelerates
    most, so what is left out here is taken for inertia.
    """
    way = np.sign(rate)
    turns = np.concatenate([[True], way[1:] * way[:-1] < 0.0])
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))])
    since = travelled - np.maximum.accumulate(np.where(turns, travelled, 0.0))
    return way[:, None] * np.exp(-since[:, None] / (usual * np.array(_TURNED)))


def _differences(segment, every, period):
    """
    Return angle, rate and acceleration (S, n) of every so many samples, and the torque there.

    Of a torque that is held between samples, a second difference of the angle is the mean over
    both sides, weighted by a triangle; the torque is weighted likewise, so that no filter comes
    between them.
    """
    torque = torque_at_samples(segment)
    for _ in range(2):  # a triangle
        torque = uniform_filter1d(torque, every, axis=0, mode='nearest')
    angle, torque = (uniform_filter1d(one, every, axis=0, mode='nearest')[::every]
                     for one in (filled(segment.angle), torque))
    before, at, after, step = angle[:-2], angle[1:-1], angle[2:], every * period
    motion = at, (after - before) / (2.0 * step), (after - 2.0 * at + before) / step ** 2
    return tuple(map(np.ascontiguousarray, motion)), torque[1:-1]
