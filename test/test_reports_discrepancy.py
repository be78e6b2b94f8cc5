# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Curves and pictures of a discrepancy, on numbers made up for them."""

from types import SimpleNamespace

from gms_flex_control.discrepancy import residual_views
from gms_flex_control.discrepancy.residual_views import binned, follows, over_all
from gms_flex_control.discrepancy.result import Gap, Value
from gms_flex_control.reports.discrepancy_values import over_values, plain
from gms_flex_control.reports.figure_style import save_figure
from gms_flex_control.reports.pictures import evidence_figure, gap_figure, maps_figure, over_figure
import numpy as np


def sampled(seed=0, count=20_000):
    """Return x and a noisy step over it."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=count)
    return x, np.sign(x) + rng.normal(size=count)


def test_binned_means_lie_on_the_curve_within_their_bands():
    x, y = sampled()
    curve = binned(x, y)
    away = np.abs(curve.x) > 0.2
    assert np.mean(np.abs(curve.mean - np.sign(curve.x))[away] < curve.half[away]) > 0.9
    # of the central limit, 0.4 of the samples being on their own
    edges = residual_views.bin_edges(x)
    count = np.bincount(np.searchsorted(edges, x))
    np.testing.assert_allclose(curve.half[away], (1.96 / np.sqrt(0.4 * count))[away], rtol=0.35)


def test_what_a_residual_follows_is_found_by_its_power():
    x, y = sampled()
    assert follows(x, np.ones_like(x)) > 0.999
    assert follows(x, np.sign(x)) > 0.98 > 0.6 > follows(x, y) > 0.4  # half of it is noise
    assert follows(x, np.random.default_rng(1).permutation(np.sign(x))) < 0.01


def moving_joint(count=12_000):
    """Return the Along of one rigid joint, and a residual that is its direction."""
    rng = np.random.default_rng(3)
    names = ('link angle', 'link rate', 'link acceleration', 'torque', 'time')
    values = {name: rng.normal(size=count) for name in names}
    values['direction'] = np.sign(values['link rate'])
    return SimpleNamespace(
        joints=('j',), channels=lambda j: [('link', j)], variables=lambda j: values,
        likelihood=SimpleNamespace(robot=SimpleNamespace(arm=SimpleNamespace(rigid=[True])))), (
            values['direction'] + rng.normal(size=count))[:, None], rng.normal(size=(count, 1))


def test_what_a_residual_depends_on_is_shown_beside_what_is_chance():
    along, before, chance = moving_joint()
    found = {one.variable: one for one in over_all(along, before, chance, chance)}
    reported = found['direction']
    assert 0.45 < reported.shares[0] < 0.55 and max(reported.shares[1:]) < 0.02
    assert reported.off_zero[0] == 1.0
    assert found['time [s]'].shares[0] < 0.03 and found['time [s]'].off_zero[0] < 0.2
    values = over_values(reported)
    assert values['share']['before'] == reported.shares[0] and values['equation'] == 'link'


def test_a_map_shows_what_is_more_than_chance():
    along, before, chance = moving_joint()
    for one in residual_views.maps_of(along, before, chance, 0):
        known = np.isfinite(one.before)
        assert known.sum() > 100
        assert np.mean(one.before[known] != 0.0) > 0.4
        assert np.mean(one.after[known] != 0.0) < 0.1


def test_a_number_that_is_not_finite_is_null():
    reported = plain({'a': np.float64(np.nan), 'b': (np.int64(3), np.array([1.0, np.inf])),
                      'c': Value('gap', 'rad', 1.0, -np.inf, 2.0)})
    assert reported == {'a': None, 'b': [3, [1.0, None]], 'c': ['gap', 'rad', 1.0, None, 2.0]}


def test_pictures_are_drawn_of_any_names_and_of_nothing(tmp_path):
    zero = np.zeros(1)
    gap = Gap(joints=('$_<b>',), **dict.fromkeys(
        ('before', 'retuned', 'after', 'floor', 'rest_before', 'rest_after', 'free_before',
         'free_after', 'free_floor'), zero))
    x, y = sampled()
    curve = binned(x, y)
    evidence = residual_views.Evidence(
        effect='backlash', joint='$_<b>', equation='link', of_joint='$_<b>', x=x, y=y,
        x_label='torsion [rad]', times='the direction of $_<b>', before=curve, after=curve,
        own=curve)
    edges = np.linspace(0.0, 1.0, 4)
    empty = residual_views.Map('link equation', 'x [rad]', 'y [rad]', edges, edges,
                               *np.full((2, 3, 3), np.nan))
    chance = empty._replace(before=np.zeros((3, 3)), after=np.zeros((3, 3)))
    norms = {(mesh.norm.vmin, mesh.norm.vmax) for mesh in [
        mesh for panel in maps_figure([empty, chance], 'j').axes[:4]
        for mesh in panel.collections]}
    assert norms == {(-1.0, 1.0)}  # white, not the first of the colours
    along, before, chance = moving_joint(400)
    over = over_all(along, before, chance, chance)
    for name, figure in (('gap', gap_figure(gap)), ('evidence', evidence_figure(evidence)),
                         ('over', over_figure(over)),
                         ('map', maps_figure([empty], '$_<b>'))):
        save_figure(figure, tmp_path / f'{name}.png')
        assert (tmp_path / f'{name}.png').stat().st_size > 5000
