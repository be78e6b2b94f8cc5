# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a robot may do, whatever the controller says: torque, rate, velocity, range, torsion."""

from dataclasses import dataclass
from functools import cached_property

from gms_flex_control.compiled import compiled
from gms_flex_control.errors import ParameterError
from gms_flex_control.params.key import freeze_arrays, number, require_ranges, SMALLEST
import numpy as np

UNLIMITED = 1e9           # of a limit that nobody gave
NEEDED = ('torque', 'torque_rate', 'velocity', 'lower', 'upper')  # of every joint that is real
_SHORTEST = 0.01          # a step of the angle is judged as if it took at least that long [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Limits of each joint (n_joints,), `UNLIMITED` where absent; ParameterError if impossible."""

    torque: np.ndarray = number('largest torque given to the robot', 'N m', UNLIMITED, 0.0,
                                UNLIMITED)
    torque_rate: np.ndarray = number('fastest rise of the torque; it may fall at once', 'N m/s',
                                     UNLIMITED, SMALLEST, UNLIMITED)
    velocity: np.ndarray = number('speed from which on no torque adds to it', 'rad/s', UNLIMITED,
                                  SMALLEST, UNLIMITED)
    velocity_margin: np.ndarray = number('beyond that by so much: FAULT', 'rad/s', 0.5, 0.0,
                                         UNLIMITED)
    lower: np.ndarray = number('least angle; beyond it only inward torque', 'rad', -UNLIMITED,
                               -UNLIMITED, UNLIMITED)
    upper: np.ndarray = number('largest angle; beyond it only inward torque', 'rad', UNLIMITED,
                               -UNLIMITED, UNLIMITED)
    position_margin: np.ndarray = number('beyond the range by so much: FAULT', 'rad', 0.1, 0.0,
                                         UNLIMITED)
    torsion: np.ndarray = number('motor minus link angle that is a FAULT', 'rad', UNLIMITED,
                                 SMALLEST, UNLIMITED)

    def __post_init__(self):
        freeze_arrays(self)
        require_ranges(self, self.torque.shape, 'limits: ')
        if not (self.lower < self.upper).all():
            raise ParameterError(f'limits: lower {self.lower} must be below upper {self.upper}; '
                                 'were they swapped?')

    @cached_property
    def within(self) -> tuple:
        """Return least and most link angle, fastest side and largest torsion, margins added."""
        return (self.lower - self.position_margin, self.upper + self.position_margin,
                self.velocity + self.velocity_margin, self.torsion)

    @cached_property
    def allowed(self) -> tuple:
        """Return limits of torque, torque rate, speed and both angles, in the order of `limit`."""
        return self.torque, self.torque_rate, self.velocity, self.lower, self.upper

    def missing(self, joints) -> str:
        """Return the first limit of ``joints`` that no real robot may lack, '' if none lacks."""
        return next((f'limits.{joint}.{name}' for j, joint in enumerate(joints) for name in NEEDED
                     if abs(getattr(self, name)[j]) >= UNLIMITED), '')


def limited(command, before, elapsed, q, dq, limits, held=None) -> np.ndarray:
    """
    Return the torque (n_joints,) [N m] that a command may become; zero is always allowed.

    ``command``, finite [N m], is clipped to ``torque`` and to a rise of ``torque_rate`` in
    ``elapsed`` [s] beyond the torque ``before`` or zero, whichever is further. It is zero where
    it points out of the range or would speed up a link, at ``q`` [rad] and ``dq`` [rad/s], that
    is as fast as it may be. ``held``, bool (n_joints,), is set where the rate alone held it back.
    """
    torque = np.empty(len(command))
    limit(command, before, elapsed, q, dq, *limits.allowed, torque,
          np.empty(len(torque), bool) if held is None else held)
    return torque


@compiled
def limit(command, before, elapsed, q, dq, most, rate, velocity, lower, upper, torque,
          held) -> None:
    """Write into ``torque`` what `limited` returns."""
    for j in range(len(command)):
        rise = rate[j] * max(elapsed, 0.0)
        wanted = min(max(command[j], -most[j]), most[j])
        given = min(max(wanted, min(before[j], 0.0) - rise), max(before[j], 0.0) + rise)
        held[j] = given != wanted
        given = min(max(given, -most[j]), most[j])
        if ((q[j] >= upper[j] or dq[j] >= velocity[j]) and given > 0.0
                or (q[j] <= lower[j] or dq[j] <= -velocity[j]) and given < 0.0):
            given = 0.0
        torque[j] = given


@compiled
def is_within(now, before, elapsed, least, most, fastest, torsion) -> bool:
    """Return whether `violation` and `jump` find nothing between two states (4, n); fast."""
    for j in range(now.shape[1]):
        far = fastest[j] * max(elapsed, _SHORTEST)
        if not (least[j] <= now[0, j] <= most[j] and abs(now[2, j] - now[0, j]) <= torsion[j]
                and abs(now[1, j]) <= fastest[j] and abs(now[3, j]) <= fastest[j]
                and abs(now[0, j] - before[0, j]) <= far
                and abs(now[2, j] - before[2, j]) <= far):
            return False
    return True


def violation(names, measured, limits) -> str:
    """Return a sentence about the first joint ``measured`` beyond its margins; '' if none is."""
    return next(_violations(names, measured, limits), '')


def _violations(names, measured, limits):
    q, torsion = measured.q_link, measured.q_motor - measured.q_link
    least, most, fastest, farthest = limits.within
    for j in np.flatnonzero((q > most) | (q < least)):
        yield (f'{names[j]} is at {q[j]:.4g} rad, beyond its range of {limits.lower[j]:.4g} to '
               f'{limits.upper[j]:.4g} by more than {limits.position_margin[j]:.4g} rad')
    for side, dq in (('link', measured.dq_link), ('motor', measured.dq_motor)):
        for j in np.flatnonzero(np.abs(dq) > fastest):
            yield (f'the {side} side of {names[j]} moves at {dq[j]:.4g} rad/s, above its limit '
                   f'of {limits.velocity[j]:.4g} by more than {limits.velocity_margin[j]:.4g}')
    for j in np.flatnonzero(np.abs(torsion) > farthest):
        yield (f'motor and link of {names[j]} are {torsion[j]:.4g} rad apart, more than the '
               f'{farthest[j]:.4g} allowed; a sign, a gear ratio or an encoder may be wrong')


def jump(names, measured, before, elapsed, limits) -> str:
    """Return a sentence on the first angle no joint can come to from ``before``; '' if all can."""
    far = limits.within[2] * max(elapsed, _SHORTEST)
    return next((f'{what}{names[j]} jumped from {last[j]:.4g} to {q[j]:.4g} rad within '
                 f'{elapsed * 1e3:.3g} ms; look at its encoder'
                 for what, q, last in (('', measured.q_link, before[0]),
                                       ('the motor of ', measured.q_motor, before[1]))
                 for j in np.flatnonzero(np.abs(q - last) > far)), '')
