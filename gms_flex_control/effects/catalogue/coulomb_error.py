# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Level of the friction other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear
from gms_flex_control.params.robot import RobotParams
import numpy as np


class CoulombError(Change):
    """F_s and F_c -> (1 + ratio) of them, in both directions; block stiffnesses stay."""

    name = 'coulomb_error'
    evidence = 'link rate'
    confusable = ('friction_drift',)
    discriminated_by = 'the same motion at the beginning and at the end of a long run'
    replaces = 'level'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.95, relative=True,
                            typical=0.3),)
    guesses = staticmethod(lambda s: linear(0.1))

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        factor = np.ones(robot.n_joints)
        factor[joint] += values[0]
        sides = {side: replace(steady, static=steady.static * factor,
                               coulomb=steady.coulomb * factor)
                 for side, steady in (('forward', robot.friction.forward),
                                      ('backward', robot.friction.backward))}
        return replace(robot, friction=replace(robot.friction, **sides))
