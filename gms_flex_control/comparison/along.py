# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Friction torque along a recording: what each compensation says of it, and what was measured.

The controller's own code is driven by the recorded motion. The measured friction is what the link
equation lacks, ``F_f = K (q2 - q1) - M q1'' - C q1' - g``.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.comparison.contestants import gains_of
from gms_flex_control.compiled import compiled
from gms_flex_control.control import cascade
from gms_flex_control.control.compensation import choice, common, gms_adaptive
from gms_flex_control.friction import gms
from gms_flex_control.identification.held_out import smooth_angle
from gms_flex_control.identification.smoothing import low_pass
from gms_flex_control.identification.steady import friction_torque
from gms_flex_control.identification.stretches import drive_sides, rigid_where, stretches_of
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.simulation import encoder
import numpy as np

ADAPTATION_RATE = 2.0  # how fast adapted factors take up a torque error that is seen [1/s]


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


def along(recording, robot):
    """
    Return a recording as what friction models are compared on.

    Parameters
    ----------
    recording : Recording
        With torque or both sides of the joints.
    robot : RobotParams
        Inertia and stiffness are taken from it.

    Returns
    -------
    Along

    Raises
    ------
    IdentificationError
        If no piece is long enough or there is no torque.

    """
    sides = drive_sides(recording, robot)
    seen = rigid_where(robot, sides)
    pieces = [_piece(stretch, recording, seen) for stretch in stretches_of(
        recording, robot, sides)]
    return Along(tuple(pieces), seen, all(np.isfinite(one.reference).all() for one in pieces))


def _piece(stretch, recording, robot):
    period, samples = recording.period, len(stretch.angle)
    time = stretch.begin + period * np.arange(samples)
    reference = np.stack([[np.interp(time, recording.time, recording.reference[:, k, j])
                           for j in range(robot.n_joints)] for k in range(5)])
    angle = smooth_angle(stretch, period)
    first = [column[np.isfinite(column)][0] for column in stretch.angle.T]
    return Piece(
        time, period, angle + first, stretch.rate,
        np.ascontiguousarray(np.moveaxis(reference, 2, 0)), stretch.torque,
        low_pass(friction_torque(stretch, robot.arm), stretch.window), stretch.window)


@compiled
def estimate_loop(angle, rate, reference, drive, period, state, measured, constants, work, out):
    """Write F_hat (T, n) of the chosen compensation along a motion into ``out``."""
    for k in range(angle.shape[0]):
        measured.q_link[:], measured.dq_link[:] = angle[k], rate[k]
        cascade.link_errors(state, measured, reference[k], constants, work)
        work.spring[:] = drive[k]
        choice.estimate(state, measured, reference[k], period if k > 0 else 0.0, constants, work)
        out[k] = work.estimate[0]


def predicted(piece, robot, gains, mode):
    """
    Return what a compensation says of the friction along a piece.

    Parameters
    ----------
    piece : Piece
        The motion.
    robot : RobotParams
        With the friction the compensation believes in.
    gains : ControllerParams
        Of filters and slopes; tracking errors correct nothing here, they were another loop's.
    mode : str
        One of params.gains.COMPENSATIONS.

    Returns
    -------
    ndarray, shape (T, n)
        [N m], not yet behind the low-pass.

    """
    n = robot.n_joints
    chosen = replace(gains_of(gains, mode), observer_gain=np.zeros(n))
    reference = np.where(np.isfinite(piece.reference), piece.reference, 0.0)
    out = np.empty(piece.angle.shape)
    estimate_loop(piece.angle, piece.rate, reference, piece.drive, piece.period,
                  cascade.init(robot), encoder.init(n), cascade.constants_of(chosen, robot),
                  cascade.workspace(n), out)
    return out


def adapted(piece, robot, start):
    """
    Return GMS along a piece, each block's factor following the torque error that is seen.

    Parameters
    ----------
    piece : Piece
        The motion, its measured friction among it.
    robot : RobotParams
        With the friction believed at first.
    start : ndarray, shape (n, N)
        Factors at its beginning, changed in place.

    Returns
    -------
    ndarray, shape (T, n)
        Prediction before each error was seen [N m].

    """
    n, out = robot.n_joints, np.empty(piece.angle.shape)
    adapt_loop(piece.angle, piece.rate, piece.friction, piece.period, gms.init(robot.friction),
               gms.constants_of(robot.friction), np.zeros(n), start, out)
    return out


@compiled
def adapt_loop(angle, rate, friction, period, blocks, constants, displacement, factor, out):
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
            step = ADAPTATION_RATE * period * (friction[k, j] - total) / max(
                size, 0.01 * constants.static[row, j] ** 2)
            for i in range(factor.shape[1]):
                factor[j, i] = common.limited(factor[j, i] + step * blocks.torque[j, i],
                                              gms_adaptive.LEAST, gms_adaptive.MOST)
