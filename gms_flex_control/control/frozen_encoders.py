# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Angles that stay the same number where they cannot: a frozen encoder, or a blocked motor.

A driver may go on stamping the last angle of an encoder that has failed. An arm that stands also
gives the same number again and again, so there has to be a second witness:

- the rate: its integral since the angle changed last says how far the encoder should have come.
  The integral, not the rate at one time: it is what the angle is compared with, noise of no mean
  leaves it near zero, and a rate that is low-passed from the counts themselves ends at the one
  count it came from.
- the torque: a motor behind a spring has to give way to a torque that changes; averaged, because
  a single count makes a torque jump that no motor follows. A joint without a spring may stick, so
  that there the rate alone counts.
"""

import math

from gms_flex_control.compiled import compiled
from gms_flex_control.effects.registry import find
import numpy as np

STANDING = 0.03      # the same number for longer is looked at; between two states, silence [s]
TURNED = 0.02        # said by the rate meanwhile: frozen [rad]
_FORGOTTEN = 1.0     # time constant of that integral: a rate may be off by TURNED a second [s]
_SHARE = 0.25        # of TURNED that a single rate may add: it may be an outlier
_GIVEN_WAY = 0.005   # a motor moves by that much more than friction holds [rad]
_COUNTS = 4.0        # of the encoder that either angle is, at least
_AVERAGE = 0.02      # time constant of the torque, and how long it follows one that stands [s]
_HALF = 0.5          # of the torque limit
_NOTHING = 0.01      # of the torque limit: a motor of less effort is given none
# Friction turns round where motion does, a change by twice of it; which may be believed too small.
_FRICTION = 3.0


# what is remembered of each angle, row by row: the angle; for how long it is the same, and what
# should have turned it since; torque now and before, NaN while unknown, and for how long they
# differ by more than the limit; what was found
_SAME, _STILL, _TURNED, _TORQUE, _BEFORE, _PUSHED, _FOUND = range(7)
_BY_RATE, _BY_TORQUE, _REPORTED = 1.0, 2.0, 3.0


@compiled
def _wait(memory):
    """Ask for witnesses from now on; a finding stays."""
    for row in (_STILL, _TURNED, _PUSHED):
        memory[row] = 0.0
    memory[_TORQUE] = memory[_BEFORE] = np.nan


@compiled
def look(memory, q_link, dq_link, q_motor, dq_motor, torque, dt, motors, turn, limit,
         patience) -> bool:
    """
    Take the next sample into the ``memory``; return whether an angle is frozen.

    Its columns are the links, then the ``motors`` (indices of joints); see `FrozenEncoders.look`.
    """
    n, any_found = len(q_link), False
    if not 0.0 < dt <= STANDING:
        _wait(memory)
        dt = 0.0
    for i in range(memory.shape[1]):
        j = i if i < n else motors[i - n]
        angle, rate = (q_link[j], dq_link[j]) if i < n else (q_motor[j], dq_motor[j])
        if angle != memory[_SAME, i]:
            memory[_SAME, i] = angle
            memory[_STILL, i] = memory[_TURNED, i] = memory[_PUSHED, i] = memory[_FOUND, i] = 0.0
        else:
            memory[_STILL, i] += dt
            most = _SHARE * turn
            memory[_TURNED, i] += (min(max(rate * dt, -most), most)
                                   - memory[_TURNED, i] * dt / _FORGOTTEN)
        if i >= n and limit[j] < np.inf:
            _push(memory[:, i], torque[j], dt, limit[j])
        turned = abs(memory[_TURNED, i]) > turn
        if ((turned or i >= n and memory[_PUSHED, i] > patience[j])
                and memory[_STILL, i] > STANDING and memory[_FOUND, i] == 0.0):
            memory[_FOUND, i] = _BY_RATE if turned else _BY_TORQUE
        any_found = any_found or memory[_FOUND, i] > 0.0
    return any_found


@compiled
def _push(one, torque, dt, limit):
    """Take the torque [N m] since the sample before."""
    if math.isnan(torque):  # what acts later begins anew
        one[_TORQUE] = one[_BEFORE] = np.nan
        one[_PUSHED] = 0.0
        return
    if math.isnan(one[_TORQUE]):
        one[_TORQUE] = torque
    one[_TORQUE] += min(1.0, dt / _AVERAGE) * (torque - one[_TORQUE])
    if one[_STILL] <= _AVERAGE or math.isnan(one[_BEFORE]):
        one[_BEFORE] = one[_TORQUE]
    one[_PUSHED] = one[_PUSHED] + dt if abs(one[_TORQUE] - one[_BEFORE]) > limit else 0.0


@compiled
def acting(sent, efforts, nothing, torque) -> None:
    """
    Write into ``torque`` what is known to act on motors.

    What is ``sent`` need not act; the ``efforts`` that a robot reports, NaN where it does not,
    count where they are smaller; their signs and units may be anybody's. NaN for a motor of less
    than ``nothing``: it is given none. All (n_joints,) [N m].
    """
    for j in range(len(sent)):
        torque[j] = sent[j]
        if abs(efforts[j]) <= nothing[j]:
            torque[j] = np.nan
        elif abs(efforts[j]) < abs(sent[j]):
            torque[j] = math.copysign(efforts[j], sent[j])


class FrozenEncoders:
    """Distinguish encoders that have frozen from an arm that stands, by what is believed of it."""

    def __init__(self, robot, torque_limit):
        self._robot, names = robot, [*robot.joints, *filter(None, robot.motors)]
        self._names, self._sentences = names, [''] * len(names)
        self._motors = np.array([j for j, motor in enumerate(robot.motors) if motor], dtype=int)
        self._turn = max(TURNED, _COUNTS * _count(robot))
        self.memory = np.zeros((_FOUND + 1, len(names)))
        self.memory[_SAME] = np.nan
        _wait(self.memory)
        self.use(torque_limit)

    def use(self, torque_limit) -> None:
        """Use another torque limit (n_joints,) [N m]."""
        limits = torque_thresholds(self._robot, torque_limit)
        # of the threshold, friction may hold two thirds; the rest has to turn the rotor
        patience = np.maximum(STANDING, np.sqrt(
            6.0 * self._robot.arm.motor_inertia * _given_way(self._robot) / limits))
        self.expected = self._motors, self._turn, limits, patience  # as `look` takes it

    def reset(self) -> None:
        """Withdraw every finding."""
        self.memory[_FOUND] = 0.0
        _wait(self.memory)

    def look(self, measured, torque, dt) -> str | None:
        """
        Return which angle is frozen, since when and why, until each of them changes.

        ``measured`` has ``q_link``, ``dq_link``, ``q_motor``, ``dq_motor`` (n_joints,), all
        finite; ``torque`` (n_joints,) was sent since the state before, NaN to a motor that is
        known to get none [N m]. Nothing is known of the time ``dt`` since that state, by the
        stamps [s], if it is not positive or there was a silence.
        """
        if not look(self.memory, measured.q_link, measured.dq_link, measured.q_motor,
                    measured.dq_motor, torque, dt, *self.expected):
            return None
        frozen = np.flatnonzero(self.memory[_FOUND])
        for i in frozen[self.memory[_FOUND, frozen] < _REPORTED]:
            self._sentences[i] = self._finding(i)
            self.memory[_FOUND, i] = _REPORTED
        others = ', '.join(self._names[i] for i in frozen[1:])
        return self._sentences[frozen[0]] + (f'; so are {others}' if others else '')

    def _finding(self, i):
        angle, still, turned, torque, before, _, found = self.memory[:, i]
        why = (f'its velocity implies a motion of {abs(turned):.2g} rad: the encoder is frozen'
               if found == _BY_RATE else
               f'its torque changed by {abs(torque - before):.3g} N m: the encoder is frozen or '
               'the motor blocked')
        return (f'{self._names[i]} has been at exactly {angle:.6g} rad for {1e3 * still:.0f} ms '
                f'while {why}')


def torque_thresholds(robot, torque_limit) -> np.ndarray:
    """Return by how much a torque may change while a motor stands still (n_joints,) [N m]."""
    arm, friction = robot.arm, robot.friction
    static = np.maximum(friction.forward.static, friction.backward.static)
    for spec in robot.effects:
        static = static + find(spec.name).holding_torque(spec.values) * (
            np.array(robot.joints) == spec.joint)
    return np.maximum.reduce([arm.stiffness * _given_way(robot), _HALF * torque_limit,
                              _FRICTION * static])


def _count(robot):
    counts = float(robot.encoder.counts)
    return 2.0 * math.pi / counts if counts > 0.0 else 0.0


def _given_way(robot):
    return max(_GIVEN_WAY, _COUNTS * _count(robot))


class EncoderWatch:
    """Look for frozen encoders, state by state."""

    def __init__(self, robot, torque_limit, measured):
        self.judge = FrozenEncoders(robot, torque_limit)
        self._measured = measured
        self._acting, self._silent = np.zeros(robot.n_joints), np.full(robot.n_joints, np.nan)
        self.frozen, self.began, self.count = '', False, 0   # a finding, whether it is new
        self.use(torque_limit)

    def use(self, torque_limit) -> None:
        """Take another torque limit (n_joints,) [N m]."""
        self.judge.use(torque_limit)
        self.nothing = _NOTHING * torque_limit

    def reset(self) -> None:
        """Take back what was found."""
        self.judge.reset()
        self.frozen, self.began = '', False

    def act(self, torque, efforts) -> None:
        """
        Take what has acted on the motors until the state that is looked at next.

        ``torque`` (n_joints,) was sent; ``efforts`` are what the robot says it gave, NaN where it
        does not measure that, empty if it says nothing [N m].
        """
        acting(torque, np.array(efforts) if efforts else self._silent, self.nothing, self._acting)

    def look(self, elapsed) -> str:
        """Look at the state measured, ``elapsed`` [s] after the one before; return `frozen`."""
        before = self.frozen
        self.frozen = self.judge.look(self._measured, self._acting, elapsed) or ''
        self.began = bool(self.frozen) and not before
        self.count += self.began
        return self.frozen
