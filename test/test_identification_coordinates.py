# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The free numbers of a fit: what they stand for, their derivatives, the presliding curve."""

from types import SimpleNamespace

from gms_flex_control.friction import replay
from gms_flex_control.identification.coordinates import (
    Coordinates,
    friction_record,
    MOST_BLOCKS,
    presliding_curve,
    slipping,
    yield_quantiles,
    yields_of,
)
from gms_flex_control.identification.least_squares import prior_of
from gms_flex_control.identification.outcome import BlockCandidate
from gms_flex_control.identification.selection import JointFit
from gms_flex_control.identification.uncertainty import curve_of, Spread
from gms_flex_control.simulation.predictor import BLOCKS
import numpy as np
import pytest

pytestmark = pytest.mark.fast

STEADY = {'static': [0.108, 0.104], 'coulomb': [0.094, 0.090], 'velocity': [0.0085, 0.0049],
          'viscous': [0.066, 0.074], 'attraction': 1.5}
YIELDS = [1e-4, 3e-4, 2e-3, 1e-2]
WEIGHTS = [0.4, 0.3, 0.2, 0.1]
KINDS = {
    'equal blocks': {},
    'free weights': {'free_weights': True},
    'fixed yields': {'yields': YIELDS},
    'fixed yields and free weights': {'yields': YIELDS, 'free_weights': True},
    'further torques': {'free_weights': True, 'n_extra': 3}}


def packed(kind):
    """Return Coordinates of a kind and the free numbers of STEADY, YIELDS and WEIGHTS."""
    coordinates = Coordinates(len(YIELDS), **KINDS[kind])
    extra = [0.3, -0.2, 7.0][:coordinates.n_extra]
    return coordinates, coordinates.pack(**STEADY, yields=YIELDS, weights=np.array(WEIGHTS),
                                         extra=extra)


@pytest.mark.parametrize('kind', KINDS)
def test_unpacked_parameters_are_those_that_were_packed(kind):
    coordinates, free = packed(kind)
    theta, _ = coordinates.unpack(free)
    names = ('static', 'coulomb', 'velocity', 'viscous')
    for k in range(2):
        np.testing.assert_allclose(theta[4 * k:4 * k + 4], [STEADY[name][k] for name in names],
                                   rtol=1e-13)
    assert theta[8] == pytest.approx(STEADY['attraction'])
    stiffness, weight = theta[BLOCKS:BLOCKS + 2 * MOST_BLOCKS].reshape(2, MOST_BLOCKS)
    expected = WEIGHTS if coordinates.free_weights else np.full(4, 0.25)
    np.testing.assert_allclose(weight[:4], expected, rtol=1e-13)
    np.testing.assert_allclose(stiffness[:4], np.multiply(expected, 0.106) / YIELDS, rtol=1e-13)
    assert not stiffness[4:].any() and not weight[4:].any()
    np.testing.assert_array_equal(theta[BLOCKS + 2 * MOST_BLOCKS:], [0.3, -0.2, 7.0][
        :coordinates.n_extra])
    assert len(free) == coordinates.size


@pytest.mark.parametrize('kind', KINDS)
def test_directions_are_the_derivatives_of_the_parameters(kind):
    """Against central differences at a random place, each column on its own."""
    coordinates, free = packed(kind)
    free = free + 0.3 * np.random.default_rng(1).standard_normal(len(free))
    _, directions = coordinates.unpack(free)
    step = 1e-6
    for p, unit in enumerate(np.eye(len(free))):
        up, down = (coordinates.unpack(free + sign * step * unit)[0] for sign in (1, -1))
        np.testing.assert_allclose(directions[:, p], (up - down) / (2 * step), rtol=1e-7,
                                   atol=1e-9, err_msg=f'free number {p}')


