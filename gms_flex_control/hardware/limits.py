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
    Limits of each joint, arrays (n_joints,); `UNLIMITED` where there is none.

    Raises ParameterError if a limit is negative or not finite, or the range of a joint is empty.
    """

    torque: np.ndarray           # largest [N m]
    torque_rate: np.ndarray      # fastest rise of its magnitude; it may fall at once [N m/s]
    velocity: np.ndarray         # from which on no torque may add to it [rad/s]
    velocity_margin: np.ndarray  # beyond the velocity by so much is a fault [rad/s]
    lower: np.ndarray            # range of the link; outside of it only inward torque [rad]
    upper: np.ndarray
    position_margin: np.ndarray  # beyond the range by so much is a fault [rad]
    twist: np.ndarray            # motor angle minus link angle that is a fault [rad]

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
    def within(self) -> tuple:
        """Return least and most (4 n_joints,) of link angles, both sides' velocities, twists."""
        fastest = self.velocity + self.velocity_margin
        least = self.lower - self.position_margin, -fastest, -fastest, -self.twist
        most = self.upper + self.position_margin, fastest, fastest, self.twist
        return np.concatenate(least), np.concatenate(most)

    def missing(self) -> list:
        """Return names of the limits that some joint lacks and no real robot may lack."""
        return [name for name in ('torque', 'torque_rate', 'velocity', 'lower', 'upper')
                if (np.abs(getattr(self, name)) >= UNLIMITED).any()]


def limited(command, before, elapsed, q, dq, limits) -> np.ndarray:
    """
    Return the torque (n_joints,) [N m] that a command may become; zero is always allowed.

    ``command``, finite [N m], is clipped to ``torque`` and to a rise of ``torque_rate`` in
    ``elapsed`` [s] beyond the torque ``before`` or zero, whichever is further. It is zero where
    it points out of the range or would speed up a link, at ``q`` [rad] and ``dq`` [rad/s], that
    is as fast as it may be.
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


def held_back(command, before, elapsed, limits) -> np.ndarray:
    """Return of which joints the rate alone holds the torque back, bool (n_joints,)."""
    lowest, highest = _reach(before, elapsed, limits)
    allowed = np.clip(command, -limits.torque, limits.torque)
    return (allowed < lowest) | (allowed > highest)


def violation(names, measured, limits) -> str:
    """
    Return a sentence about the first joint beyond its margins; '' if none is.

    ``measured`` has ``q_link``, ``dq_link``, ``q_motor``, ``dq_motor`` (n_joints,) [rad, rad/s].
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
    j = int(np.argmax(np.abs(twist) > limits.twist))
    return (f'motor and link of {names[j]} are {twist[j]:.4g} rad apart, more than the '
            f'{limits.twist[j]:.4g} allowed; a sign, a gear ratio or an encoder may be wrong')


def jump(names, measured, before, elapsed, limits) -> str:
    """
    Return a sentence about the first angle that no joint can have come by; '' if there is none.

    ``before`` are ``q_link`` and ``q_motor`` [rad] of the state ``elapsed`` [s] earlier.
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
