# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What drives a link, spring or motor torque: healthy data are believed, contradictions named."""

from dataclasses import replace
import warnings

from faulty import healthy
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.assumed_robot import only_joints, rigid_joints
from gms_flex_control.identification.segments import drive_sides, TorqueWarning
import numpy as np
import pytest


def test_some_joints_of_a_robot_file_are_taken_in_their_order():
    axes = rigid_joints(['x', 'y', 'z'])
    axes = replace(axes, arm=replace(axes.arm, inertia=[1.0, 2.0, 3.0]))
    chosen = only_joints(axes, ['z', 'x'])
    assert chosen.joints == ('z', 'x') and chosen.motors == ('', '')
    np.testing.assert_array_equal(chosen.arm.inertia, [3.0, 1.0])
    assert chosen.friction.stiffness.shape == (2, axes.friction.stiffness.shape[1])
    with pytest.raises(IdentificationError, match='--joints w: the robot has x, y, z'):
        only_joints(axes, ['w'])


@pytest.mark.parametrize('name', ['sinusoid', 'noise', 'polynomial', 'fast moves', 'slow',
                                  'stick-slip', 'gravity', 'stiff', 'damped'])
def test_the_spring_is_believed_where_its_stiffness_is_right(name):
    """A controller's answer to the steps of encoders is no contradiction."""
    with warnings.catch_warnings():
        warnings.simplefilter('error', TorqueWarning)
        assert drive_sides(*healthy(name)) == ('spring', 'spring')


@pytest.mark.parametrize('factor', [0.3, 2.5])
def test_a_stiffness_far_off_is_a_contradiction(factor):
    """Spring and motor torque differ by more than half: the motor torque is taken, and said."""
    recording, robot = healthy('unlike')
    stiffness = robot.arm.stiffness * np.array([1.0, factor])
    wrong = replace(robot, arm=replace(robot.arm, stiffness=stiffness))
    with pytest.warns(TorqueWarning, match='joint2 differs from the motor equation'):
        assert drive_sides(recording, wrong) == ('spring', 'motor')
