# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Tracking of robots that hardly differ."""

from dataclasses import replace

from bench.demos.identify import tracking_of_copies
from gms_flex_control.cli.demo import plan_of
from gms_flex_control.comparison.tracking import link_rms
from gms_flex_control.experiment.simulated import mixed_error, simulate
import numpy as np
import pytest


@pytest.fixture(scope='module')
def plan():
    """Return ten seconds of the polynomial motion."""
    return plan_of('polynomial', 'gms', duration=10.0)


def test_copies_without_a_difference_track_alike(plan):
    errors = tracking_of_copies(plan, plan.robot, count=2, spread=0.0)
    alone = link_rms(simulate(replace(plan, model=plan.robot), 'alone'))
    np.testing.assert_allclose(errors, [alone, alone], rtol=1e-12)


def test_every_belief_meets_the_same_robots(plan):
    believed = mixed_error(plan.robot)
    errors = [tracking_of_copies(plan, believed, count=4, spread=0.05, seed=seed)
              for seed in (3, 3, 4)]
    np.testing.assert_array_equal(errors[0], errors[1])
    assert (errors[0] != errors[2]).all() and np.ptp(errors[0], axis=0).all()
