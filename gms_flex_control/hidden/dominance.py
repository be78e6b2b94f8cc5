# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How much torque an effect makes in a run: among many, which is the dominant one."""

from dataclasses import replace

from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.hidden.sizes import rms
from gms_flex_control.simulation import plant
from scipy.ndimage import uniform_filter1d

_OVER = 0.06          # s, over which torque is averaged: quicker it hardly moves an arm


class Torques:
    """
    What effects make of a run.

    Parameters
    ----------
    recording : Recording
        Of the robot without effects.
    robot : RobotParams
        That robot.

    """

    def __init__(self, recording, robot):
        self._robot, self._motion = robot, motion_of(recording, robot)
        self._without = self._residual(robot)

    def _residual(self, robot):
        return unexplained(self._motion, plant.constants_of(robot))

    def of(self, spec):
        """Return the rms torque of an EffectSpec, of the larger equation [N m]."""
        change = self._residual(replace(self._robot, effects=(spec,))) - self._without
        width = max(round(_OVER / self._motion.period), 1)
        slow = uniform_filter1d(change, width, axis=0, mode='nearest')
        return float(rms(slow).max())
