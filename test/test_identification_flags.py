# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which numbers of a joint are flagged as not identifiable, however narrow their intervals."""

from gms_flex_control.identification.coordinates import Coordinates
from gms_flex_control.identification.uncertainty import estimates_of, Spread
from gms_flex_control.identification.words import NOT_IDENTIFIABLE
import numpy as np
import pytest

STATIC, COULOMB = np.array([0.10697, 0.09470]), np.array([0.09087, 0.08363])
PAPER = np.array([0.12, 16.08, 19.81, 75.86, 138.10, 150.58])  # Table 2, link 2 [N m/rad]


def estimates(stiffness, reach, travel, doubt=1e-3):
    """Return the Estimates of link 2 by name, all numbers known to ``doubt``."""
    coordinates = Coordinates(len(stiffness))
    yields = STATIC.mean() / len(stiffness) / np.asarray(stiffness)
    free = coordinates.pack(STATIC, COULOMB, [0.078, 0.058], [0.0037, 0.0053], 1.0, yields)
    draws = np.random.default_rng(0).standard_normal((400, len(free)))
    spread = Spread(doubt ** 2 * np.eye(len(free)), free + doubt * draws, np.ones(len(free)))
    return {estimate.name.removeprefix('friction.joint2.'): estimate for estimate in estimates_of(
        'joint2', coordinates, free, spread, reach, travel)}


def flagged(found):
    """Return the numbers of the stiffnesses that are flagged."""
    return [i for i in range(6) if NOT_IDENTIFIABLE in found.get(f'stiffness[{i}]', found[
        'attraction']).flags]


def test_the_softest_block_of_the_paper_is_flagged_and_no_other():
    """k_21 = 0.12 N m/rad slips after 0.14 rad, presliding ends at 19 mrad."""
    found = estimates(PAPER, reach=0.0188, travel=2.0)
    assert flagged(found) == [0]
    assert 'slips only after 0.14 rad, beyond the 0.0188 rad' in found['stiffness[0]'].note


def test_a_block_that_yields_beyond_all_motion_never_slipped():
    """Also where presliding is all there is, so that three times its reach is beyond all."""
    found = estimates(PAPER, reach=0.1, travel=0.1)
    assert flagged(found) == [0]
    assert 'never slipped' in found['stiffness[0]'].note
    assert flagged(estimates(PAPER, reach=0.1, travel=0.2)) == []


def test_without_presliding_no_stiffness_is_told():
    """The note says which motion lacks."""
    found = estimates(PAPER, reach=0.0, travel=2.0)
    assert flagged(found) == [0, 1, 2, 3, 4, 5]
    assert 'no presliding is in the data' in found['stiffness[5]'].note


@pytest.mark.parametrize(('doubt', 'expected'), [(0.05, False), (1.0, True)])
def test_a_wide_interval_is_flagged(doubt, expected):
    """Half an interval wider than a factor of 2 tells nothing."""
    found = estimates(PAPER, reach=0.1, travel=2.0, doubt=doubt)
    assert (NOT_IDENTIFIABLE in found['attraction'].flags) == expected


def test_replicates_that_run_away_flag_even_where_the_jacobian_is_sure():
    """A bootstrap that spans more than a factor of four is no interval of a known number."""
    coordinates = Coordinates(1)
    free = coordinates.pack(STATIC, COULOMB, [0.078, 0.058], [0.0037, 0.0053], 1.0, [1e-3])
    draws = np.random.default_rng(0).standard_normal((400, len(free)))
    spread = Spread(1e-6 * np.eye(len(free)), free + draws, np.ones(len(free)))
    for estimate in estimates_of('joint2', coordinates, free, spread, 0.1, 2.0):
        assert NOT_IDENTIFIABLE in estimate.flags or 'static' in estimate.name
        assert 'intervals disagree' in estimate.flags
