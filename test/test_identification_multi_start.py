# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Multi-start leaves wrong local minima of a rough cost; coarse looks at the data come first."""

from dataclasses import replace

from gms_flex_control.identification.coordinates import Coordinates, N_STEADY
from gms_flex_control.identification.friction_fit import narrower_curves
from gms_flex_control.identification.least_squares import multi_start, Prior, refine
from gms_flex_control.identification.objective import Evaluation
from gms_flex_control.simulation.predictor import PER_DIRECTION, VELOCITY
import numpy as np
import pytest

VELOCITIES = [VELOCITY, PER_DIRECTION + VELOCITY]  # of Stribeck curves, among the numbers
COUNT = 1e-3          # rad
TRUE_YIELDS = np.array([0.3e-3, 0.6e-3])
COORDINATES = Coordinates(2)
TRUTH = np.concatenate([np.zeros(N_STEADY), np.log(TRUE_YIELDS)])
PRIOR = Prior(TRUTH, np.full(COORDINATES.size, 1e-9))
RIPPLE = 0.02         # local minima of a yield lie 2 pi times that apart
STEEP = np.where(np.arange(COORDINATES.size) < N_STEADY, 0.0, 2.0)  # above 1 they end a fit


class Rippled:
    """A stand-in for Objective: each number is off by its distance and a ripple on top."""

    fastest = np.exp(5.0)

    def evaluate(self, coordinates, free, sharpness, floor=None, *, derivatives=True):
        """Return the Evaluation of free numbers, one block for each."""
        off = free - TRUTH
        error = off + STEEP * RIPPLE * np.sin(off / RIPPLE)
        slope = 1.0 + STEEP * np.cos(off / RIPPLE)
        gradient, curvature = np.diag(-slope * error), np.zeros((len(free),) * 3)
        curvature[np.arange(len(free)), np.arange(len(free)), np.arange(len(free))] = slope ** 2
        ones = np.ones(len(free))
        return Evaluation(error ** 2 + 1e-5, gradient, curvature, 1e3 * ones, 1e3 * ones,
                          floor or self.floor_of(error ** 2))

    def floor_of(self, square):
        """Return the same floor for all."""
        return 1e-2


@pytest.mark.parametrize('seed', range(2))
def test_multi_start_finds_the_minimum_that_a_single_fit_misses(seed):
    """One fit ends some local minima off, the best of the starts at the truth."""
    start = TRUTH.copy()
    start[COORDINATES.yields] += np.log([1.6, 0.6])
    objective = Rippled()
    alone = refine(objective, COORDINATES, start, PRIOR).free
    found = multi_start(objective, COORDINATES, (start,), PRIOR, COUNT,
                        np.random.default_rng(seed), 8)
    off = np.abs(np.exp((found.ends[0] - TRUTH)[COORDINATES.yields]) - 1.0).max()
    assert np.abs(alone - TRUTH).max() > 2.0 * np.pi * RIPPLE
    assert off < 0.1
    assert found.improvement > 1.5


class Flat(Rippled):
    """A stand-in that hardly feels some numbers far from the truth: as a rule the velocities."""

    def __init__(self, numbers=VELOCITIES):
        self._numbers = numbers

    def evaluate(self, coordinates, free, sharpness, floor=None, *, derivatives=True):
        """Return the Evaluation of free numbers, some behind a flat function."""
        felt, numbers = free.copy(), self._numbers
        off = np.tanh(free[numbers] - TRUTH[numbers])
        felt[numbers] = TRUTH[numbers] + off
        one = super().evaluate(coordinates, felt, sharpness, floor)
        slope = np.ones(len(free))
        slope[numbers] = 1.0 - off ** 2
        return replace(one, gradient=one.gradient * slope, curvature=one.curvature * slope ** 2)


class Blind(Rippled):
    """A stand-in that does not feel the velocities."""

    def evaluate(self, coordinates, free, sharpness, floor=None, *, derivatives=True):
        """Return the Evaluation of free numbers, whatever the velocities are."""
        felt = free.copy()
        felt[VELOCITIES] = TRUTH[VELOCITIES]
        return super().evaluate(coordinates, felt, sharpness, floor)


@pytest.mark.parametrize('lost', [[VELOCITY], VELOCITIES])
def test_stribeck_curves_that_are_lost_begin_as_the_other_way_s_or_as_narrow_ones(lost):
    """From velocities e^8 times too large nothing leads back, the backward curve does."""
    start = TRUTH.copy()
    start[lost] = 8.0
    stuck = refine(Flat(), COORDINATES, start, PRIOR).free
    found = multi_start(Flat(), COORDINATES, (start,), PRIOR, COUNT, np.random.default_rng(0), 8)
    assert stuck[lost] == pytest.approx(8.0, abs=1.0)
    assert found.ends[0][lost] == pytest.approx(0.0, abs=0.01)


def test_a_narrow_stribeck_curve_stands_beside_a_wide_one_where_data_do_not_tell():
    """Velocities that nothing depends on have one; curves that are not wide do not."""
    wide = TRUTH.copy()
    wide[VELOCITIES] = 4.0  # far beyond the truth, below the fastest motion
    begin = refine(Flat(), COORDINATES, wide, PRIOR)
    unfelt = begin._replace(free=wide, evaluation=Blind().evaluate(COORDINATES, wide, 1.0))
    other, worse = narrower_curves(Blind(), COORDINATES, unfelt, PRIOR)
    assert (other.free[VELOCITIES] < 2.5).all() and abs(worse) < 1.0
    narrow = unfelt._replace(free=TRUTH)
    assert narrower_curves(Blind(), COORDINATES, narrow, PRIOR)[0] is None


@pytest.mark.parametrize(('block', 'factor'), [(0, -8.0), (1, 8.0)])
def test_a_block_that_is_lost_begins_beside_the_others(block, factor):
    """Of a yield within a count, or one beyond the motion, nothing leads back."""
    numbers = [N_STEADY, N_STEADY + 1]
    start = TRUTH.copy()
    start[numbers[block]] += factor
    stuck = refine(Flat(numbers), COORDINATES, start, PRIOR).free
    found = multi_start(Flat(numbers), COORDINATES, (start,), PRIOR, COUNT,
                        np.random.default_rng(0), 8)
    assert np.abs(stuck - TRUTH).max() > 0.5 * abs(factor)
    assert np.abs(found.ends[0] - TRUTH).max() < 0.1


def test_a_start_in_the_best_hollow_gains_nothing():
    """From the truth no start finds better, and the best end stays there."""
    found = multi_start(Rippled(), COORDINATES, (TRUTH,), PRIOR, COUNT,
                        np.random.default_rng(0), 8)
    assert found.ends[0] == pytest.approx(TRUTH, abs=1e-6)
    assert found.improvement == pytest.approx(1.0)


def test_a_multi_start_whose_predictions_all_run_away_still_returns_where_it_began():
    """As of an axis too light for its sampling: torque then decides, not the innovations."""
    class RunsAway(Rippled):
        def evaluate(self, coordinates, free, sharpness, floor=None, *, derivatives=True):
            one = super().evaluate(coordinates, free, sharpness, floor, derivatives=derivatives)
            return replace(one, square=np.full(len(free), np.nan))

    found = multi_start(RunsAway(), COORDINATES, (TRUTH,), PRIOR, COUNT,
                        np.random.default_rng(0), 2)
    np.testing.assert_array_equal(found.ends[0], TRUTH)
