# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What drives a link, spring or motor torque: healthy data are believed, contradictions named."""

from dataclasses import replace
import warnings

from gms_flex_control.identification.segments import drive_sides, TorqueWarning
import numpy as np
import pytest
from test_identification_checks import healthy


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
