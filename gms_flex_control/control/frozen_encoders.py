# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
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
# Friction turns round where motion does, a change by twice of it; which may be believed too small.
_FRICTION = 3.0


class _Angle:
    """One encoder: since when it has said the same, and what should have turned it meanwhile."""

    __slots__ = ('name', 'turn', 'limit', 'patience', 'angle', 'sentence', 'still', 'turned',
                 'torque', 'before', 'pushed')

    def __init__(self, name, turn):
        self.name, self.turn = name, turn
        self.limit = self.patience = math.inf   # of a torque that has to turn it [N m], [s]
        self.angle = self.sentence = None
        self.wait()

    def wait(self) -> None:
        """Ask for witnesses from now on; a finding stays."""
        self.still = self.turned = self.pushed = 0.0
        self.torque = self.before = None

    def look(self, angle, rate, torque, dt) -> None:
        """Take the next sample; see `FrozenEncoders.look`."""
        if angle != self.angle:
            self.angle, self.sentence = angle, None
            self.still = self.turned = self.pushed = 0.0
        else:
            self.still += dt
            step, most = rate * dt, _SHARE * self.turn
            self.turned += min(max(step, -most), most) - self.turned * dt / _FORGOTTEN
        if self.limit < math.inf:
            self._push(torque, dt)
        turned, pushed = abs(self.turned) > self.turn, self.pushed > self.patience
        if (turned or pushed) and self.still > STANDING and self.sentence is None:
            self.sentence = self._finding(turned)

    def _push(self, torque, dt):
        """Take the torque since the sample before."""
        if math.isnan(torque):  # what acts later begins anew
            self.torque = self.before = None
            self.pushed = 0.0
            return
        if self.torque is None:
            self.torque = torque
        self.torque += min(1.0, dt / _AVERAGE) * (torque - self.torque)
        if self.still <= _AVERAGE or self.before is None:
            self.before = self.torque
        self.pushed = self.pushed + dt if abs(self.torque - self.before) > self.limit else 0.0

    def _finding(self, turned):
        why = (f'its velocity implies a motion of {abs(self.turned):.2g} rad: the encoder is '
               'frozen'
               if turned else
               f'its torque changed by {abs(self.torque - self.before):.3g} N m: '
               'the encoder is frozen or the motor blocked')
        return (f'{self.name} has been at exactly {self.angle:.6g} rad for '
                f'{1e3 * self.still:.0f} ms while {why}')


class FrozenEncoders:
    """
    Distinguish encoders that have frozen from an arm that stands.

    Springs, friction and encoders of the RobotParams, as believed, set what is to be expected;
    ``torque_limit`` (n_joints,) is the largest torque that is sent [N m].
    """

    def __init__(self, robot, torque_limit):
        self._robot = robot
        turn = max(TURNED, _COUNTS * _count(robot))
        self._links = [_Angle(name, turn) for name in robot.joints]
        self._motors = [_Angle(name, turn) if name else None for name in robot.motors]
        self._angles = [*self._links, *filter(None, self._motors)]
        self.use(torque_limit)

    def use(self, torque_limit) -> None:
        """Use another torque limit (n_joints,) [N m]."""
        arm = self._robot.arm
        limits = torque_thresholds(self._robot, torque_limit)
        for j, motor in enumerate(self._motors):
            if motor is not None:
                motor.limit = float(limits[j])
                # of the threshold, friction may hold two thirds; the rest has to turn the rotor
                motor.patience = max(STANDING, math.sqrt(
                    6.0 * arm.motor_inertia[j] * _given_way(self._robot) / limits[j]))

    def reset(self) -> None:
        """Withdraw every finding."""
        for one in self._angles:
            one.sentence = None
            one.wait()

    def look(self, measured, torque, dt) -> str | None:
        """
        Return which angle is frozen, since when and why, until each of them changes.

        ``measured`` has ``q_link``, ``dq_link``, ``q_motor``, ``dq_motor`` (n_joints,), all
        finite; ``torque`` (n_joints,) was sent since the state before, NaN to a motor that is
        known to get none [N m]. Nothing is known of the time ``dt`` since that state, by the
        stamps [s], if it is not positive or there was a silence.
        """
        torque = torque.tolist()
        if not 0.0 < dt <= STANDING:
            for one in self._angles:
                one.wait()
            dt = 0.0
        for one, angle, rate in zip(self._links, measured.q_link.tolist(),
                                    measured.dq_link.tolist(), strict=True):
            one.look(angle, rate, 0.0, dt)
        for one, angle, rate, given in zip(self._motors, measured.q_motor.tolist(),
                                           measured.dq_motor.tolist(), torque, strict=True):
            if one is not None:
                one.look(angle, rate, given, dt)
        frozen = [one for one in self._angles if one.sentence]
        if not frozen:
            return None
        others = ', '.join(one.name for one in frozen[1:])
        return frozen[0].sentence + (f'; so are {others}' if others else '')


def torque_thresholds(robot, torque_limit) -> np.ndarray:
    """
    Return by how much a torque may change while a motor stands still (n_joints,) [N m].

    What friction could hold wherever in the joint it is, and what the spring gives way to, with
    room for both; infinite for joints without a spring.
    """
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
