# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Errors of prediction, against a closed form, and what they tell in a closed loop."""

from gms_flex_control.discrepancy.prediction import _innovation_cost
from gms_flex_control.discrepancy.workflow import discrepancy
from gms_flex_control.hidden.cases import make_case
import numpy as np
import pytest
from scipy.signal import lfilter

PERIOD = 2e-3


@pytest.fixture
def noise():
    """Return 20 s of two channels, each predicted from its past but for errors of 0.1 and 3."""
    white = np.random.default_rng(0).standard_normal((10000, 2)) * [0.1, 3.0]
    return lfilter([1.0], [1.0, -1.6, 0.8], white, axis=0)


def test_the_cost_is_that_of_what_cannot_be_predicted(noise):
    """The logarithm of the variance of both errors, as they do not depend on each other."""
    usable = np.ones(len(noise), dtype=bool)
    cost = _innovation_cost(noise, usable, PERIOD) / (len(noise) - 40)
    assert cost == pytest.approx(2.0 * np.log(0.1 * 3.0), abs=0.05)
    assert np.log(np.linalg.det(np.cov(noise.T))) > cost + 3.0


def test_nothing_is_predicted_from_samples_that_are_not_known(noise):
    usable = np.ones(len(noise), dtype=bool)
    usable[3000:3010] = usable[7000:7500] = False
    filled = np.where(usable[:, None], noise, 1e6)
    assert _innovation_cost(filled, usable, PERIOD) == _innovation_cost(
        noise, usable, PERIOD) != 0.0


def test_a_short_recording_tells_nothing(noise):
    assert _innovation_cost(noise[:200], np.ones(200, dtype=bool), PERIOD) == 0.0


@pytest.mark.parametrize(('seed', 'effect'), [(86, 'input_delay'), (85, 'actuator_lag')])
def test_a_delay_and_a_lag_are_told_apart_in_a_closed_loop(seed, effect):
    """By residuals below 20 Hz, the delay of the first would be a lag of the same time."""
    case = make_case('single', seed)
    hidden, = case.truth.effects
    assert hidden.name == effect and hidden.values[0] < 5e-3
    result = discrepancy([case.recording], case.nominal)
    first = result.findings[0]
    assert (first.effect, first.joint) == (effect, hidden.joint)
    assert next(iter(first.parameters.values())) == pytest.approx(hidden.values[0], rel=0.05)


def test_a_delay_is_told_from_a_lag_beside_which_inertia_would_be_smaller():
    """Errors of prediction are torques: with a lag, and 3 % less inertia, they are smaller."""
    case = make_case('single', 49, motion='polynomial')
    result = discrepancy([case.recording], case.nominal, holdout=[case.held_out])
    assert [(one.effect, one.joint) for one in result.named] == [('input_delay', 'joint1')] == [
        (one.name, one.joint) for one in case.truth.effects]
