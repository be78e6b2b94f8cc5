# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Frozen encoders as the controller node sees them: what is measured, sent and given."""

import math

from gms_flex_control.control.frozen_encoders import FrozenEncoders
import numpy as np

_NOTHING = 0.01  # of the torque limit: a motor of less effort is given none


class EncoderWatch:
    """
    Look for frozen encoders, state by state.

    What is sent need not act: limits between here and the motor make it less, a robot that is
    disabled or stopped makes it nothing. The efforts that the robot tells count where they are
    smaller; their signs and units may be anybody's.

    Parameters
    ----------
    robot : RobotParams
        As believed.
    torque_limit : ndarray, shape (n_joints,)
        Largest torque that is sent [N m].
    measured : object
        Where each state is written.

    Attributes
    ----------
    frozen : str
        Which encoder is frozen, since when and why; '' while none is.
    began : bool
        Whether that began with the last state.
    count : int
        How often it began.

    """

    def __init__(self, robot, torque_limit, measured):
        self._judge = FrozenEncoders(robot, torque_limit)
        self._measured = measured
        self._acting = np.zeros(robot.n_joints)
        self.frozen, self.began, self.count = '', False, 0
        self.use(torque_limit)

    def use(self, torque_limit):
        """Take another torque limit (n_joints,) [N m]."""
        self._judge.use(torque_limit)
        self._nothing = (_NOTHING * torque_limit).tolist()

    def reset(self):
        """Take back what was found."""
        self._judge.reset()
        self.frozen, self.began = '', False

    def act(self, torque, efforts):
        """
        Take what has acted on the motors until the state that is looked at next.

        Parameters
        ----------
        torque : ndarray, shape (n_joints,)
            Sent [N m].
        efforts : sequence of float
            What the robot says it gave, NaN where it does not measure that [N m]; may be empty.

        """
        self._acting[:] = torque
        for j, effort in enumerate(efforts):
            if abs(effort) <= self._nothing[j]:
                self._acting[j] = math.nan
            elif abs(effort) < abs(torque[j]):
                self._acting[j] = math.copysign(effort, torque[j])

    def look(self, elapsed):
        """Look at the state measured, ``elapsed`` [s] after the one before; return `frozen`."""
        before = self.frozen
        self.frozen = self._judge.look(self._measured, self._acting, elapsed) or ''
        self.began = bool(self.frozen) and not before
        self.count += self.began
        return self.frozen