def test_the_presliding_curve_is_a_sum_of_springs_up_to_their_share():
    coordinates, free = packed('free weights')
    theta, _ = coordinates.unpack(free)
    static = 0.106  # mean of both directions
    at = np.array([0.0, 5e-5, 2e-4, 1e-3, 5e-3, 0.02])
    expected = [sum(w * static * min(x / y, 1.0) for w, y in zip(WEIGHTS, YIELDS, strict=True))
                for x in at]
    np.testing.assert_allclose(presliding_curve(theta, at), expected, rtol=1e-13)
    assert presliding_curve(theta, at)[-1] == pytest.approx(static)


def test_the_band_of_the_presliding_curve_is_that_of_its_yields():
    """Below the first of them the torque goes with 1 / yield, of which 3 % here are known."""
    coordinates, free = packed('equal blocks')
    spread = np.zeros(len(free))
    spread[coordinates.yields] = 0.03
    _, torque, low, high = curve_of(
        SimpleNamespace(coordinates=coordinates, free=free, rivals=()),
        Spread(np.outer(spread, spread), np.ones(len(free))), np.array([1e-5, 5e-5]))
    np.testing.assert_allclose([torque / low, high / torque], np.exp(1.96 * 0.03), rtol=1e-4)


@pytest.mark.parametrize('n_blocks', [1, 2, 4, 8])
def test_equal_blocks_keep_the_yields_of_equal_blocks(n_blocks):
    """Quantiles of a curve that already is one of N equal blocks, in whatever order."""
    yields = np.geomspace(1e-4, 0.05, n_blocks)[::-1]
    coordinates = Coordinates(n_blocks)
    theta, _ = coordinates.unpack(coordinates.pack(**STEADY, yields=yields))
    np.testing.assert_allclose(yield_quantiles(theta, n_blocks), yields[::-1], rtol=1e-12)


def test_without_blocks_that_never_slip_presliding_is_the_same_and_levels_are_those_of_the_rest():
    yields = np.array([1e-3, 3e-3, 9e-3, 5e4])
    coordinates = Coordinates(4)
    theta = coordinates.parameters(coordinates.pack(
        [0.8, 0.9], [0.6, 0.7], [0.1, 0.1], [0.01, 0.02], 3.0, yields))
    found = slipping(theta, reach=1.0)
    np.testing.assert_allclose(found[[0, 1, 4, 5]], 0.75 * theta[[0, 1, 4, 5]], rtol=1e-12)
    displacement = np.linspace(0.0, 1.0, 400)
    np.testing.assert_allclose(presliding_curve(found, displacement),
                               presliding_curve(theta, displacement), atol=1e-4)
    np.testing.assert_allclose(yields_of(found)[0], yields[:3], rtol=1e-12)
    assert slipping(theta, reach=1e5) is theta


def test_a_fit_without_the_blocks_that_never_slip_has_the_same_friction():
    """A spring that the motion only bends carries next to nothing, but a quarter of the level."""
    coordinates = Coordinates(4)
    free = coordinates.pack(**STEADY, yields=[50.0, 3e-4, 2e-3, 1e-2])
    sampling = np.arange(coordinates.size, dtype=float)
    fit = JointFit(coordinates, free, prior_of(coordinates, free), free,
                   (BlockCandidate(2, 1.0, 0.1, False), BlockCandidate(4, 0.9, 0.0, True)),
                   sampling)
    less = fit.slipping(1.0)
    time = np.arange(4000) * 1e-3
    angle, rate = 0.3 * np.sin(3.0 * time)[:, None], 0.9 * np.cos(3.0 * time)[:, None]
    before, after = (replay(angle, rate, 1e-3, friction_record([one.theta]))
                     for one in (fit, less))
    assert less.coordinates.n_blocks == 3
    assert less.theta[:2] == pytest.approx(0.75 * fit.theta[:2])
    assert after[1000:] == pytest.approx(before[1000:], abs=5e-3 * STEADY['coulomb'][0])
    assert less.sampling.tolist() == np.delete(sampling, 9).tolist()
    assert [one.n_blocks for one in less.candidates] == [2, 3]
    assert less.slipping(1.0) is less
