# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Motor inertia other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear


class MotorInertiaError(Change):
    """J -> J (1 + ratio)."""

    name = 'motor_inertia_error'
    evidence = 'link acceleration'
    confusable = ()
    tells = 'fast motion of the motor with the link held'
    replaces = 'motor_inertia'
    parameters = (
        Parameter('ratio', '1', 'relative error', lower=-0.99, relative=True),
    )

    @classmethod
    def guesses(cls, scales):
        """Return how it might be there, list of Guess."""
        if scales.rigid and scales.link_inertia > 0.0:
            return []  # the joint's inertia is that of its link, too
        return linear(0.1)

    @classmethod
    def typical(cls, scales):
        """Return usual sizes of its parameters, tuple of float or None."""
        return (0.3,)

    @classmethod
    def excludes(cls, rigid):
        """Return what may not stand beside it, tuple of str."""
        return ('torque_gain',) if rigid else ()

    @staticmethod
    def change(robot, joint, values):
        """Return the robot with the effect in it."""
        motor_inertia = robot.arm.motor_inertia.copy()
        motor_inertia[joint] *= 1.0 + values[0]
        return replace(robot, arm=replace(robot.arm, motor_inertia=motor_inertia))
