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

from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.effects.registry import find
from gms_flex_control.records import FLOAT
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


ANGLE = records.layout(  # what is remembered of each angle
    ('angle', FLOAT),          # [rad]
    ('still', FLOAT),          # for how long it is the same [s]
    ('turned', FLOAT),         # by how much the rate should have turned it since [rad]
    ('torque', FLOAT),         # averaged, NaN while unknown [N m]
    ('torque_before', FLOAT),  # while it last turned, likewise
    ('pushed', FLOAT),         # for how long both differ by more than the limit [s]
    ('state', np.int64))       # one of those below
_MOVES, _FROZEN_BY_RATE, _FROZEN_BY_TORQUE, _REPORTED = range(4)


@compiled
def _await_witnesses(memory):
    """Forget the witnesses so far; an angle that is frozen stays so."""
    for i in range(len(memory)):
        memory[i].still = memory[i].turned = memory[i].pushed = 0.0
        memory[i].torque = memory[i].torque_before = np.nan


@compiled
def look(memory, q_link, dq_link, q_motor, dq_motor, torque, dt, motors, turn, limit,
         patience) -> bool:
    """
    Take the next sample into the ``memory`` of ANGLEs; return whether one of them is frozen.

    They are the links', then those of ``motors`` (indices of joints); see `FrozenEncoders.look`.
    """
    n, any_frozen = len(q_link), False
    if not 0.0 < dt <= STANDING:
        _await_witnesses(memory)
        dt = 0.0
    for i in range(len(memory)):
        one, j = memory[i], i if i < n else motors[i - n]
        angle, rate = (q_link[j], dq_link[j]) if i < n else (q_motor[j], dq_motor[j])
        if angle != one.angle:
            one.angle, one.state = angle, _MOVES
            one.still = one.turned = one.pushed = 0.0
        else:
            one.still += dt
            most = _SHARE * turn
            one.turned += min(max(rate * dt, -most), most) - one.turned * dt / _FORGOTTEN
        if i >= n and limit[j] < np.inf:
            _push(one, torque[j], dt, limit[j])
        turned = abs(one.turned) > turn
        if ((turned or i >= n and one.pushed > patience[j])
                and one.still > STANDING and one.state == _MOVES):
            one.state = _FROZEN_BY_RATE if turned else _FROZEN_BY_TORQUE
        any_frozen = any_frozen or one.state != _MOVES
    return any_frozen


@compiled
def _push(one, torque, dt, limit):
    """Take the torque [N m] since the sample before into the memory of ``one`` angle."""
    if math.isnan(torque):  # what acts later begins anew
        one.torque = one.torque_before = np.nan
        one.pushed = 0.0
        return
    if math.isnan(one.torque):
        one.torque = torque
    one.torque += min(1.0, dt / _AVERAGE) * (torque - one.torque)
    if one.still <= _AVERAGE or math.isnan(one.torque_before):
        one.torque_before = one.torque
    one.pushed = one.pushed + dt if abs(one.torque - one.torque_before) > limit else 0.0


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
        self.memory = np.zeros(len(names), ANGLE)
        self.memory['angle'] = np.nan
        _await_witnesses(self.memory)
        self.use(torque_limit)

    def use(self, torque_limit) -> None:
        """Use another torque limit (n_joints,) [N m]."""
        limits = torque_thresholds(self._robot, torque_limit)
        # of the threshold, friction may hold two thirds; the rest has to turn the rotor
        patience = np.maximum(STANDING, np.sqrt(
            6.0 * self._robot.arm.motor_inertia * _given_way(self._robot) / limits))
        self.expected = self._motors, self._turn, limits, patience  # as `look` takes it

    def reset(self) -> None:
        """Take every angle for one that moves."""
        self.memory['state'] = _MOVES
        _await_witnesses(self.memory)

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
        frozen = np.flatnonzero(self.memory['state'] != _MOVES)
        for i in frozen[self.memory['state'][frozen] != _REPORTED]:
            self._sentences[i] = _sentence(self._names[i], self.memory[i])
            self.memory['state'][i] = _REPORTED
        others = ', '.join(self._names[i] for i in frozen[1:])
        return self._sentences[frozen[0]] + (f'; so are {others}' if others else '')


def _sentence(name, one):
    why = (f'its velocity implies a motion of {abs(one.turned):.2g} rad: the encoder is frozen'
           if one.state == _FROZEN_BY_RATE else
           f'its torque changed by {abs(one.torque - one.torque_before):.3g} N m: the encoder is '
           'frozen or the motor blocked')
    return (f'{name} has been at exactly {one.angle:.6g} rad for {1e3 * one.still:.0f} ms while '
            f'{why}')


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
        self.frozen, self.began, self.count = '', False, 0   # in words, whether just now
        self.use(torque_limit)

    def use(self, torque_limit) -> None:
        """Take another torque limit (n_joints,) [N m]."""
        self.judge.use(torque_limit)
        self.nothing = _NOTHING * torque_limit

    def reset(self) -> None:
        """Take no angle for frozen."""
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
