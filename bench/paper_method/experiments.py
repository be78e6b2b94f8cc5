# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What each experiment of the paper's section 4 uses of the data.

What a joint does at each sample follows from motion and torque where nobody wrote it down.
"""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.data import signal_analysis
from gms_flex_control.dynamics.chain import inverse_dynamics
from gms_flex_control.identification.segments import filled, Segment, torque_at_samples
from gms_flex_control.params.arm import ArmParams
import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

CONSTANT_VELOCITY, PRESLIDING, SLIDING = 'constant_velocity', 'presliding', 'sliding'
BREAK_AWAY, STANDING, OTHER = 'break_away', 'standing', 'other'

_SIGMA = 0.2           # of a smoothing filter, of its length
_WINDOW = 0.4          # over which motion and torque are compared [s]
_TORQUE_WINDOW = 0.12  # mean of the friction torque [s]
_TRAVEL_COUNTS = 1.5   # travel in a window that is motion, in encoder counts
_SLOWEST = 1e-3        # likewise, of the usual travel of a window in motion
_CLEARLY = 4.0         # of that: motion from which the level of friction is computed
_SLIDES = 0.85         # of the level of friction
_LOWEST = 0.1          # quantile of the friction torque in motion that is the level
_UNSTEADY = 0.12       # relative change of a velocity called constant
_LOADED = 0.06         # change of torque within a window that is loading, of the level
_TURN = 1.0            # at most, of a torque that turns [s]
_HELD = 0.3            # at least, of a constant velocity [s]

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


class _Motion(NamedTuple):
    """Smoothed without lag, each of shape (T,)."""

    velocity: np.ndarray  # mean of a window [rad/s]
    change: np.ndarray    # of the velocity between the halves of a window [rad/s]
    friction: np.ndarray  # friction torque [N m]
    loading: np.ndarray   # change of the friction torque over a window [N m]
    slowest: float        # speed that a window can distinguish from rest [rad/s]
    doubt: float          # of a velocity of half a window [rad/s]


class Piece(NamedTuple):
    """Motion and friction torque of one joint over a while, smoothed without lag."""

    angle: np.ndarray     # (T,) [rad]
    rate: np.ndarray      # (T,) [rad/s]
    friction: np.ndarray  # (T,) [N m]
    period: float         # [s]
    window: int           # samples of `smooth`
    first: int            # sample from which it counts; those before give the blocks' load

    def smooth(self, values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``values`` (T,), their rate and its rate, smoothed alike."""
        return _smoothed(values, self.period, self.window * self.period)


def _smoothed(values, period, length):
    """
    Return values (T,), their rate and acceleration through one filter without lag.

    Derivatives of a local polynomial would see fast motion through filters of their own each;
    here torque and inertia stay in balance.
    """
    value = gaussian_filter1d(values, max(_SIGMA * length / period, 0.5), mode='nearest')
    rate = np.gradient(value, period)
    acceleration = np.empty_like(value)
    acceleration[1:-1] = np.diff(value, 2) / period ** 2
    acceleration[[0, -1]] = acceleration[[1, -2]]
    return np.stack([value, rate, acceleration])


def _link_motion(segment, arm, joint, period, length):
    """
    Return angle, rate and friction torque (T,) of one joint through one filter of a length [s].

    Eq. (1), link: ``F_f = K (q2 - q1) - M q1'' - C q1' - g``.
    """
    smooth = [_smoothed(angle, period, length) for angle in filled(segment.angle).T]
    angle, rate, acceleration = np.stack(smooth, axis=2)
    torque = _smoothed(torque_at_samples(segment)[:, joint], period, length)[0]
    moved = inverse_dynamics(angle, rate, acceleration, arm)[:, joint]
    return angle[:, joint], rate[:, joint], torque - moved


