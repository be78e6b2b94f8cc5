# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Fixtures shared by the tests of the physics core."""

from dataclasses import replace
from pathlib import Path

from gms_flex_control.params.encoder import EncoderParams
from gms_flex_control.schema.files import load_controller, load_robot
import pytest

CONFIG = Path(__file__).parents[1] / 'config'


@pytest.fixture(scope='session')
def robot():
    """Return the default robot, encoders included."""
    return load_robot(CONFIG / 'robot.yaml')


@pytest.fixture(scope='session')
def ideal_robot(robot):
    """Return the default robot measured without error."""
    return replace(robot, encoder=EncoderParams())


@pytest.fixture(scope='session')
def gains(robot):
    """Return the default gains."""
    return load_controller(CONFIG / 'controller.yaml', robot)
