# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction at low speed other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear
from gms_flex_control.params.robot import RobotParams
import numpy as np


class StribeckError(Change):
    """F_s -> F_s + ratio F_c, in both directions, but never below F_c."""

    name = 'stribeck_error'
    evidence = 'link rate'
    confusable = ('low_speed_friction',)
    discriminated_by = 'slow motion at many constant speeds'
    replaces = 'static'
    parameters = (Parameter('ratio', '1', 'further friction at rest over the Coulomb level',
                            lower=-0.95, relative=True, typical=0.3),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        ratio = np.zeros(robot.n_joints)
        ratio[joint] = values[0]
        sides = {side: replace(steady, static=np.maximum(
            steady.static + ratio * steady.coulomb, steady.coulomb))
            for side, steady in (('forward', robot.friction.forward),
                                 ('backward', robot.friction.backward))}
        return replace(robot, friction=replace(robot.friction, **sides))