def _motion_of(segment, arm, joint, period, half):
    """Smooth the motion and the friction torque of one joint, ``half`` an encoder count [rad]."""
    angle, _, friction = _link_motion(segment, arm, joint, period, _TORQUE_WINDOW)
    h = max(round(0.5 * _WINDOW / period), 2)
    mean = uniform_filter1d(angle, max(h // 4, 1), mode='nearest')
    ahead, behind = _shifted(mean, h), _shifted(mean, -h)
    velocity = (ahead - behind) / (2 * h * period)
    change = (ahead - 2.0 * mean + behind) / (h * period)
    friction = uniform_filter1d(friction, max(round(_TORQUE_WINDOW / period), 1), mode='nearest')
    loading = _shifted(friction, h) - _shifted(friction, -h)
    usual = np.quantile(np.abs(velocity), 0.9)
    slowest = max(2.0 * _TRAVEL_COUNTS * half / (2 * h * period), _SLOWEST * usual)
    return _Motion(velocity, change, friction, loading, slowest, 2.0 * half / (h * period))


def _shifted(values, by):
    """Return ``values[k + by]``, the ends repeated."""
    return values[np.clip(np.arange(len(values)) + by, 0, len(values) - 1)]


def _friction_level(motion, sign):
    """Return the lower level of friction (_Motion) in clear motion of one sign [N m]."""
    rows = sign * motion.velocity > _CLEARLY * motion.slowest
    rows &= np.abs(motion.change) < 2.0 * _UNSTEADY * np.abs(motion.velocity) + motion.doubt
    torque = sign * motion.friction[rows]
    return float(np.quantile(torque, _LOWEST)) if rows.sum() > 10 else 0.0


def label(segment: Segment, arm: ArmParams, joint: int, period: float, half: float) -> np.ndarray:
    """
    Return what one joint does, from the data alone (T,) str.

    constant_velocity, presliding, sliding (one way at changing velocity), standing or other
    (reversals, stops and starts). A break-away experiment reads presliding, then sliding. A joint
    slides where it moves with nearly all of the friction that it has in clear motion; with less,
    and the torque changing, its blocks are being loaded: presliding. ``half`` is half an encoder
    count [rad].
    """
    motion = _motion_of(segment, arm, joint, period, half)
    level = np.where(motion.velocity > 0.0, _friction_level(motion, 1.0),
                     _friction_level(motion, -1.0))
    speed = np.abs(motion.velocity)
    moving = speed > motion.slowest
    loaded = np.sign(motion.velocity) * motion.friction
    slides = moving & (loaded > _SLIDES * level) & (level > 0.0)
    steady = np.abs(motion.change) < _UNSTEADY * speed + motion.doubt
    loading = np.abs(motion.loading) > _LOADED * level
    below = np.abs(motion.friction) < _SLIDES * level
    names = np.full(len(speed), OTHER, dtype='U20')
    names[~moving & ~loading] = STANDING
    names[~slides & loading & (below | ~moving)] = PRESLIDING
    _bridge(names, round(_TURN / period))
    names[slides] = SLIDING
    for run in runs(slides & steady):
        if (run.stop - run.start) * period > _HELD:
            names[run] = CONSTANT_VELOCITY
    return names


def _bridge(names, longest):
    """Call a short standstill amid presliding so too: there the torque turns, in place."""
    for gap in runs(names == STANDING):
        between = gap.start > 0 and gap.stop < len(names)
        if between and gap.stop - gap.start <= longest and (
                names[gap.start - 1] == names[gap.stop] == PRESLIDING):
            names[gap] = PRESLIDING


def runs(mask: np.ndarray) -> list[slice]:
    """Return the slices in which a mask (T,) is true."""
    return [slice(*ends) for ends in signal_analysis.runs(mask)]


def _named(segment, joint, phase):
    """Return where a test of the joint is in a phase, bool (T,); everywhere if nobody wrote."""
    tested = segment.tested[:, joint]
    if (segment.phase == '').all():
        return tested
    return tested & (segment.phase == phase)


def steady_points(segments: Sequence, labels: Sequence, arm: ArmParams, joint: int, period: float,
                  half: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the map of friction against velocity (W,), signed, break-away at zero velocity.

    One point for each stroke, where it ends, and each break-away [rad/s, N m]; ``labels`` are
    what `label` says of each of the ``segments``, the others as of `label`.
    """
    points, again = [(0.0, 0.0)], round(_AGAIN / period)
    for segment, names in zip(segments, labels, strict=True):
        angle, _, friction = _link_motion(segment, arm, joint, period, _STEADY_WINDOW)
        least = max(2.0 * half * _COUNTS, _TRAVEL * np.ptp(angle))
        steady = (names == CONSTANT_VELOCITY) & _named(
            segment, joint, CONSTANT_VELOCITY)
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
        points += _break_aways(segment, arm, joint, period, names)
    table = np.array(points[1:]).reshape(-1, 2)
    table = table[(table[:, 0] == 0.0) | (table[:, 0] * table[:, 1] > 0.0)]
    return table[:, 0], table[:, 1]


def _break_aways(segment, arm, joint, period, names):
    """Yield (0, torque) of each break-away under a slow ramp."""
    angle, _, friction = _link_motion(segment, arm, joint, period, _BREAK_WINDOW)
    allowed = _named(segment, joint, BREAK_AWAY)
    ramp, before, after, far = (round(time / period) for time in (
        _SHORTEST_RAMP, _BEFORE, _AFTER, _FAR_TIME))
    for run in runs((names == PRESLIDING) & allowed):
        if run.stop - run.start < ramp:
            continue
        follows = angle[run.stop:run.stop + far]
        if len(follows) and np.abs(follows - follows[0]).max() > _FAR * np.ptp(angle[run]):
            part = friction[max(run.stop - before, run.start):run.stop + after]
            torque = part[np.argmax(np.abs(part))]
            if abs(torque - part[0]) < _SLOW * abs(torque):
                yield 0.0, torque


def believable(velocity: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """
    Return which points of `steady_points` to keep, bool (W,).

    Eq. (6) falls with speed where it is slow: a torque at break-away below those of slow motion
    was measured under a ramp too fast for the softest blocks to slip, and is no F_s.
    """
    keep = np.ones(len(velocity), dtype=bool)
    for sign in (1.0, -1.0):
        rows = (sign * torque > 0.0) & (velocity != 0.0)
        if rows.any():
            slow = rows & (np.abs(velocity) <= np.median(np.abs(velocity[rows])))
            most = np.max(sign * torque[slow])
            keep &= (sign * torque <= 0.0) | (velocity != 0.0) | (sign * torque >= most)
    return keep


def presliding_pieces(segments: Sequence, labels: Sequence, arm: ArmParams, joint: int,
                      period: float) -> list[Piece]:
    """Return what is presliding, coarsely sampled; arguments of `steady_points`."""
    every, found = max(round(_COARSE / period), 1), []
    for segment, names in zip(segments, labels, strict=True):
        loading = chosen = _named(segment, joint, PRESLIDING)
        if (segment.phase == '').all():
            loading = chosen & (names == PRESLIDING)
            chosen = loading | (chosen & (names == STANDING))
        signals = _link_motion(segment, arm, joint, period, _PRESLIDING_WINDOW)
        for run in runs(chosen):
            if loading[run].sum() * period > _SHORTEST_LOOP:
                lead = min(run.start, round(_LEAD / period)) // every
                rows = slice(run.start - lead * every, run.stop, every)
                found.append(Piece(*(signal[rows] for signal in signals), every * period, 0,
                                   lead))
    return found


def sliding_pieces(segments: Sequence, labels: Sequence, arm: ArmParams, joint: int,
                   period: float) -> list[Piece]:
    """Return one-way sliding at changing velocity, its beginnings left out; likewise."""
    found, window = [], max(round(_LAG_WINDOW / period), 5)
    for segment, names in zip(segments, labels, strict=True):
        chosen = np.isin(names, (SLIDING, CONSTANT_VELOCITY)) & _named(
            segment, joint, SLIDING)
        signals = _link_motion(segment, arm, joint, period, _SLIDING_WINDOW)
        chosen &= np.abs(signals[1]) > 0.0
        for run in runs(chosen):
            run = slice(run.start + round(_UNTIL_ALL_SLIP * (run.stop - run.start)), run.stop)
            shares = np.mean(names[run] == SLIDING) if run.stop > run.start else 0.0
            shortest, least = _UNNAMED_SLIDE if (segment.phase == '').all() else _NAMED_SLIDE
            if shares > least and (run.stop - run.start) * period > shortest:
                found.append(Piece(*(signal[run] for signal in signals), period, window, 0))
    return found
