# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Pages, pictures, curves and tables of an identification and of a discrepancy."""

from dataclasses import replace
import json
import re
from types import SimpleNamespace

from gms_flex_control.design.determination import missing_of
from gms_flex_control.discrepancy import residual_views
from gms_flex_control.discrepancy.residual_views import binned, follows, over_all
from gms_flex_control.discrepancy.result import Gap, Value
from gms_flex_control.identification.outcome import estimated, FrictionMap, Interval, OtherJoints
from gms_flex_control.identification.output import report_json
from gms_flex_control.reports.answers import identification_answer, identification_text
from gms_flex_control.reports.discrepancy_values import over_values, plain
from gms_flex_control.reports.figure_style import save_figure
from gms_flex_control.reports.pictures import (
    evidence_figure,
    gap_figure,
    loops_figure,
    map_figure,
    maps_figure,
    over_figure,
)
from gms_flex_control.reports.recordings_page import write_identification_report
from html_page import Page
from identified import ERRORS, identification
import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings('error')

EVIL = '<b>$_/../\\x'


def written(made, folder, **options):
    """Return the names of the files, and the page without its scripts."""
    paths = write_identification_report(made, folder, **options)
    assert sorted(paths) == sorted(folder.iterdir())
    return [path.name for path in paths], re.sub(
        r'<script.*?</script>|src="[^"]*"', '', paths[0].read_text('utf-8'), flags=re.DOTALL)


def test_page_and_pictures_of_each_joint_are_written(tmp_path):
    names, html = written(identification(), tmp_path)
    assert names == ['report.html', *(
        f'{kind}_joint{j}.png' for j in (1, 2) for kind in ('map', 'presliding'))]
    for name in names[1:]:
        assert (tmp_path / name).read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'
    for part in ('3 samples were lost.', 'Coulomb + viscous', 'slips only after 0.149 rad',
                 'NOT identifiable from these data: stiffness[0]', 'NOT IDENTIFIABLE, AT BOUND',
                 '(0.1224)', '0.1056 .. 0.1144', 'chosen', 'Fig. 3', 'Fig. 4'):
        assert part in html, part
    assert html.index('Summary') < html.index('joint1: parameters')


def test_the_charts_over_time_carry_the_data_of_the_identification(tmp_path):
    made = identification(1)
    names, _ = written(made, tmp_path)
    page = Page((tmp_path / names[0]).read_text('utf-8'))
    charts, arrays = json.loads(page.data)['charts'], page.arrays()
    result = made.joints[0]
    lines = {line['label']: arrays[line['y']] for chart in charts for line in chart['series']}
    np.testing.assert_array_equal(np.isfinite(lines['model, held out']), result.traces[0].held_out)


def test_pictures_show_what_was_fitted():
    result = identification().joints[0]
    fast = np.abs(result.friction_map.velocity) > np.median(np.abs(result.friction_map.velocity))
    result = replace(result, friction_map=FrictionMap(*(
        values[fast] for values in result.friction_map)))
    linear, log = map_figure(result).axes
    assert (linear.get_xscale(), log.get_xscale()) == ('linear', 'log')
    fitted = {line.get_label(): line for line in log.get_lines()}['backward, fitted']
    rows, measured = result.steady_velocity < 0.0, result.friction_map
    speed = np.abs(result.steady_velocity[rows])
    known = -measured.velocity[measured.steady & (measured.velocity < 0.0)]
    seen = (speed >= known.min()) & (speed <= known.max())
    assert 0 < seen.sum() < len(seen)  # dashed beyond
    np.testing.assert_allclose(fitted.get_ydata(), np.where(
        seen, -result.steady_torque[rows], np.nan))
    loops, curve = loops_figure(result).axes
    np.testing.assert_allclose(loops.get_lines()[1].get_xdata(),
                               1e3 * result.loops[0].model_displacement)
    assert curve.get_xscale() == 'log' and len(curve.collections) == 1


