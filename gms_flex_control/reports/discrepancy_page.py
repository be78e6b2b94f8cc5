# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The page of a discrepancy: what the model lacks, why, and how much closer it came."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from gms_flex_control.discrepancy import describe, residual_views
from gms_flex_control.discrepancy.compared import free_runs_of
from gms_flex_control.discrepancy.gap import HORIZON
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND, UNEXPLAINED
from gms_flex_control.effects.registry import in_words
from gms_flex_control.params.arm import in_currents, in_units
from gms_flex_control.params.robot import with_effects
from gms_flex_control.reports.answers import COLUMNS, discrepancy_answer, WITH, WITHOUT
from gms_flex_control.reports.discrepancy_values import comparison_rows
from gms_flex_control.reports.figure_style import file_stem, save_figure
from gms_flex_control.reports.page import ChartSeries, Report
from gms_flex_control.reports.pictures import evidence_figure, gap_figure, maps_figure, over_figure
import numpy as np

TITLES = {COMPLETE: 'Nothing is missing', FOUND: 'Effects the model lacks',
          UNEXPLAINED: 'Something is missing that no effect explains well enough',
          BAD_DATA: 'The data are at fault'}
MOST_PICTURES = 8     # findings that matter, with a picture of their own
MOST_OVER = 4         # variables a residual is drawn over: the table has all
MOST_JOINTS = 3       # with maps and courses of their residual: those farthest above its floor


def write_discrepancy_report(result, folder, *, holdout=(), models=()) -> list:
    """Write report.html and PNGs of a Discrepancy; return the paths, the page first."""
    folder = Path(folder)
    answer = discrepancy_answer(result, folder, [recording.source for recording in holdout])
    report = Report(TITLES[result.verdict], answer, ', '.join(result.data.sources),
                    units_of(result))
    pictures = add_discrepancy(report, result, folder, holdout=holdout, models=models)
    return [report.write(folder / 'report.html'), *pictures]


def units_of(result) -> Callable:
    """Return the function that puts a text into the units of the robot of a Discrepancy."""
    if result.data.currents:
        return in_currents
    if result.robot is None or result.robot.arm.axes == 'rotary':
        return str
    return partial(in_units, result.robot.arm)


def add_discrepancy(report, result, folder, *, holdout=(), models=(), opened=False) -> list:
    """Add a discrepancy to a Report, picture first unless ``opened``; return the PNGs written."""
    pictures = []

    def picture(figure, name):
        save_figure(figure, folder / name, units_of(result))
        pictures.append(folder / name)
        return figure

    if result.behind is None:
        _add_summary(report, result)
        return pictures
    along = residual_views.Along(result.behind.likelihood)
    evidence = {one: _evidence_of(along, result, one)
                for one in [one for one in result.named if one.main][:MOST_PICTURES]}
    drawn = {one: picture(evidence_figure(shown), f'evidence_{result.named.index(one) + 1}_'
                          f'{file_stem(f"{one.effect}_{one.joint}")}.png')
             for one, shown in evidence.items()}
    runs = free_runs_of(result.behind, holdout)
    first = None  # what stands open: how an effect shows, or the free runs of a joint
    if evidence and not opened:
        first = next(iter(evidence))
        _add_evidence(report, evidence[first], drawn[first])
    elif not opened:
        first = int(np.argmax(np.nan_to_num(result.gap.free_after)))
        _add_free_run(report, runs, first)
    _add_summary(report, result)
    report.figure(picture(gap_figure(result.gap), 'gap.png'), 'The gap on data held out')
    _add_rest_and_noise(report, result)
    _add_findings(report, result, evidence, drawn, first)
    _add_left(report, result)
    _add_residuals(report, along, result.behind, picture)
    _add_free_runs(report, runs, first)
    _add_closed_loop(report, result.gap.closed_loop)
    _add_tables(report, result, models)
    return pictures


def _evidence_of(along, result, finding):
    """Return how a Finding shows in the model found, or at every sample in the one written."""
    behind, views = result.behind, residual_views
    if not finding.full_rate:
        return views.evidence_of(along, behind.after, finding)
    model = behind.written
    if finding in result.not_added:
        model = replace(model, robot=with_effects(model.robot, finding.spec))
    return views.evidence_of(views.AlongUnfiltered(behind.likelihood), model, finding)


def _add_summary(report, result):
    report.heading('In words')
    report.note(result.words, warning=result.verdict in (BAD_DATA, UNEXPLAINED))
    report.text(f'Found in {result.searched.seconds:.1f} s.')
    for text in result.data.faults:
        report.note(text, warning=True)
    if result.gap is not None:
        report.heading('The gap')
        report.text('Each bar is the residual of a model on data left out of its fit. On this '
                    'page, known parameters are re-tuned within their priors in the model '
                    'without effects. The noise floor is a null simulation: a run of the final '
                    'model, read through encoders like those of the recording, with its torque '
                    'noise.')


