# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a joint does at each sample, told from motion and torque where nobody wrote it down."""

from typing import NamedTuple

from gms_flex_control.dynamics.chain import inverse_dynamics
import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

CONSTANT_VELOCITY, PRESLIDING, SLIDING = 'constant_velocity', 'presliding', 'sliding'
BREAK_AWAY, STANDING, OTHER = 'break_away', 'standing', 'other'

_SIGMA = 0.2           # of a smoothing filter, of its length
_WINDOW = 0.4          # over which motion and torque are compared [s]
_TORQUE_WINDOW = 0.12  # mean of the friction torque [s]
_COUNTS = 1.5          # travel in a window that is motion, in encoder counts
_SLOWEST = 1e-3        # likewise, of the usual travel of a window in motion
_CLEARLY = 4.0         # of that: motion from which the level of friction is taken
_SLIDES = 0.85         # of the level of friction
_LOWEST = 0.1          # quantile of the friction torque in motion that is the level
_UNSTEADY = 0.12       # relative change of a velocity called constant
_LOADED = 0.06         # change of torque within a window that is loading, of the level
_TURN = 1.0            # at most, of a torque that turns [s]
_HELD = 0.3            # at least, of a constant velocity [s]


class Motion(NamedTuple):
    """Smoothed without lag, each of shape (T,)."""

    velocity: np.ndarray  # mean of a window [rad/s]
    change: np.ndarray    # of the velocity between the halves of a window [rad/s]
    friction: np.ndarray  # friction torque [N m]
    loading: np.ndarray   # change of the friction torque over a window [N m]
    slowest: float        # speed that a window can tell from rest [rad/s]
    doubt: float          # of a velocity of half a window [rad/s]


def smoothed(values, period, length):
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


def link_motion(stretch, arm, joint, period, length):
    """
    Return motion and friction torque of one joint through one filter without lag.

    Parameters
    ----------
    stretch, arm, joint, period
        As `motion_of`.
    length : float
        Of the filter [s].

    Returns
    -------
    angle, rate, friction : ndarray, shape (T,)
        [rad, rad/s, N m].

    Notes
    -----
    Eq. (1), link: ``F_f = K (q2 - q1) - M q1'' - C q1' - g``.

    """
    samples, smooth = np.arange(len(stretch.angle)), []
    for angle in stretch.angle.T:
        known = np.isfinite(angle)
        smooth.append(smoothed(np.interp(samples, samples[known], angle[known]), period, length))
    angle, rate, acceleration = np.stack(smooth, axis=2)
    torque = 0.5 * (stretch.torque + np.roll(stretch.torque, 1, axis=0))  # at the sample
    torque[0] = stretch.torque[0]
    torque = smoothed(torque[:, joint], period, length)[0]
    moved = inverse_dynamics(angle, rate, acceleration, arm)[:, joint]
    return angle[:, joint], rate[:, joint], torque - moved


def motion_of(stretch, arm, joint, period, half):
    """
    Smooth the motion and the friction torque of one joint.

    Parameters
    ----------
    stretch : Stretch
        Evenly sampled.
    arm : ArmParams
        The arm.
    joint : int
        Which joint.
    period : float
        Sample [s].
    half : float
        Half an encoder count [rad].

    Returns
    -------
    Motion

    """
    angle, _, friction = link_motion(stretch, arm, joint, period, _TORQUE_WINDOW)
    h = max(round(0.5 * _WINDOW / period), 2)
    mean = uniform_filter1d(angle, max(h // 4, 1), mode='nearest')
    ahead, behind = _shifted(mean, h), _shifted(mean, -h)
    velocity = (ahead - behind) / (2 * h * period)
    change = (ahead - 2.0 * mean + behind) / (h * period)
    friction = uniform_filter1d(friction, max(round(_TORQUE_WINDOW / period), 1), mode='nearest')
    loading = _shifted(friction, h) - _shifted(friction, -h)
    usual = np.quantile(np.abs(velocity), 0.9)
    slowest = max(2.0 * _COUNTS * half / (2 * h * period), _SLOWEST * usual)
    return Motion(velocity, change, friction, loading, slowest, 2.0 * half / (h * period))


def _shifted(values, by):
    """Return ``values[k + by]``, the ends repeated."""
    return values[np.clip(np.arange(len(values)) + by, 0, len(values) - 1)]


def friction_level(motion, sign):
    """Return the lower level of friction (Motion) in clear motion of one sign [N m]."""
    rows = sign * motion.velocity > _CLEARLY * motion.slowest
    rows &= np.abs(motion.change) < 2.0 * _UNSTEADY * np.abs(motion.velocity) + motion.doubt
    torque = sign * motion.friction[rows]
    return float(np.quantile(torque, _LOWEST)) if rows.sum() > 10 else 0.0


def label(stretch, arm, joint, period, half):
    """
    Tell from the data alone what one joint does.

    Parameters
    ----------
    stretch, arm, joint, period, half
        As `motion_of`.

    Returns
    -------
    ndarray of str, shape (T,)
        constant_velocity, presliding, sliding (one way at changing velocity), standing or
        other (reversals, stops and starts). A break-away experiment reads presliding, then
        sliding.

    Notes
    -----
    A joint slides where it moves with nearly all of the friction that it has in clear motion;
    with less, and the torque changing, its blocks are being loaded: presliding.

    """
    motion = motion_of(stretch, arm, joint, period, half)
    level = np.where(motion.velocity > 0.0, friction_level(motion, 1.0),
                     friction_level(motion, -1.0))
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


def runs(mask):
    """Return the slices in which a mask (T,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [slice(begin, end) for begin, end in edges.reshape(-1, 2)]
