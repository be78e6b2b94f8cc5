# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Friction torque along a recording: what each compensation predicts, and what was measured.

The controller's own code is driven by the recorded motion; friction models are fitted to the first
part of it and judged on the rest. The measured friction is what the link equation lacks,
``F_f = K (q2 - q1) - M q1'' - C q1' - g``.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control import friction as gms
from gms_flex_control.comparison.study import CONTESTANTS, gains_of
from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade, compensation
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.signal_analysis import low_pass
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification import segments
from gms_flex_control.identification.friction_map import friction_torque
from gms_flex_control.params.robot import FrictionParams, RobotParams
from gms_flex_control.simulation import encoder
import numpy as np
from scipy.optimize import least_squares

# whether parameters are fitted, beginning at the friction of the robot's file
_FITTED = {'none': False, 'stribeck': True, 'lugre': True, 'gms_paper': True, 'gms': True,
           'gms_desired': True, 'disturbance_observer': False, 'gms_adaptive': True}

_REMARKS = {'disturbance_observer': 'sees the torque that it predicts, late',
            'gms_adaptive': 'goes on adapting to the torque error while it is judged'}
_MOST_FIT = 40_000   # samples of a fit
_LEAST_SHARE = 0.05  # static above Coulomb friction, and viscous at v_s, where a fit begins
_BOUND = 3.0         # of the logarithm of what a fit scales
_ADAPTATION_RATE = 2.0  # how fast adapted factors take up a torque error that is seen [1/s]


class Piece(NamedTuple):
    """An even part of a recording, T samples of n joints."""

    time: np.ndarray       # (T,) [s]
    period: float          # [s]
    angle: np.ndarray      # (T, n) smoothed without lag [rad]
    rate: np.ndarray       # (T, n) [rad/s]
    reference: np.ndarray  # (T, 5, n); NaN where there is none
    drive: np.ndarray      # (T, n) torque on the links [N m]
    friction: np.ndarray   # (T, n) measured, behind the low-pass [N m]
    window: int            # samples of the smoothing


class Along(NamedTuple):
    """A recording to be predicted, and the robot with joints rigid where motors are not seen."""

    pieces: tuple
    robot: RobotParams
    has_reference: bool


def along(recording, robot) -> Along:
    """
    Return a recording as what friction models are compared on.

    IdentificationError if no piece is long enough or there is no torque.
    """
    sides = segments.drive_sides(recording, robot)
    seen = segments.rigid_where(robot, sides)
    pieces = [_piece(segment, recording, seen) for segment in segments.segments_of(
        recording, robot, sides)]
    return Along(tuple(pieces), seen, all(np.isfinite(one.reference).all() for one in pieces))


def _piece(segment, recording, robot):
    period, samples = recording.period, len(segment.angle)
    time = segment.begin + period * np.arange(samples)
    reference = np.stack([[np.interp(time, recording.time, recording.reference[:, k, j])
                           for j in range(robot.n_joints)] for k in range(5)])
    angle = segments.smooth_angle(segment, period)
    first = [column[np.isfinite(column)][0] for column in segment.angle.T]
    return Piece(
        time, period, angle + first, segment.rate,
        np.ascontiguousarray(np.moveaxis(reference, 2, 0)), segment.torque,
        low_pass(friction_torque(segment, robot.arm), segment.window), segment.window)


@compiled
def _estimate_loop(angle, rate, reference, drive, period, state, measured, constants, work, out):
    """Write F_hat (T, n) of the chosen compensation along a motion into ``out``."""
    for k in range(angle.shape[0]):
        measured.q_link[:], measured.dq_link[:] = angle[k], rate[k]
        cascade.link_errors(state, measured, reference[k], constants, work)
        work.spring[:] = drive[k]
        compensation.estimate(state, measured, reference[k], period if k > 0 else 0.0,
                              constants, work)
        out[k] = work.estimate[0]


