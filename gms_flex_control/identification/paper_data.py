# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What each experiment of the paper's section 4 takes from the data."""

from typing import NamedTuple

from gms_flex_control.identification import phases
from gms_flex_control.identification.phases import link_motion, runs, smoothed
import numpy as np

_STEADY_WINDOW, _BREAK_WINDOW = 0.12, 0.2   # of the filters [s]
_PRESLIDING_WINDOW, _SLIDING_WINDOW = 0.25, 0.2
_LAG_WINDOW = 0.25     # for the rate of change of sliding friction [s]
_SHORTEST_STEADY = 0.4   # run at constant velocity [s]
_SHORTEST_RAMP = 1.0   # presliding before a break-away [s]
_COUNTS, _TRAVEL = 8.0, 5e-4  # way of such a run: encoder counts, and of the whole range
_BEFORE, _AFTER = 0.5, 0.2  # of the end of presliding, where break-away is sought [s]
_SLOW = 0.6            # of that torque: its change meanwhile, if it is a slow ramp
_FAR, _FAR_TIME = 5.0, 0.5  # times the way of presliding, within so long: broken away [s]
_SHORTEST_LOOP = 2.0   # presliding worth fitting [s]
_NAMED_SLIDE, _UNNAMED_SLIDE = (1.0, 0.0), (2.5, 0.8)  # shortest [s], least share that varies
_UNTIL_ALL_SLIP = 0.5  # of a run of sliding: soft blocks slip only after a long way
_AGAIN = 1.5           # a run that follows another sooner is the same stroke [s]
_LEAD = 8.0            # of motion before presliding, from which the blocks' load follows [s]
_COARSE = 0.01         # sample of presliding [s]


class Piece(NamedTuple):
    """Motion and friction torque of one joint over a while, smoothed without lag."""

    angle: np.ndarray     # (T,) [rad]
    rate: np.ndarray      # (T,) [rad/s]
    friction: np.ndarray  # (T,) [N m]
    period: float         # [s]
    window: int           # samples of `smooth`
    first: int            # sample from which it counts; those before tell the blocks' load

    def smooth(self, values):
        """Return ``values`` (T,), their rate and its rate, smoothed alike."""
        return smoothed(values, self.period, self.window * self.period)


def _named(stretch, joint, phase):
    """Return where a test of the joint is in a phase, bool (T,); everywhere if nobody wrote."""
    tested = stretch.tested[:, joint]
    if (stretch.phase == '').all():
        return tested
    return tested & (stretch.phase == phase)