def _add_rest_and_noise(report, result):
    gap = result.gap
    if np.isfinite(gap.rest_after).any():
        scale = describe.torque_scale([gap.rest_before, gap.rest_after])
        report.table(
            ('joint', *(f'{name} [{scale.unit}]' for name in (WITHOUT, WITH))),
            [(joint, scale.text(before), scale.text(after)) for joint, before, after in zip(
                gap.joints, gap.rest_before, gap.rest_after, strict=True)],
            'Residual torque at rest, rms: friction at rest can have any value up to break-away, '
            'so no decision rests on these figures')
    if result.data.noise:
        report.heading('Torque noise of the recordings')
        report.table(('where', 'size and colour'),
                     [describe.of_noise(one).split(': ', 1) for one in result.data.noise],
                     'In addition to encoder noise; the likelihood accounts for it')


def _add_findings(report, result, evidence, drawn, first):
    findings = result.named
    report.heading('What was found')
    if findings:
        scale = describe.torque_scale([one.torque for one in findings])
        report.table(
            ('effect', 'joint', 'parameters (95 %)', f'torque [{scale.unit}]', 'share',
             'probability', 'held-out gain', 'indistinguishable from'),
            [_finding_row(one, scale) for one in findings],
            'Largest first; effects marked * are too small to matter in practice. Share: the '
            'part of what re-tuning cannot explain that would remain without the effect. '
            'Probability: of all models with the effect. Held-out gain: of log likelihood on '
            'blocks of time left out of the fit, and in standard errors over the blocks in which '
            'the effect acts')
    sets = [set(model.effects) for model in result.searched.models]
    common = set.intersection(*sets) if sets else set()
    report.table(('effects', 'probability'), [
        (describe.of_joints(own - common) or ('no other' if common else 'none'),
         f'{model.probability:.3f}')
        for own, model in zip(sets, result.searched.models, strict=True)],
        'The credible set: the fewest models that hold 95 % of the probability'
        + (f'. All of them have {describe.of_joints(common)}; beside these:' if common else ''))
    for finding in findings:
        report.heading(f'{finding.effect} of {finding.joint}', level=3)
        report.text(f'{in_words(finding.effect)}.')
        report.text(finding.evidence[0].upper() + finding.evidence[1:])
        if finding.indistinguishable_from:
            report.note(f'Indistinguishable in these data from '
                        f'{describe.of_joints(finding.indistinguishable_from)}. '
                        f'Discriminating experiment: {finding.discriminated_by}.', warning=True)
        if finding in drawn and finding is not first:
            _add_evidence(report, evidence[finding], drawn[finding])


def _finding_row(finding, scale):
    values = '; '.join(f'{v.name} {v.value:.4g} ({v.low:.4g} .. {v.high:.4g})'
                       f'{"" if v.unit == "1" else " " + v.unit}' for v in finding.values)
    return (f'{finding.effect}{"" if finding.main else " *"}', finding.joint, values,
            scale.text(finding.torque), f'{100.0 * finding.share:.1f} %',
            f'{finding.probability:.3f}', f'{finding.held_out.nats:.3g} nats ('
            f'{finding.held_out.sigmas:.2g} sigma, {finding.held_out.blocks} blocks)',
            describe.of_joints(finding.indistinguishable_from))


def _add_evidence(report, evidence, figure):
    report.figure(figure, f'{evidence.effect} of {evidence.joint}: torque {evidence.title}')


def _add_left(report, result):
    left = result.unexplained
    if left is not None:
        report.heading('What is unexplained')
        report.note(left.sentence, warning=True)
        report.table(('share of what was missing', 'equation', 'joint', 'depends most on',
                      'joints that remain unexplained'),
                     [(f'{100.0 * left.share:.1f} %', left.equation, left.joint, left.variable,
                       ', '.join(left.joints))])
    if result.learned:
        report.heading('What was learned instead')
        report.table(('term', 'looks like', 'effective parameters', 'held-out log likelihood'), [
            (f'{one.effect} of {one.joint}', one.formula, f'{one.freedom:.0f}',
             f'+{one.held_out.nats:.3g}') for one in result.learned])