def test_a_joint_that_shows_little_is_reported_all_the_same(tmp_path):
    made = identification(1)
    none = np.zeros(0)
    result = replace(
        made.joints[0], loops=(), traces=(), candidates=(), curve=(none, none, none, none),
        friction_map=FrictionMap(none, none, none.astype(bool)), steady_velocity=none,
        steady_torque=none, warnings=('The joint hardly moves.',), held_out=ERRORS._replace(
            **dict.fromkeys(ERRORS._fields, np.nan)))
    made = replace(made, joints=(result,), warnings=())
    names, html = written(made, tmp_path)
    assert names == ['report.html', 'map_joint1.png', 'presliding_joint1.png']
    assert 'The joint hardly moves.' in html and 'no presliding motion' in html
    assert 'nan' not in html.lower().replace('nanmax', '')
    text = identification_text(made)
    assert 'The joint hardly moves.' in text and 'nan' not in text


def test_a_joint_that_did_not_move_is_reported_apart_and_determined_by_the_next_motion(tmp_path):
    open_one = estimated('arm.joint3.motor_inertia', 'kg m^2', 0.2, note='hardly moves it',
                         known=False)
    made = replace(identification(1), others=OtherJoints((open_one,)))
    name = 'arm.joint3.motor_inertia'
    assert name in written(made, tmp_path)[1] and name in identification_text(made)
    report = report_json(made)
    assert name not in {one['name'] for one in report['joints'][0]['estimates']}
    assert [one['name'] for one in report['others']] == [name]
    assert ('motor_inertia', 'joint3') in missing_of(report)


def test_names_neither_leave_the_folder_nor_collide_nor_break_the_page(tmp_path):
    made = identification()
    joints = tuple(replace(result, joint=name) for result, name in zip(
        made.joints, (EVIL, EVIL.replace('$', '%')), strict=True))
    names, html = written(replace(made, joints=joints, sources=(EVIL,)), tmp_path / 'out')
    assert len(set(names)) == len(names) == 5 and '<b>$' not in html
    assert [path.name for path in tmp_path.iterdir()] == ['out']


def test_the_terminal_table_is_narrow_and_says_what_is_known():
    made = identification()
    wide = replace(made.joints[1], joint='a_joint_with_a_name_that_goes_on_and_on',
                   warnings=('word ' * 60,))
    text = identification_text(replace(made, joints=(made.joints[0], wide),
                                       sources=('bag ' * 60,)))
    assert max(map(len, text.splitlines())) < 100
    static = next(line for line in text.splitlines() if line.startswith('forward.static'))
    assert static.split()[:6] == ['forward.static', 'N', 'm', '0.11', '0.1056', '..']
    assert 'NOT IDENTIFIABLE' in text and 'slips only after' in text
    assert 'C+v [%]' in text and '12' in text


def test_an_unknown_interval_is_not_made_up():
    made = identification(1)
    first = made.joints[0].estimates[0]._replace(interval=Interval(np.nan, np.nan))
    result = replace(made.joints[0], estimates=(first,))
    row = identification_text(replace(made, joints=(result,))).splitlines()
    row = next(line for line in row if line.startswith('forward.static'))
    assert row.split() == ['forward.static', 'N', 'm', '0.11', '-']


def sampled(seed=0, count=20_000):
    """Return x and a noisy step over it."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=count)
    return x, np.sign(x) + rng.normal(size=count)


def test_an_answer_begins_with_distrust_where_a_model_predicts_worse_than_none(tmp_path):
    made = identification(1)
    first, = made.joints
    for relative, distrusted in ((0.4, False), (1.3, True)):
        result = replace(first, held_out=first.held_out._replace(relative=relative))
        words = identification_answer(replace(made, joints=(result,)), tmp_path).sentence
        assert words.startswith('More than half of the drive torque') == distrusted
        assert 'predicts the torque of' in words


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
