# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Where a fit of friction begins, from what is left of the torque at steady speeds."""

from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.friction_map import start_of
from gms_flex_control.identification.outcome import FrictionMap
import numpy as np
import pytest

SPEED = np.geomspace(0.02, 1.0, 40)
RATE = np.concatenate([-SPEED, SPEED])


def begun(torque):
    """Return the Start of friction over RATE, 2 rad of travel and an encoder of 0.1 mrad."""
    return start_of(FrictionMap(RATE, torque, np.ones(len(RATE), dtype=bool)), 2.0, 1e-4,
                    'elbow', 'bag')


def test_a_fit_begins_with_coulomb_and_viscous_friction():
    start = begun(2.0 * np.sign(RATE) + 3.0 * RATE)
    for way in start.straight:
        np.testing.assert_allclose([way.coulomb, way.viscous], [2.0, 3.0], rtol=1e-3)


def test_a_constant_torque_above_friction_hides_no_friction():
    """Half of what both ways differ by is friction, half of their sum another torque."""
    with pytest.warns(UserWarning, match='elbow drives its backward motion as often as it brakes'):
        start = begun(2.0 * np.sign(RATE) + 5.0)
    assert start.backward.coulomb == pytest.approx(2.0)


@pytest.mark.parametrize('torque', [-2.0 * np.sign(RATE), -2.0 * np.sign(RATE) + 1.0])
def test_friction_that_drives_both_ways_together_is_refused(torque):
    with pytest.raises(IdentificationError, match='of elbow would drive its .* check the sign'):
        begun(torque)
