# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The report of a discrepancy: what the model lacks, why, and how much closer it came."""

from pathlib import Path

from gms_flex_control.discrepancy.free_run import all_known, free_runs, HORIZON
from gms_flex_control.discrepancy.path import path_of
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND, UNEXPLAINED
from gms_flex_control.discrepancy.units import torque_scale
from gms_flex_control.discrepancy.words import capitalised, of_withheld
from gms_flex_control.effects.registry import find
from gms_flex_control.reports.discrepancy_figures import (
    evidence_figure,
    gap_figure,
    maps_figure,
    over_figure,
)
from gms_flex_control.reports.discrepancy_loop import add_closed_loop
from gms_flex_control.reports.discrepancy_views import (
    Along,
    evidence_of,
    maps_of,
    over_all,
    residuals_of,
)
from gms_flex_control.reports.figures import file_stem, save_figure
from gms_flex_control.reports.model_comparison import comparison_rows
from gms_flex_control.reports.page import Curve, Report, Series
import numpy as np

TITLES = {COMPLETE: 'Nothing is missing', FOUND: 'Effects the model lacks',
          UNEXPLAINED: 'Something is missing that has no name here',
          BAD_DATA: 'The data are at fault'}
MOST_PICTURES = 8     # findings with a picture and a chart of their own
_POINTS = 12_000      # of one line over time
_CLOUD = 3_000        # points of a cloud


def write_discrepancy_report(result, folder, *, holdout=(), models=()):
    """
    Write report.html and the PNGs.

    Parameters
    ----------
    result : Discrepancy
        What to show.
    folder : str or Path
        Made if need be; files of the same names are replaced.
    holdout : sequence of Recording
        Recordings that took no part; free runs are shown on the first of them.
    models : sequence of Compared
        Models compared beside it.

    Returns
    -------
    list of Path
        What was written, the page first.

    """
    folder = Path(folder)
    report = Report('What the model lacks', f'{TITLES[result.verdict]} - '
                    + ', '.join(result.sources))
    pictures = add_discrepancy(report, result, folder, holdout=holdout, models=models)
    return [report.write(folder / 'report.html'), *pictures]


def add_discrepancy(report, result, folder, *, holdout=(), models=()):
    """
    Add everything about a discrepancy to a page and write the PNGs.

    Parameters
    ----------
    report : Report
        The page.
    result, folder, holdout, models
        As of `write_discrepancy_report`.

    Returns
    -------
    list of Path
        The pictures.

    """
    pictures = []

    def picture(figure, name):
        path = folder / name
        save_figure(figure, path)
        pictures.append(path)
        return path

    _add_summary(report, result)
    if result.behind is not None:
        problem, found = result.behind.problem, result.behind.found
        along = Along(problem)
        report.figure(picture(gap_figure(result.gap, bool(result.withheld)), 'gap.png'),
                      'The gap on data held out')
        _add_findings(report, result, along, found.model, picture)
        _add_left(report, result)
        _add_residuals(report, along, found, picture)
        _add_free_runs(report, problem, found, holdout)
        add_closed_loop(report, result.gap.closed_loop)
        _add_tables(report, result, models)
    return pictures


def _add_summary(report, result):
    report.heading('In words')
    report.note(result.words, warning=result.verdict in (BAD_DATA, UNEXPLAINED))
    report.text(f'Found in {result.seconds:.1f} s.')
    for text in result.faults:
        report.note(text, warning=True)
    if result.gap is not None:
        report.heading('The gap')
        report.text('Each bar is what a model leaves on data that took no part in its fit. '
                    'Re-tuned means that only parameters the model has already were moved, within '
                    'their doubt. The floor is what is left where nothing is missing: a run of '
                    'the final model itself, read through encoders like those of the recording.')


