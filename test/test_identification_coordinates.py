# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The free numbers of a fit, what they stand for, and which of them the data do not show."""

from types import SimpleNamespace

from gms_flex_control.friction import replay
from gms_flex_control.identification import uncertainty
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
from gms_flex_control.identification.outcome import BlockCandidate, estimated, NOT_IDENTIFIABLE
from gms_flex_control.identification.selection import JointFit
from gms_flex_control.identification.uncertainty import clustered, curve_of, inverse_of, Spread
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
    step = 1e-5
    for p, unit in enumerate(np.eye(len(free))):
        up, down = (coordinates.unpack(free + sign * step * unit)[0] for sign in (1, -1))
        np.testing.assert_allclose(directions[:, p], (up - down) / (2 * step), rtol=1e-7,
                                   atol=1e-9, err_msg=f'free number {p}')


def test_friction_does_not_vanish_at_speed():
    """Eq. (4) where the curve has fallen to 2 %, whatever the numbers are."""
    coordinates, rng = Coordinates(1), np.random.default_rng(2)
    for free in 5.0 * rng.standard_normal((200, coordinates.size)):
        theta = coordinates.parameters(free)
        for static, coulomb, velocity, viscous in theta[:8].reshape(2, 4):
            sliding = coulomb + (static - coulomb) * np.exp(-4.0) + 2.0 * velocity * viscous
            assert coulomb <= static < 5.0 * sliding


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


STATIC, COULOMB = np.array([0.10697, 0.09470]), np.array([0.09087, 0.08363])
STRIBECK = np.array([0.078, 0.058])  # forward, backward [rad/s]
PAPER = np.array([0.12, 16.08, 19.81, 75.86, 138.10, 150.58])  # Table 2, link 2 [N m/rad]


def estimates(stiffness, reach, travel, doubt=1e-3, rivals=(), top=2.0):
    """Return the Estimates of link 2 by name, all numbers known to ``doubt``."""
    coordinates = Coordinates(len(stiffness))
    yields = STATIC.mean() / len(stiffness) / np.asarray(stiffness)
    free = coordinates.pack(STATIC, COULOMB, STRIBECK, [0.0037, 0.0053], 1.0, yields)
    spread = uncertainty.Spread(doubt ** 2 * np.eye(len(free)), np.ones(len(free)))
    found = uncertainty.estimates_of('joint2', coordinates, free, spread, reach, travel, rivals,
                                     top=top)
    return {estimate.name.removeprefix('friction.joint2.'): estimate for estimate in found}


def flagged(found):
    """Return the numbers of the stiffnesses that are flagged."""
    return [i for i in range(6) if NOT_IDENTIFIABLE in found.get(f'stiffness[{i}]', found[
        'attraction']).flags]


@pytest.mark.parametrize(('reach', 'travel', 'expected', 'note'), [
    (0.0188, 2.0, [0], 'slips only after 0.14 rad, beyond the 0.0188 rad'),
    (0.1, 0.1, [0], 'never slipped'), (0.1, 0.2, [], ''),
    (0.0, 2.0, [0, 1, 2, 3, 4, 5], 'no presliding is in the data')])
def test_blocks_that_slip_beyond_presliding_are_flagged_and_no_others(
        reach, travel, expected, note):
    """k_21 = 0.12 N m/rad slips after 0.14 rad; never where presliding is all there is."""
    found = estimates(PAPER, reach=reach, travel=travel)
    assert flagged(found) == expected and note in found['stiffness[0]'].note


@pytest.mark.parametrize('beyond', [False, True])
def test_a_stribeck_curve_that_still_falls_at_the_highest_velocity_has_no_interval(beyond):
    """At 1.7 v_s a twentieth of F_s - F_c is left; viscous friction could be the rest of it."""
    fastest = (1.7 if beyond else 1.8) * STRIBECK.max()
    found = estimates(PAPER, reach=0.0188, travel=2.0, top=fastest)
    lost = {name for name, one in found.items() if not np.isfinite(one.interval.low)}
    assert {name for name in lost if 'stiffness' not in name} == (
        {f'forward.{name}' for name in ('static', 'coulomb', 'velocity', 'viscous')}
        if beyond else set())


@pytest.mark.parametrize(('doubt', 'expected'), [(0.05, False), (1.0, True)])
def test_a_wide_interval_is_flagged(doubt, expected):
    """Half an interval wider than a factor of 2 says nothing."""
    found = estimates(PAPER, reach=0.1, travel=2.0, doubt=doubt)
    assert (NOT_IDENTIFIABLE in found['attraction'].flags) == expected


def rival(**factors):
    """Return link 2's parameters with other numbers of the forward curve."""
    coordinates = Coordinates(len(PAPER))
    free = coordinates.pack(STATIC, COULOMB, [0.078, 0.058], [0.0037, 0.0053], 1.0,
                            STATIC.mean() / 6 / PAPER)
    theta, _ = coordinates.unpack(free)
    for name, factor in factors.items():
        theta[('static', 'coulomb', 'velocity', 'viscous').index(name)] *= factor
    return theta