def predicted(piece, robot, gains, mode) -> np.ndarray:
    """
    Return the friction (T, n) a compensation predicts along a Piece [N m], before the low-pass.

    Tracking errors correct nothing here: they were another loop's.
    """
    n = robot.n_joints
    chosen = replace(gains_of(gains, mode), observer_gain=np.zeros(n))
    reference = np.where(np.isfinite(piece.reference), piece.reference, 0.0)
    out = np.empty(piece.angle.shape)
    _estimate_loop(piece.angle, piece.rate, reference, piece.drive, piece.period,
                   cascade.init(robot), encoder.init(n), cascade.constants_of(chosen, robot),
                   cascade.workspace(n), out)
    return out


def _adapted(piece, robot, start) -> np.ndarray:
    """
    Return GMS (T, n) along a Piece [N m], each block's factor following the torque error.

    ``start`` (n, N), the factors at its beginning, is changed in place.
    """
    n, out = robot.n_joints, np.empty(piece.angle.shape)
    _adapt_loop(piece.angle, piece.rate, piece.friction, piece.period, gms.init(robot.friction),
                gms.constants_of(robot.friction), np.zeros(n), start, out)
    return out


@compiled
def _adapt_loop(angle, rate, friction, period, blocks, constants, displacement, factor, out):
    """Write the adapted prediction (T, n) into ``out``."""
    for k in range(angle.shape[0]):
        if k > 0:
            displacement[:] = angle[k] - angle[k - 1]
        gms.advance(blocks, displacement, rate[k], period, constants)
        for j in range(angle.shape[1]):
            row = 0 if blocks.direction[j] > 0.0 else 1
            total, size = constants.viscous[row, j] * rate[k, j], 1e-12
            for i in range(factor.shape[1]):
                total += factor[j, i] * blocks.torque[j, i]
                size += blocks.torque[j, i] ** 2
            out[k, j] = total
            step = _ADAPTATION_RATE * period * (friction[k, j] - total) / max(
                size, 0.01 * constants.static[row, j] ** 2)
            for i in range(factor.shape[1]):
                factor[j, i] = compensation.limited(
                    factor[j, i] + step * blocks.torque[j, i], compensation.LEAST_FACTOR,
                    compensation.LARGEST_FACTOR)


class Prediction(NamedTuple):
    """One compensation along a recording."""

    mode: str
    name: str
    torque: tuple     # of (T, n) per piece, behind the low-pass [N m]; empty where not asked
    error: list       # rms on the held-out part per joint [N m]; None where not asked
    fitted: list      # rms on the fitted part per joint [N m]
    remark: str


def split(pieces, share) -> list:
    """Return which samples of each piece are fitted (T,): the first ``share`` of the time."""
    begin, end = pieces[0].time[0], pieces[-1].time[-1]
    masks = [one.time < begin + share * (end - begin) for one in pieces]
    counts = sum(mask.sum() for mask in masks), sum((~mask).sum() for mask in masks)
    if min(counts) < 2 * max(one.window for one in pieces):
        raise IdentificationError(
            f'--fit {share:g}: leaves {counts[0]} samples to fit and {counts[1]} to judge, too '
            'few of one; record longer or divide in another place')
    return masks


class FitItem(NamedTuple):
    """One compensation to be fitted to a bag: an item of a batch."""

    path: str
    motors: tuple
    robot: object    # RobotParams
    gains: object    # ControllerParams
    share: float     # of the bag's time
    mode: str


def read_along(path, motors, robot) -> Along:
    """Return a bag as `along.Along`; a recording without enough of it raises."""
    return along(read_recording(path, robot.joints, motors), robot)


def fit_item(item) -> list:
    """Return what `fit` finds for a FitItem, a list."""
    found = read_along(item.path, item.motors, item.robot)
    return fit(found, item.gains, item.mode, split(found.pieces, item.share)).ravel().tolist()


def modes_to_fit(has_reference) -> list:
    """Return the compensations that are fitted to a recording with or without reference."""
    return [mode for mode, fitted in _FITTED.items()
            if fitted and mode != 'gms_adaptive' and (has_reference or not _lacks(mode))]


def _lacks(mode):
    return mode in ('gms', 'gms_desired')


