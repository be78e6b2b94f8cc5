# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""From what a robot calls and counts to joint angles and torques, and back."""

from dataclasses import dataclass

from gms_flex_control.errors import ParameterError
import numpy as np


@dataclass(frozen=True, kw_only=True)
class Reading:
    """
    One encoder: angle of the joint = sign * reading / ratio + offset.

    Parameters
    ----------
    name : str
        In the robot's joint states.
    sign : float
        1 if the reading grows with the joint angle, -1 if it falls.
    ratio : float
        Turns of the encoder per turn of the joint; 1 if it sits at the joint or the robot has
        divided already.
    offset : float
        Joint angle where the encoder reads 0 [rad].

    """

    name: str
    sign: float = 1.0
    ratio: float = 1.0
    offset: float = 0.0

    def __post_init__(self):
        if self.sign not in (-1.0, 1.0):
            raise ParameterError(f'{self.name}: sign must be 1 or -1, got {self.sign:g}')
        if not self.ratio > 0.0:
            raise ParameterError(f'{self.name}: ratio must be above 0, got {self.ratio:g}; '
                                 'a reversed encoder has sign -1')


@dataclass(frozen=True, kw_only=True)
class Actuation:
    """
    One actuator: torque at the joint = sign * torque_constant * gear * effort.

    Parameters
    ----------
    name : str
        In the robot's joint states and commands.
    sign : float
        1 if positive effort drives the joint forward, else -1.
    torque_constant : float
        Torque at the motor shaft per unit of effort [N m]; 1 if efforts are torques.
    gear : float
        Torque at the joint per torque the effort stands for: the gear ratio, or 1 if the robot
        speaks of torques at the joint.

    """

    name: str
    sign: float = 1.0
    torque_constant: float = 1.0
    gear: float = 1.0

    def __post_init__(self):
        if self.sign not in (-1.0, 1.0):
            raise ParameterError(f'{self.name}: sign must be 1 or -1, got {self.sign:g}')
        for name in ('torque_constant', 'gear'):
            if not getattr(self, name) > 0.0:
                raise ParameterError(f'{self.name}: {name} must be above 0, '
                                     f'got {getattr(self, name):g}')


class JointMap:
    """
    Mapping of a whole robot.

    Parameters
    ----------
    joints : sequence of str
        Our names of the joints, n of them.
    links : sequence of Reading
        Link side of each joint.
    motors : sequence of Reading or None
        Motor side; None where a joint is rigid.
    actuators : sequence of Actuation
        What turns each joint.
    order : sequence of str
        Our names in the order in which the robot takes its efforts; empty for that of ``joints``.

    Raises
    ------
    ParameterError
        If two encoders or two actuators share a name or ``order`` is no order of the joints.

    """

    def __init__(self, joints, links, motors, actuators, order=()):
        self.joints = tuple(joints)
        order = tuple(order) or self.joints
        if sorted(order) != sorted(self.joints):
            raise ParameterError(f'the order of the commands {list(order)} must name each of '
                                 f'{list(self.joints)} once')
        self._order = np.array([self.joints.index(name) for name in order])
        readings = [*links, *(motor for motor in motors if motor is not None)]
        self.names = tuple(reading.name for reading in readings)
        for what, where, called in (
                ('encoders', 'in the joint states', self.names),
                ('actuators', 'in the commands', tuple(a.name for a in actuators))):
            twice = [name for name in called if called.count(name) > 1]
            if twice:
                raise ParameterError(f'two {what} are both called {twice[0]!r} {where}')
        self._sign_over_ratio = np.array([r.sign / r.ratio for r in readings])
        self._offset = np.array([r.offset for r in readings])
        n, flexible = len(self.joints), [motor is not None for motor in motors]
        self._motor_channel = np.arange(n)
        self._motor_channel[flexible] = n + np.arange(sum(flexible))
        self._scale = np.array([a.sign * a.torque_constant * a.gear for a in actuators])
        self.command_names = tuple(actuators[j].name for j in self._order)
        # some robots tell an effort under a name that no encoder has
        self.effort_names = tuple(dict.fromkeys([*self.names, *(a.name for a in actuators)]))
        self._effort_channel = [self.effort_names.index(a.name) for a in actuators]

    def angle(self, reading, channel):
        """Return joint angles [rad] of ``reading`` (k,) of the encoders ``channel`` (k,)."""
        return reading * self._sign_over_ratio[channel] + self._offset[channel]

    def rate(self, reading, channel):
        """Return joint velocities [rad/s] of what the encoders ``channel`` (k,) report."""
        return reading * self._sign_over_ratio[channel]

    def sides(self, values):
        """Return values of link and motor side (n_joints,) from those of all encoders."""
        return values[:len(self.joints)], values[self._motor_channel]

    def efforts(self, torque):
        """Return efforts in the robot's units and order from torques (n_joints,) [N m]."""
        return (torque / self._scale)[self._order] + 0.0  # never -0

    def torques(self, efforts, otherwise):
        """
        Turn efforts by `effort_names`, NaN where unknown, into torques of the joints [N m].

        ``otherwise`` (n_joints,) stands in where the robot measures none.
        """
        torque = efforts[self._effort_channel] * self._scale
        return np.where(np.isfinite(torque), torque, otherwise)