def test_what_another_model_has_elsewhere_gets_no_interval_or_a_wider_one():
    """Off by 40 % against 2 % of chance: none; by 3 %: one that holds both."""
    alone = estimates(PAPER, reach=0.1, travel=2.0, doubt=0.01)
    found = estimates(PAPER, reach=0.1, travel=2.0, doubt=0.01,
                      rivals=[rival(viscous=1.4, coulomb=1.03)])
    lost, kept = found['forward.viscous'], found['forward.coulomb']
    assert lost.flags == ('depends on the model',) and np.isnan(lost.interval).all()
    assert 'another number of blocks' in lost.note
    assert kept.interval.high > 1.03 * kept.value > alone['forward.coulomb'].interval.high
    assert found['backward.viscous'] == alone['backward.viscous']


def test_numbers_of_one_curve_are_reported_together():
    """Without F_c nothing of a direction is known, without v_s no F_s; without both v_s no C."""
    found = estimates(PAPER, reach=0.1, travel=2.0, rivals=[rival(coulomb=1.5)])
    assert all(found[f'forward.{name}'].flags for name in ('static', 'velocity', 'viscous'))
    assert not any(found[f'backward.{name}'].flags for name in ('static', 'velocity', 'viscous'))
    found = estimates(PAPER, reach=0.1, travel=2.0, rivals=[rival(velocity=2.0)])
    assert NOT_IDENTIFIABLE in found['forward.static'].flags
    assert not found['forward.coulomb'].flags and not found['attraction'].flags


def test_a_covariance_of_few_blocks_is_wider_than_chance_and_never_narrower_than_the_samples():
    """Ten blocks ask for 2.26 standard deviations instead of 1.96; equal scores say nothing."""
    scores = np.tile([[1.0], [-1.0]], (5, 1))
    wide = clustered(np.eye(1), scores, 1.0)
    assert wide[0, 0] == pytest.approx(10 / 9 * (2.262 / 1.960) ** 2 * 10.0, rel=1e-3)
    assert clustered(np.eye(1), 0.0 * scores, 3.0)[0, 0] == pytest.approx(3.0)


def test_blocks_that_draw_the_fit_to_themselves_are_as_uncertain_as_the_others():
    """Twenty numbers of four blocks of 20: a fit's own errors are small, its values as far off."""
    rng, blocks, noises = np.random.default_rng(0), 4, 400
    columns = np.linalg.qr(rng.standard_normal((80, 20)))[0]
    share = np.einsum('bsp,bsq->bpq', *2 * [columns.reshape(blocks, 20, 20)])
    variance = np.zeros((2, 20))
    for noise in rng.standard_normal((noises, 80)):
        left = (noise - columns @ (columns.T @ noise))[:, None]
        scores = (columns * left).reshape(blocks, 20, 20).sum(axis=1)
        variance += [np.sum(one ** 2, axis=0) / noises for one in (
            scores, uncertainty.unshrunk(scores, share))]
    assert variance[0].mean() < 0.8
    np.testing.assert_allclose(variance[1], 1.0, rtol=0.2)
    assert variance[1].mean() == pytest.approx(1.0, abs=0.03)


def test_numbers_that_the_data_hardly_separate_are_vague_whatever_rounding_does():
    """Six numbers that three combinations determine: no variance is negative or nothing."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        seen = rng.standard_normal((6, 3))
        inverse = inverse_of(1e6 * seen @ seen.T + np.diag(rng.uniform(0.0, 1e-6, 6)))
        variance = np.diag(clustered(inverse, rng.standard_normal((8, 3)) @ seen.T, 1.0))
        assert np.all(np.isfinite(variance)) and np.all(variance > 1.0)


def test_numbers_of_a_prior_alone_say_nothing_of_how_far_samples_are_alike():
    """Seven samples are alike; half of the numbers no sample changes."""
    rng, information = np.random.default_rng(0), np.array([4.0, 9.0, 25.0, 0.0, 0.0, 0.0])
    precision = np.full(6, 1e-2)
    inverse = inverse_of(np.diag(information + precision))
    scores = np.sqrt(7.0 * information / 400) * rng.standard_normal((400, 6))
    assert uncertainty.memory_of(inverse, precision, scores) == pytest.approx(7.0, rel=0.1)


@pytest.mark.parametrize(('yields', 'known', 'expected'), [
    ([1e-3], [True], (1e-5, 1e-3)), ([1e-3, 4e-3], [True, True], (1e-3, 4e-3)),
    ([1e-3, 4e-3], [False, True], ()), ([1e-3], [False], ()), ([1e-6, 2e-6], [True, True], ())])
def test_the_presliding_curve_is_shown_between_the_yields_that_are_known(yields, known, expected):
    """The axis of one point would be singular; a block alone is a line from the first step on."""
    blocks = [estimated(f'friction.joint1.stiffness[{size}]', 'N m/rad', 0.1 / len(yields) / size,
                        known=one) for size, one in zip(yields, known, strict=True)]
    shown = uncertainty.shown_displacements(blocks, 0.1, 1e-5, 7)
    assert tuple(shown[[0, -1]] if len(shown) else shown) == pytest.approx(expected)
