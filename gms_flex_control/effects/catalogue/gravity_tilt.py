# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Base that is not level."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import wave
from gms_flex_control.params.robot import RobotParams
import numpy as np

STANDARD_GRAVITY = 9.80665  # [m/s^2], conventional value (3rd CGPM, 1901)


class GravityTilt(Change):
    """
    The plane of motion is tilted: gravity g sin(tilt) along a direction in the plane.

    In space gravity turns by the tilt from where the file has it towards the direction, which
    counts from the x axis of the base where that is level, towards its y axis.
    """

    name = 'gravity_tilt'
    whole_arm = True
    needs_chain = True
    evidence = 'link angle'
    discriminated_by = 'rests in many poses all around'
    parameters = (
        Parameter('tilt', 'rad', 'angle between the plane, or the base, and the horizontal',
                  typical=0.015),
        Parameter('direction', 'rad', 'direction of steepest descent'))
    guesses = staticmethod(lambda s: wave(0.002))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        tilt, direction = values
        arm = robot.arm
        if arm.frames is None:
            pull = STANDARD_GRAVITY * np.sin(tilt)
            extra = pull * np.array([np.cos(direction), np.sin(direction)])
            return replace(robot, arm=replace(arm, gravity=arm.gravity + extra))
        pull = np.linalg.norm(arm.gravity)
        if pull == 0.0:
            return robot
        down = arm.gravity / pull
        x = np.eye(3)[np.argmin(np.abs(down) > 0.99)]  # the x axis unless that is vertical
        x = x - down * (down @ x)
        x /= np.linalg.norm(x)
        level = np.cos(direction) * x + np.sin(direction) * np.cross(x, down)
        return replace(robot, arm=replace(arm, gravity=pull * (
            np.cos(tilt) * down + np.sin(tilt) * level)))
