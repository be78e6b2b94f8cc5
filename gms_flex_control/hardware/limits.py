# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a robot may do, whatever the controller says: torque, rate, velocity, range and twist."""

from dataclasses import dataclass, fields
from functools import cached_property

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.checks import freeze_arrays
import numpy as np

UNLIMITED = 1e9           # of a limit that nobody gave
_SHORTEST = 0.01          # a step of the angle is judged as if it took at least that long [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """
    Limits of each joint; `UNLIMITED` where there is none.

    Parameters
    ----------
    torque : array_like, shape (n_joints,)
        Largest torque [N m].
    torque_rate : array_like, shape (n_joints,)
        Fastest rise of its magnitude [N m/s]; it may fall at once.
    velocity : array_like, shape (n_joints,)
        Speed from which on no torque may add to it [rad/s].
    velocity_margin : array_like, shape (n_joints,)
        Beyond the speed by so much is a fault [rad/s].
    lower, upper : array_like, shape (n_joints,)
        Range of the link; outside of it only inward torque [rad].
    position_margin : array_like, shape (n_joints,)
        Beyond the range by so much is a fault [rad].
    twist : array_like, shape (n_joints,)
        Motor angle minus link angle that is a fault [rad].

    Raises
    ------
    ParameterError
        If a limit is not positive, or the range of a joint is empty.

    """

    torque: np.ndarray
    torque_rate: np.ndarray
    velocity: np.ndarray
    velocity_margin: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    position_margin: np.ndarray
    twist: np.ndarray

    def __post_init__(self):
        freeze_arrays(self)
        for field in fields(self):
            value = getattr(self, field.name)
            if value.shape != self.torque.shape or not np.isfinite(value).all():
                raise ParameterError(f'limits: {field.name} must be one finite number per joint, '
                                     f'got {value}')
            if field.name not in ('lower', 'upper') and (value < 0.0).any():
                raise ParameterError(f'limits: {field.name} must be at least 0, got {value}')
        if not (self.lower < self.upper).all():
            raise ParameterError(f'limits: lower {self.lower} must be below upper {self.upper}; '
                                 'were they swapped?')

    @cached_property
    def within(self):
        """Return least and most (4 n_joints,) of link angles, both sides' velocities, twists."""
        fastest = self.velocity + self.velocity_margin
        least = self.lower - self.position_margin, -fastest, -fastest, -self.twist
        most = self.upper + self.position_margin, fastest, fastest, self.twist
        return np.concatenate(least), np.concatenate(most)

    def missing(self):
        """Return names of the limits that some joint lacks and no real robot may lack."""
        return [name for name in ('torque', 'torque_rate', 'velocity', 'lower', 'upper')
                if (np.abs(getattr(self, name)) >= UNLIMITED).any()]


def limited(command, before, elapsed, q, dq, limits):
    """
    Return the torque that a command may become.

    Parameters
    ----------
    command : ndarray, shape (n_joints,)
        What the controller asks for [N m], finite.
    before : ndarray, shape (n_joints,)
        Torque of the sample before [N m].
    elapsed : float
        Time since then [s].
    q, dq : ndarray, shape (n_joints,)
        Angle [rad] and velocity [rad/s] of the links.
    limits : Limits
        Of these joints.

    Returns
    -------
    ndarray, shape (n_joints,)
        ``command`` clipped to ``torque`` and to a rise of ``torque_rate * elapsed`` beyond
        ``before`` or zero, whichever is further; zero where it points out of the range or would
        speed up a joint that is as fast as it may be [N m]. Zero is always allowed.

    """
    lowest, highest = _reach(before, elapsed, limits)
    torque = np.clip(command, np.maximum(lowest, -limits.torque),
                     np.minimum(highest, limits.torque))
    outward = ((q >= limits.upper) & (torque > 0.0)) | ((q <= limits.lower) & (torque < 0.0))
    speeding = ((dq >= limits.velocity) & (torque > 0.0)) | (
        (dq <= -limits.velocity) & (torque < 0.0))
    torque[outward | speeding] = 0.0
    return torque


def _reach(before, elapsed, limits):
    """Return the least and the largest torque (n_joints,) that the rate lets follow."""
    rise = limits.torque_rate * max(elapsed, 0.0)
    return np.minimum(before, 0.0) - rise, np.maximum(before, 0.0) + rise


def held_back(command, before, elapsed, limits):
    """Return of which joints the rate alone holds the torque back, bool (n_joints,)."""
    lowest, highest = _reach(before, elapsed, limits)
    allowed = np.clip(command, -limits.torque, limits.torque)
    return (allowed < lowest) | (allowed > highest)


def violation(names, measured, limits):
    """
    Return what a robot does beyond its margins.

    Parameters
    ----------
    names : sequence of str
        Of the joints.
    measured : object
        With ``q_link``, ``dq_link``, ``q_motor``, ``dq_motor`` (n_joints,) [rad, rad/s].
    limits : Limits
        Of these joints.

    Returns
    -------
    str
        A sentence about the first joint that is; '' if none is.

    """
    q, twist = measured.q_link, measured.q_motor - measured.q_link
    seen = np.concatenate((q, measured.dq_link, measured.dq_motor, twist))
    least, most = limits.within
    if not ((seen < least) | (seen > most)).any():  # as nearly always, on the way of a command
        return ''
    above = q > limits.upper + limits.position_margin
    below = q < limits.lower - limits.position_margin
    if (above | below).any():
        j = int(np.argmax(above | below))
        return (f'{names[j]} is at {q[j]:.4g} rad, beyond its range of {limits.lower[j]:.4g} to '
                f'{limits.upper[j]:.4g} by more than {limits.position_margin[j]:.4g} rad')
    for side, dq in (('link', measured.dq_link), ('motor', measured.dq_motor)):
        fast = np.abs(dq) > limits.velocity + limits.velocity_margin
        if fast.any():
            j = int(np.argmax(fast))
            return (f'the {side} side of {names[j]} moves at {dq[j]:.4g} rad/s, above its limit '
                    f'of {limits.velocity[j]:.4g} by more than {limits.velocity_margin[j]:.4g}')
    twisted = np.abs(twist) > limits.twist
    if twisted.any():
        j = int(np.argmax(twisted))
        return (f'motor and link of {names[j]} are {twist[j]:.4g} rad apart, more than the '
                f'{limits.twist[j]:.4g} allowed; a sign, a gear ratio or an encoder may be wrong')
    return ''


def jump(names, measured, before, elapsed, limits):
    """
    Return whether an angle changed faster than any joint of this robot can move.

    Parameters
    ----------
    names : sequence of str
        Of the joints.
    measured : object
        With ``q_link`` and ``q_motor`` (n_joints,) [rad].
    before : pair of ndarray, shape (n_joints,)
        The same a sample before.
    elapsed : float
        Time between them [s].
    limits : Limits
        Of these joints.

    Returns
    -------
    str
        A sentence about the first joint that did; '' if none did.

    """
    fastest = (limits.velocity + limits.velocity_margin) * max(elapsed, _SHORTEST)
    for what, q, q_before in (('', measured.q_link, before[0]),
                              ('the motor of ', measured.q_motor, before[1])):
        jumped = np.abs(q - q_before) > fastest
        if jumped.any():
            j = int(np.argmax(jumped))
            return (f'{what}{names[j]} jumped from {q_before[j]:.4g} to {q[j]:.4g} rad within '
                    f'{elapsed * 1e3:.3g} ms; look at its encoder')
    return ''
