# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Motor inertia other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear
from gms_flex_control.params.robot import RobotParams


class MotorInertiaError(Change):
    """J -> J (1 + ratio)."""

    name = 'motor_inertia_error'
    evidence = 'link acceleration'
    discriminated_by = 'fast motion of the motor with the link held'
    replaces = 'motor_inertia'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.99, relative=True,
                            typical=0.3),)
    excludes = staticmethod(lambda rigid: ('torque_gain',) if rigid else ())

    @staticmethod
    def guesses(scales) -> list:
        if scales.rigid and scales.link_inertia > 0.0:
            return []  # the joint's inertia is that of its link, too
        return linear(0.1)

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        motor_inertia = robot.arm.motor_inertia.copy()
        motor_inertia[joint] *= 1.0 + values[0]
        return replace(robot, arm=replace(robot.arm, motor_inertia=motor_inertia))