def _add_findings(report, result, along, model, picture):
    findings = result.named
    if not findings:
        return
    report.heading('What was found')
    scale = torque_scale([one.torque for one in findings])
    report.table(
        ('effect', 'joint', 'parameters (95 %)', f'torque [{scale.unit}]', 'share',
         'could also be'),
        [_finding_row(one, scale) for one in findings],
        'The largest first but for trifles; small ones (*) are below what matters in practice, '
        'and where one could also be another its name is but one of several. Share: of what '
        're-tuning cannot explain, what would be left without the effect')
    if result.withheld:
        report.note(f'{of_withheld(result.withheld)} The gap above and the closed loop are those '
                    'without it; maps and free runs below show what it would do.', warning=True)
    for i, finding in enumerate(findings[:MOST_PICTURES]):
        report.heading(f'{finding.effect} of {finding.joint}', level=3)
        report.text(_summary_of(finding.effect))
        report.text(capitalised(finding.evidence))
        if finding.confusable_with:
            report.note(f'These data hardly tell it from {", ".join(finding.confusable_with)}: '
                        f'{finding.tells_apart} would tell.', warning=True)
        evidence = evidence_of(along, model, finding)
        stem = file_stem(f'{finding.effect}_{finding.joint}')
        report.figure(picture(evidence_figure(evidence), f'evidence_{i + 1}_{stem}.png'),
                      f'{finding.effect} of {finding.joint}: over {evidence.x_label}')
        _add_evidence_chart(report, evidence)


def _finding_row(finding, scale):
    values = '; '.join(f'{v.name} {v.value:.4g} ({v.low:.4g} .. {v.high:.4g})'
                       f'{"" if v.unit == "1" else " " + v.unit}' for v in finding.values)
    return (f'{finding.effect}{"" if finding.main else " *"}', finding.joint, values,
            scale.told(finding.torque), f'{100.0 * finding.share:.1f} %',
            ', '.join(finding.confusable_with))


def _summary_of(effect):
    lines = (find(effect).__doc__ or '').strip().splitlines()
    return lines[0] if lines else ''


