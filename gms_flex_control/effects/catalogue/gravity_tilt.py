# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Base that is not level."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import wave
import numpy as np

STANDARD_GRAVITY = 9.80665  # [m/s^2], conventional value (3rd CGPM, 1901)


class GravityTilt(Change):
    """The plane of motion is tilted: gravity g sin(tilt) along a direction in the plane."""

    name = 'gravity_tilt'
    whole_arm = True
    needs_planar = True
    evidence = 'link angle'
    confusable = ()
    tells = 'rests in many poses all around'
    parameters = (
        Parameter('tilt', 'rad', 'angle between the plane and the horizontal'),
        Parameter('direction', 'rad', 'direction of steepest descent in the plane'),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return wave(0.002)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.015, None)

    @staticmethod
    def change(robot, joint, values):
        """Return the robot with the effect in it."""
        pull = STANDARD_GRAVITY * np.sin(values[0])
        extra = pull * np.array([np.cos(values[1]), np.sin(values[1])])
        return replace(robot, arm=replace(robot.arm, gravity=robot.arm.gravity + extra))
