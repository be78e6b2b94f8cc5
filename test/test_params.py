# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Parameters that no robot has are refused in a sentence; test_schema has those of files."""

from dataclasses import replace

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.friction import FrictionParams, StribeckParams
from gms_flex_control.params.robot import EncoderParams
import numpy as np
import pytest

pytestmark = pytest.mark.fast


def steady(**changes):
    """Return a steady curve of one joint."""
    return StribeckParams(**{'static': [0.1], 'coulomb': [0.09], 'velocity': [0.01],
                             'viscous': [0.0]} | changes)


def blocks(**changes):
    """Return friction of one joint with two blocks."""
    return FrictionParams(forward=steady(), backward=steady(), **{
        'stiffness': [[1.0, 2.0]], 'weight': [[0.5, 0.5]], 'attraction': [1.0]} | changes)


def arm(**changes):
    """Return a chain of two links, the second joint rigid."""
    one = np.ones(2)
    return ArmParams(**{'kind': 'planar', 'mass': one, 'length': one, 'com': 0.5 * one,
                        'inertia': one, 'motor_inertia': one, 'damping': 0.0 * one,
                        'stiffness': [5.0, np.inf]} | changes)


@pytest.mark.parametrize(('make', 'changes', 'sentence'), [
    (steady, {'static': [0.08]}, r'static \[0.08\] is below coulomb .*were they swapped\?'),
    (steady, {'coulomb': [0.0]}, r'coulomb must be above 0, got \[0.\]'),
    (steady, {'velocity': [-0.01]}, r'velocity must be above 0, got \[-0.01\]'),
    (steady, {'viscous': [-0.01]}, r'viscous must be at least 0, got \[-0.01\]'),
    (steady, {'static': [np.nan]}, r'static must be finite, got \[nan\]'),
    (steady, {'viscous': [0.1, 0.2]}, r'viscous must have shape \(1,\) .* got shape \(2,\)'),
    (steady, {'velocity': ['fast']}, r"velocity must be numbers, got \['fast'\]"),
    (blocks, {'weight': [[0.5, 0.6]]}, r'weights must sum to 1 per joint, got sums \[1.1\]'),
    (blocks, {'weight': [[0.5, 0.25, 0.25]]}, r'block weight must have shape \(1, 2\)'),
    (blocks, {'stiffness': [[1.0, -1.0]]}, r'block stiffness must be at least 0'),
    (blocks, {'stiffness': [1.0, 1.0]}, r'block stiffness must have shape \(1, n_blocks\)'),
    (blocks, {'attraction': [0.0]}, r'attraction must be above 0'),
    (blocks, {'attraction': [1.0, 1.0]}, r'attraction must have shape \(1,\)'),
    (arm, {'kind': 'spatial'}, r"arm.kind must be one of planar, decoupled, urdf, got 'spatial'"),
    (arm, {'inertia': [-0.1, 0.1]}, r'inertia must be at least 0, got'),
    (arm, {'mass': [np.nan, 1.0]}, r'mass must be finite, got \[nan'),
    (arm, {'mass': [1.0, 1.0, 1.0]}, r'mass must have shape \(2,\) \(one entry per joint\)'),
    (arm, {'stiffness': [0.0, 1.0]}, r'stiffness must be above 0 \(.inf for a rigid joint\)'),
    (arm, {'motor_inertia': [0.0, 0.0]},
     r'motor_inertia must be above 0 where the joint is flexible'),
    (arm, {'inertia': [0.0, 0.0], 'com': [0.0, 0.1]}, r'each link needs inertia or mass away'),
    (arm, {'gravity': [1.0, 2.0, 3.0]}, r'gravity must have shape \(2,\)'),
    (arm, {'gravity': np.inf}, r'gravity must be finite'),
    (EncoderParams, {'counts': -1}, 'encoder counts must be at least 0, got -1.0'),
    (EncoderParams, {'noise': np.nan}, 'encoder noise must be finite, got nan'),
    (EncoderParams, {'velocity_cutoff': [50.0, 50.0]},
     r'encoder velocity_cutoff must have shape \(\)'),
    (EncoderParams, {'counts': 'many'}, "counts must be numbers, got 'many'")])
def test_what_cannot_be_is_refused(make, changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        make(**changes)


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'compensation': 'gsm'}, "compensation must be one of none, gms_paper, gms, .*got 'gsm'"),
    ({'kd_link': [-0.8, 0.8]}, r'kd_link must be at least 0, got \[-0.8  0.8\]'),
    ({'lambda_motor': [30.0]}, r'lambda_motor must have shape \(2,\)'),
    ({'observer_gain': [np.nan, 1.0]}, r'observer_gain must be finite'),
    ({'filter_bandwidth': [0.0, 100.0]}, r'filter_bandwidth must be above 0')])
def test_impossible_gains_are_refused(gains, changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        replace(gains, **changes)


@pytest.mark.parametrize(('changes', 'sentence'), [
    ({'joints': ('joint1', 'joint1')}, 'joints and motors need names of their own'),
    ({'joints': ('joint1', 'arm')}, "a joint cannot be called 'arm'"),
    ({'joints': ('joint1',)}, 'arm describes 2 joints, but joints names 1'),
    ({'motors': ('motor1', '')}, "joint 'joint2' is flexible but motors has no name for it"),
    ({'arm': arm()}, "joint 'joint2' is rigid .* but has motor")])
def test_names_that_make_no_robot_are_refused(robot, changes, sentence):
    with pytest.raises(ParameterError, match=sentence):
        replace(robot, **changes)