def _add_evidence_chart(report, evidence):
    step, scale = max(1, len(evidence.x) // _CLOUD), torque_scale(evidence.y)
    size = scale.factor
    curves = [Curve('samples without it', evidence.x[::step], size * evidence.y[::step], 'c6',
                    points=True)]
    for curve, role, name in ((evidence.before, 'c1', 'without it'),
                              (evidence.after, 'c0', 'with it')):
        curves += [Curve(name, curve.x, size * curve.mean, role)]
        curves += [Curve(f'{name}, 95 % {side}', curve.x,
                         size * (curve.mean + sign * curve.half), role, dashed=True, hidden=True)
                   for sign, side in ((-1.0, 'low'), (1.0, 'high'))]
    curves.append(Curve('the effect itself', evidence.own.x, size * evidence.own.mean, 'c2',
                        dashed=True))
    report.xy_chart(f'torque {evidence.title}', curves, evidence.x_label,
                    f'torque [{scale.unit}]')


def _add_left(report, result):
    if result.unexplained is None:
        return
    left = result.unexplained
    report.heading('What is unexplained')
    report.note(left.sentence, warning=True)
    if result.nearest:
        report.text(capitalised(result.nearest))
    report.table(('share of what was missing', 'equation', 'joint', 'depends most on'),
                 [(f'{100.0 * left.share:.1f} %', left.equation, left.joint, left.variable)])


def _add_residuals(report, along, found, picture):
    before, after, clean = residuals_of(along, found)
    report.heading('Where model and measurement disagree')
    report.text('Torque that is missing in the equations of motion, behind a low-pass of 8 Hz; '
                'positive pushes forward. Maps are white where the mean is chance (95 %), grey '
                'where the motion did not go.')
    over = over_all(along, before, after, clean)
    for j, joint in enumerate(along.joints):
        name = f'{file_stem(joint)}_{j + 1}'
        report.figure(picture(maps_figure(maps_of(along, before, after, j), joint),
                              f'map_{name}.png'), f'{joint}: maps of the missing torque')
        for equation, _ in along.channels(j):
            own = [one for one in over if (one.joint, one.equation) == (joint, equation)]
            report.figure(picture(over_figure(own), f'over_{name}_{equation}.png'),
                          f'{joint}: missing in the {equation} equation, over each variable')
    report.table(
        ('joint', 'equation', 'variable', 'before', 'after', 'nothing missing',
         'bins off zero: before', 'after', 'nothing missing'),
        [(one.joint, one.equation, one.variable,
          *(f'{100.0 * share:.0f} %' for share in (*one.shares, *one.off_zero)))
         for one in sorted(over, key=lambda one: -one.shares[0])],
        'Share of the residual that is a function of one variable alone: known parameters '
        're-tuned, with the effects found, and in a run of the model itself, which is chance; '
        'and the share of bins whose 95 % band leaves zero out')
    time, split = _first_times(along), along.problem.whitenings[0].settled.sum()
    scale = torque_scale(before[:split])
    for j, joint in enumerate(along.joints):
        for equation, column in along.channels(j):
            report.chart(f'{joint}: missing in the {equation} equation', time, [
                Series('before', scale.factor * before[:split, column], role='c1'),
                Series('after', scale.factor * after[:split, column], role='c0')],
                y_label=f'torque [{scale.unit}]')


def _first_times(along):
    whitening = along.problem.whitenings[0]
    return whitening.time[whitening.settled]


def _add_free_runs(report, problem, found, holdout):
    path = path_of(holdout[0], problem.robot) if holdout else problem.paths[0]
    (starts, measured, before), (_, _, after) = (
        _simulated(problem, path, model) for model in (found.before, found.model))
    step = max(1, int(np.ceil(measured.shape[1] * len(starts) / _POINTS)))
    time = starts[:, None] + path.fine_period * np.arange(measured.shape[1]) - path.fine_time[0]

    def line(values):  # NaN lifts the pen before each start
        kept = np.array(values[:, ::step], dtype=float)
        kept[:, -1] = np.nan
        return kept.ravel()
    time = time[:, ::step].ravel()
    report.heading('Measured and simulated motion')
    report.text(f'From the measured state, every {HORIZON:g} s anew, each model runs on freely '
                'under the recorded torque alone; nothing corrects it'
                + (f'. Recording: {path.source}.' if holdout or len(problem.paths) > 1 else '.'))
    for j, joint in enumerate(path.joints):
        report.chart(f'{joint}: link angle', time, [
            Series('measured', measured[:, ::step, j].ravel(), role='reference'),
            Series('before', line(before[:, :, j]), role='c1'),
            Series('after', line(after[:, :, j]), role='c0')], y_label='angle [rad]')
        report.chart(f'{joint}: simulated - measured', time, [
            Series(name, 1e3 * line(values[:, :, j] - measured[:, :, j]), role=role)
            for name, values, role in (('before', before, 'c1'), ('after', after, 'c0'))],
            y_label='angle [mrad]')


def _simulated(problem, path, model):
    """
    Return times of the starts, and measured and simulated link angles (S, H, n).

    NaN where a run crosses a hole in the angles.
    """
    starts, link, _ = free_runs(path, problem.constants(model.robot, model.x))
    first = np.searchsorted(path.fine_time, starts - 0.5 * path.fine_period)
    measured = path.readings[first[:, None] + np.arange(link.shape[1]), 0]
    measured[~all_known(path, starts)] = np.nan
    return starts, measured, measured - np.clip(link, -10.0, 10.0)


def _add_tables(report, result, models):
    report.heading('What was tried')
    if models:
        report.table(*comparison_rows(models, result.gap.joints),
                     'Models compared. Missing: squared residual above that of a clean run, in '
                     'units of it')
    report.table(('effect', 'joint', 'score'),
                 [(one.effect, one.joint, ('' if one.bounded else 'at most ') + f'{one.score:.4g}')
                  for one in result.tried],
                 'First scan: sum of squares that each effect alone would remove, known '
                 'parameters re-tuned; beyond the best, bounds of parameters left aside')
    joints = list(dict.fromkeys(joint for _, joint, _ in result.retuned))
    changes = {}
    for name, joint, change in result.retuned:
        changes.setdefault(name, {}).setdefault(joint, []).append(f'{100.0 * change:+.2f} %')
    report.table(('parameter', *joints), [
        (name, *(', '.join(of.get(joint, ())) for joint in joints))
        for name, of in changes.items()],
        'Known parameters re-tuned within their doubt; velocity: forward, backward')
