# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Inertia of a link other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
from gms_flex_control.effects.guess import linear
from gms_flex_control.params.robot import RobotParams
import numpy as np


class LinkInertiaError(Change):
    """Mass and inertia of the link -> (1 + ratio) of them; its centre of mass stays."""

    name = 'link_inertia_error'
    evidence = 'link acceleration'
    confusable = ('tip_payload',)
    discriminated_by = 'the joint alone with the others bent and stretched'
    replaces = 'inertia'
    parameters = (Parameter('ratio', '1', 'relative error', lower=-0.95, relative=True,
                            typical=0.3),)
    guesses = staticmethod(lambda s: linear(0.1))
    excludes = staticmethod(lambda rigid: ('torque_gain',) if rigid else ())

    @staticmethod
    def change(robot, joint, values) -> RobotParams:
        factor = np.ones(robot.n_joints)
        factor[joint] += values[0]
        return replace(robot, arm=robot.arm.scaled(factor))
