# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Intervals hold the truth or are not printed: the worst case of bench.coverage, in short."""

from bench.coverage import Case, held, identified, rows_of
import pytest


@pytest.fixture(scope='module')
def simple():
    """Return the true axis and its Identification with one block where the axis has four."""
    return identified(Case('moves', 0.0, 'too few', 2))


def test_too_simple_a_model_prints_no_interval_without_the_truth(simple):
    """Coulomb and viscous friction of it are 14 to 200 % off."""
    robot, found = simple
    rows = list(rows_of(found.joints[0], robot, found.robot))
    holds, count, most = held([{'rows': rows}])
    assert holds == count < most == 9
    notes = ' '.join(one.note for one in found.joints[0].estimates)
    assert 'another number of blocks' in notes


def test_no_better_than_coulomb_and_viscous_is_what_the_table_says(simple):
    """The model that was taken is the one that the column beside it stands for."""
    result, = simple[1].joints
    assert any('no better than Coulomb + viscous' in text for text in result.warnings)
    errors = result.held_out
    assert errors.relative == errors.coulomb_viscous
    assert errors.free_run_rms == errors.free_run_coulomb_viscous


def test_no_curve_of_stiffnesses_that_are_not_identifiable(simple):
    result, = simple[1].joints
    assert all(one.flags for one in result.estimates if 'stiffness' in one.name)
    assert all(len(part) == 0 for part in result.curve)