def steady_points(stretches, labels, arm, joint, period, half):
    """
    Return the map of friction against velocity, break-away at zero velocity.

    Parameters
    ----------
    stretches, labels
        Data of tests of the joint, and what phases.label says of each.
    arm, joint, period, half
        As `paper_method.fit_paper`.

    Returns
    -------
    velocity, torque : ndarray, shape (W,)
        Signed [rad/s, N m]; one point for each stroke, where it ends, and each break-away.

    """
    points, again = [(0.0, 0.0)], round(_AGAIN / period)
    for stretch, names in zip(stretches, labels, strict=True):
        angle, _, friction = link_motion(stretch, arm, joint, period, _STEADY_WINDOW)
        least = max(2.0 * half * _COUNTS, _TRAVEL * np.ptp(angle))
        steady = (names == phases.CONSTANT_VELOCITY) & _named(
            stretch, joint, phases.CONSTANT_VELOCITY)
        held = [slice((run.start + run.stop) // 2, run.stop) for run in runs(steady)
                if (run.stop - run.start) * period > _SHORTEST_STEADY
                and abs(angle[run.stop - 1] - angle[run.start]) > least]
        for run, after in zip(held, [*held[1:], None], strict=False):
            speed = (angle[run.stop - 1] - angle[run.start]) / (
                (run.stop - 1 - run.start) * period)
            last = after is None or 2 * after.start - after.stop - run.stop > again or (
                speed * (angle[after.stop - 1] - angle[after.start]) < 0.0)
            if last:  # a stroke at two speeds begins with blocks not slipping yet
                points.append((speed, friction[run].mean()))
        points += _break_aways(stretch, arm, joint, period, names)
    table = np.array(points[1:]).reshape(-1, 2)
    table = table[(table[:, 0] == 0.0) | (table[:, 0] * table[:, 1] > 0.0)]
    return table[:, 0], table[:, 1]


def _break_aways(stretch, arm, joint, period, names):
    """Yield (0, torque) of each break-away under a slow ramp."""
    angle, _, friction = link_motion(stretch, arm, joint, period, _BREAK_WINDOW)
    allowed = _named(stretch, joint, phases.BREAK_AWAY)
    ramp, before, after, far = (round(time / period) for time in (
        _SHORTEST_RAMP, _BEFORE, _AFTER, _FAR_TIME))
    for run in runs((names == phases.PRESLIDING) & allowed):
        if run.stop - run.start < ramp:
            continue
        follows = angle[run.stop:run.stop + far]
        if len(follows) and np.abs(follows - follows[0]).max() > _FAR * np.ptp(angle[run]):
            part = friction[max(run.stop - before, run.start):run.stop + after]
            torque = part[np.argmax(np.abs(part))]
            if abs(torque - part[0]) < _SLOW * abs(torque):
                yield 0.0, torque


def believable(velocity, torque):
    """
    Leave out break-away torques that contradict the torques at constant velocity.

    Eq. (6) falls with speed where it is slow: a torque at break-away below those of slow motion
    was taken under a ramp too fast for the softest blocks to slip, and is no F_s.

    Parameters
    ----------
    velocity, torque : ndarray, shape (W,)
        As `steady_points` returns them.

    Returns
    -------
    ndarray of bool, shape (W,)

    """
    keep = np.ones(len(velocity), dtype=bool)
    for sign in (1.0, -1.0):
        rows = (sign * torque > 0.0) & (velocity != 0.0)
        if rows.any():
            slow = rows & (np.abs(velocity) <= np.median(np.abs(velocity[rows])))
            most = np.max(sign * torque[slow])
            keep &= (sign * torque <= 0.0) | (velocity != 0.0) | (sign * torque >= most)
    return keep


def presliding_pieces(stretches, labels, arm, joint, period):
    """
    Return what is presliding, coarsely sampled.

    Parameters
    ----------
    stretches, labels, arm, joint, period
        As `steady_points`.

    Returns
    -------
    list of Piece

    """
    every, found = max(round(_COARSE / period), 1), []
    for stretch, names in zip(stretches, labels, strict=True):
        loading = chosen = _named(stretch, joint, phases.PRESLIDING)
        if (stretch.phase == '').all():
            loading = chosen & (names == phases.PRESLIDING)
            chosen = loading | (chosen & (names == phases.STANDING))
        signals = link_motion(stretch, arm, joint, period, _PRESLIDING_WINDOW)
        for run in runs(chosen):
            if loading[run].sum() * period > _SHORTEST_LOOP:
                lead = min(run.start, round(_LEAD / period)) // every
                rows = slice(run.start - lead * every, run.stop, every)
                found.append(Piece(*(signal[rows] for signal in signals), every * period, 0,
                                   lead))
    return found


def sliding_pieces(stretches, labels, arm, joint, period):
    """
    Return one-way sliding at changing velocity, its beginnings left out.

    Parameters
    ----------
    stretches, labels, arm, joint, period
        As `steady_points`.

    Returns
    -------
    list of Piece

    """
    found, window = [], max(round(_LAG_WINDOW / period), 5)
    for stretch, names in zip(stretches, labels, strict=True):
        chosen = np.isin(names, (phases.SLIDING, phases.CONSTANT_VELOCITY)) & _named(
            stretch, joint, phases.SLIDING)
        signals = link_motion(stretch, arm, joint, period, _SLIDING_WINDOW)
        chosen &= np.abs(signals[1]) > 0.0
        for run in runs(chosen):
            run = slice(run.start + round(_UNTIL_ALL_SLIP * (run.stop - run.start)), run.stop)
            shares = np.mean(names[run] == phases.SLIDING) if run.stop > run.start else 0.0
            shortest, least = _UNNAMED_SLIDE if (stretch.phase == '').all() else _NAMED_SLIDE
            if shares > least and (run.stop - run.start) * period > shortest:
                found.append(Piece(*(signal[run] for signal in signals), period, window, 0))
    return found