def _add_residuals(report, along, behind, picture):
    before, after, null = residual_views.residuals_of(along, behind)
    report.heading('Where model and measurement disagree')
    report.text('Torque missing in the equations of motion, behind a low-pass of 8 Hz; positive '
                'torque pushes forward. Maps are white where the mean is within chance (95 %), '
                'grey where the motion did not go.')
    over = residual_views.over_all(along, before, after, null)
    above = [np.linalg.norm(before[:, columns]) / max(np.linalg.norm(null[:, columns]), 1e-300)
             for columns in ([column for _, column in along.channels(j)]
                             for j in range(len(along.joints)))]
    shown = sorted(np.argsort(above)[-MOST_JOINTS:].tolist())
    if len(shown) < len(along.joints):
        report.text('Shown are the joints whose residual is largest beside that of a null '
                    f'simulation: {", ".join(along.joints[j] for j in shown)}. The table '
                    'has all.')
    for j in shown:
        joint = along.joints[j]
        report.figure(picture(maps_figure(residual_views.maps_of(along, before, after, j), joint),
                              f'map_{file_stem(joint)}_{j + 1}.png'),
                      f'{joint}: maps of the missing torque')
        for equation, _ in along.channels(j):
            own = [one for one in over if (one.joint, one.equation) == (joint, equation)]
            report.figure(over_figure(sorted(own, key=lambda one: -one.shares[0])[:MOST_OVER]),
                          f'{joint}: missing in the {equation} equation, over what it depends on '
                          'most')
    report.table(
        ('joint', 'equation', 'variable', WITHOUT, WITH, 'by chance',
         f'bins off zero: {WITHOUT}', WITH, 'by chance'),
        [(one.joint, one.equation, one.variable,
          *(f'{100.0 * share:.0f} %' for share in (*one.shares, *one.off_zero)))
         for one in sorted(over, key=lambda one: -one.shares[0])],
        'Share of the residual that is a function of one variable alone, beside that of a null '
        'simulation, which is chance; and the share of bins whose 95 % band excludes zero')
    first = along.likelihood.whitenings[0]
    time, split = first.time[first.settled], first.settled.sum()
    scale = describe.torque_scale(before[:split])
    for j in shown:
        for equation, column in along.channels(j):
            report.chart(f'{along.joints[j]}: missing in the {equation} equation', time, [
                ChartSeries(WITHOUT, scale.factor * before[:split, column], role='c1'),
                ChartSeries(WITH, scale.factor * after[:split, column], role='c0')],
                y_label=f'torque [{scale.unit}]')


def _add_free_runs(report, runs, left_out):
    report.heading('Simulated less measured motion')
    report.text(f'Every {HORIZON:g} s each model starts from the measured state and runs freely '
                'under the recorded torque; nothing corrects it. Recording: '
                f'{runs.motion.samples.source}.')
    for j in range(len(runs.motion.samples.joints)):
        if j is not left_out:
            _add_free_run(report, runs, j)


def _add_free_run(report, runs, j):
    report.chart(f'{runs.motion.samples.joints[j]}: free runs, simulated - measured', runs.time, [
        ChartSeries(name, 1e3 * values[:, j], role=role) for name, values, role in (
            (WITHOUT, runs.without, 'c1'), (WITH, runs.found, 'c0'))],
        y_label='angle [mrad]', group='free runs')


def _add_closed_loop(report, again):
    if again is None:
        return
    report.heading('The closed loop, simulated')
    report.text('Model and controller follow the recorded reference; each figure is the distance '
                'of the simulated link angle from the measured one. The controller believes the '
                'given model, as it did on the robot. The noise floor is the difference of two '
                'runs of the final model with different encoder noise.')
    report.table(
        ('joint', *(f'{name} [mrad]' for name in ('as given', *COLUMNS))),
        [(joint, *(f'{1e3 * value[j]:.3g}' for value in (
            again.before, again.retuned, again.after, again.floor)))
         for j, joint in enumerate(again.joints)],
        f'Simulated less measured link angle, rms, over {", ".join(again.sources)}')
    for j, joint in enumerate(again.joints):
        lines = [ChartSeries(name, 1e3 * (course[:, j] - again.measured[:, j]), role=role)
                 for name, course, role in ((WITHOUT, again.course_before, 'c1'),
                                            (WITH, again.course_after, 'c0'))]
        report.chart(f'{joint}: closed loop, simulated - measured', again.time, lines,
                     y_label='angle [mrad]')


def _add_tables(report, result, models):
    report.heading('What was tried')
    if models:
        report.table(*comparison_rows(models, result.gap.joints),
                     'Models compared. Missing: mean square of the whitened residuals above that '
                     'of null simulations')
    report.table(('effect', 'joint', 'score'),
                 [(one.effect, one.joint, ('' if one.bounded else 'at most ') + f'{one.score:.4g}')
                  for one in result.searched.tried],
                 'First scan: decrease of -2 log likelihood with each effect alone and known '
                 'parameters re-tuned; except for the best effects, parameters are not bounded')
    joints = list(dict.fromkeys(joint for _, joint, _ in result.retuned))
    changes = {}
    for name, joint, change in result.retuned:
        changes.setdefault(name, {}).setdefault(joint, []).append(f'{100.0 * change:+.2f} %')
    report.table(('parameter', *joints), [
        (name, *(', '.join(of.get(joint, ())) for joint in joints))
        for name, of in changes.items()],
        'Known parameters re-tuned with their priors; velocity: forward, backward')
