# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.

"""Inertia of a link other than believed."""

from dataclasses import replace

from gms_flex_control.effects.base import Change, Parameter
import numpy as np


class LinkInertiaError(Change):
    """Mass and inertia of the link -> (1 + ratio) of them; its centre of mass stays."""

    name = 'link_inertia_error'
    parameters = (
        Parameter('ratio', '1', 'relative error', lower=-0.95),
    )

    @staticmethod
    def change(robot, joint, values):
        """Return the robot with the effect in it."""
        factor = np.ones(robot.n_joints)
        factor[joint] += values[0]
        arm = robot.arm
        return replace(robot, arm=replace(arm, mass=arm.mass * factor,
                                          inertia=arm.inertia * factor))
