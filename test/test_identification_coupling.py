# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Axes fitted one by one that act on each other are told of, those that do not are not."""

from functools import cache

from faulty import ROOT, UNLIKE
from gms_flex_control.experiment.simulated import read_plan, simulate
from gms_flex_control.identification.assumed_robot import believed_model
from gms_flex_control.identification.coordinates import Coordinates
from gms_flex_control.identification.identify import Data
from gms_flex_control.identification.objective import held_out, Objective
from gms_flex_control.identification.prediction_error import coupling_sentences
import numpy as np
import pytest


@cache
def data(kind):
    """Return the robot as decoupled axes, and Data of two links moving together as ``kind``."""
    files = [ROOT / 'config' / f'{stem}.yaml' for stem in ('robot', 'controller', 'sinusoid')]
    plan = read_plan(files, overrides=UNLIKE | {'arm.kind': kind, 'duration': 30.0})
    axes = read_plan(files, overrides=UNLIKE | {'arm.kind': 'decoupled'}).robot
    return axes, Data([(simulate(plan, kind), ())], (), believed_model(axes))


def theta(robot, j):
    """Return the true parameters of a joint."""
    f = robot.friction
    sides = [[getattr(side, name)[j] for side in (f.forward, f.backward)]
             for name in ('static', 'coulomb', 'velocity', 'viscous')]
    coordinates = Coordinates(6)
    yields = np.mean(sides[0]) / 6.0 / f.stiffness[j]
    return coordinates.unpack(coordinates.pack(*sides, f.attraction[j], yields))[0]


def sentences(kind, joint):
    """Return what is said of a joint whose friction is known."""
    robot, found = data(kind)
    thetas = [theta(robot, j) for j in range(2)]
    return coupling_sentences(Objective(found.bundle, joint, thetas), found.bundle,
                              thetas[joint], robot.joints, held_out(found.bundle.period))


@pytest.mark.parametrize(('joint', 'other'), [(0, 'joint2'), (1, 'joint1')])
def test_links_of_a_chain_taken_for_single_axes_are_told_of(joint, other):
    """The other link's acceleration accounts for what the model of an axis leaves."""
    sentence, = sentences('planar', joint)
    assert f'with the motion of {other}' in sentence and 'act on each other' in sentence


@pytest.mark.parametrize('joint', [0, 1])
def test_axes_of_their_own_are_not_accused(joint):
    """Where each axis moves by itself nothing is said."""
    assert sentences('decoupled', joint) == ()
