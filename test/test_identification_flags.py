# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Which numbers of a joint are flagged as not identifiable, however narrow their intervals."""

from gms_flex_control.identification import uncertainty
from gms_flex_control.identification.coordinates import Coordinates
from gms_flex_control.identification.outcome import estimated, NOT_IDENTIFIABLE
from gms_flex_control.identification.uncertainty import clustered, inverse_of
import numpy as np
import pytest

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
