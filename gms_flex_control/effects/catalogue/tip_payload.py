# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Mass carried at the tip."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear


class TipPayload(Change):
    """The last link carries a point mass at its end."""

    name = 'tip_payload'
    whole_arm = True
    needs_planar = True
    evidence = 'link acceleration'
    confusable = ('link_inertia_error',)
    tells = 'the same motion with the last link bent and stretched'
    parameters = (
        Parameter('mass', 'kg', 'mass of the payload', lower=0.0),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        return linear(0.05, positive=True)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.1 * scales.mass,)

    @staticmethod
    def change(robot, joint, values):
        """Return the robot with the effect in it."""
        arm = robot.arm
        mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
        whole = mass[-1] + values[0]
        if whole == 0.0:
            return robot
        com[-1] = (arm.mass[-1] * arm.com[-1] + values[0] * arm.length[-1]) / whole
        inertia[-1] += (arm.mass[-1] * (arm.com[-1] - com[-1]) ** 2
                        + values[0] * (arm.length[-1] - com[-1]) ** 2)
        mass[-1] = whole
        return replace(robot, arm=replace(arm, mass=mass, com=com, inertia=inertia))