def compare_along(found, gains, share, fits) -> list:
    """
    Return a Prediction of every compensation for a recording (Along).

    ``fits`` is what `fit` found for the first ``share`` of it, by `modes_to_fit`.
    """
    masks, result = split(found.pieces, share), []
    for mode, name in CONTESTANTS.items():
        if _lacks(mode) and not found.has_reference:
            result.append(Prediction(mode, name, (), None, None,
                                     'the bag has no reference with its derivatives'))
            continue
        robot, of = found.robot, 'gms_paper' if mode == 'gms_adaptive' else mode
        if _FITTED[mode]:
            x = np.asarray(fits[of]).reshape(10, robot.n_joints)
            robot = replace(robot, friction=scaled(robot.friction, x))
        factor = np.ones(robot.friction.stiffness.shape)
        torque = tuple(low_pass(
            _adapted(one, robot, factor) if mode == 'gms_adaptive' else predicted(
                one, robot, gains, mode), one.window) for one in found.pieces)
        result.append(Prediction(
            mode, name, torque, _rms(found, torque, [~mask for mask in masks]),
            _rms(found, torque, masks), _REMARKS.get(mode, '')))
    return result


def _rms(found, torques, masks):
    errors = np.concatenate([(torque - one.friction)[mask] for torque, one, mask in zip(
        torques, found.pieces, masks, strict=True)])
    return np.sqrt(np.mean(errors ** 2, axis=0)).tolist()


def scaled(friction, x) -> FrictionParams:
    """
    Return friction scaled by exp(x), x (10, n).

    Coulomb level, static above it, Stribeck velocity and viscous of forward, then of backward
    motion; stiffness of all blocks; attraction.
    """
    def way(steady, x):
        above = np.maximum(steady.static / steady.coulomb - 1.0, _LEAST_SHARE)
        coulomb = steady.coulomb * np.exp(x[0])
        viscous = np.maximum(steady.viscous, _LEAST_SHARE * steady.coulomb)
        return replace(steady, coulomb=coulomb, static=coulomb * (1.0 + above * np.exp(x[1])),
                       velocity=steady.velocity * np.exp(x[2]), viscous=viscous * np.exp(x[3]))

    return replace(friction, forward=way(friction.forward, x[:4]),
                   backward=way(friction.backward, x[4:8]),
                   stiffness=friction.stiffness * np.exp(x[8])[:, None],
                   attraction=friction.attraction * np.exp(x[9]))


def fit(found, gains, mode, masks) -> np.ndarray:
    """
    Return x (10, n) of `scaled` with which a compensation fits the samples in ``masks`` best.

    Joints do not act on each other here, so one step of the derivative serves all of them. The
    filters at the end of a piece see a little of what is held out: half a window of it.
    """
    n = found.robot.n_joints
    used = [(one, mask) for one, mask in zip(found.pieces, masks, strict=True) if mask.any()]
    thin = max(1, sum(mask.sum() for _, mask in used) // _MOST_FIT)
    size = np.maximum(np.sqrt(np.mean(np.concatenate(
        [one.friction[mask] for one, mask in used]) ** 2, axis=0)), 1e-12)

    def errors(x):
        robot = replace(found.robot, friction=scaled(found.robot.friction, x.reshape(10, n)))
        parts = [(low_pass(predicted(one, robot, gains, mode), one.window) - one.friction)[mask]
                 for one, mask in used]
        return np.concatenate(parts)[::thin] / size

    def jacobian(x):
        base, step = errors(x), 1e-4
        columns = np.zeros((*base.shape, 10, n))
        for k in range(10):
            moved = x.reshape(10, n).copy()
            moved[k] += step
            change = (errors(moved.ravel()) - base) / step
            for j in range(n):
                columns[:, j, k, j] = change[:, j]
        return columns.reshape(base.size, 10 * n)

    best = least_squares(lambda x: errors(x).ravel(), np.zeros(10 * n), jacobian,
                         bounds=(-_BOUND, _BOUND), max_nfev=25)
    return best.x.reshape(10, n)
