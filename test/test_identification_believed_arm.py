# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction is fitted beside links that may be off: those of closed forms come out right."""

from dataclasses import replace

from gms_flex_control.identification.arm_fit import with_axis
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.believed_arm import believed_arm
from gms_flex_control.identification.identify import identify, Options
from identified_axis import pendulum
import numpy as np
import pytest

INERTIA, PULL, OFFSET = 0.02, 0.5, -1.2
COULOMB = 0.06


def described(heavier=1.0, **uncertainty):
    """Return the robot of `pendulum` as it is described, its gravity so many times the true."""
    robot = rigid_joints(['swing'])
    pull = heavier * PULL
    return replace(robot, arm=with_axis(robot.arm, 0, INERTIA, pull * np.cos(OFFSET),
                                        -pull * np.sin(OFFSET)),
                   uncertainty={(kind, 'swing'): sd for kind, sd in uncertainty.items()})


def moment(arm):
    return arm.mass[0] * arm.com[0] * np.hypot(*arm.gravity)


@pytest.mark.parametrize('heavier', [0.96, 1.0, 1.04])
def test_friction_is_that_of_the_joint_where_a_link_weighs_less_than_described(heavier):
    """Gravity that is 4 % off is a third of this friction: relied on, it makes that 55 % wrong."""
    found = identify([pendulum()], described(heavier), options=Options(blocks=(1,)))
    for side in (found.robot.friction.forward, found.robot.friction.backward):
        assert side.coulomb[0] == pytest.approx(COULOMB, rel=0.05)
    assert found.robot.arm.mass[0] == found.believed.arm.mass[0]  # as described


def test_recordings_show_the_arm_that_is_hardly_known():
    arm = believed_arm([pendulum()], described(1.3, gravity=0.3, inertia=0.3))
    assert moment(arm) == pytest.approx(PULL, rel=5e-3)
