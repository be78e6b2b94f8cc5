# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The report of a discrepancy: what the model lacks, why, and how much closer it came."""

from functools import partial
from pathlib import Path

from gms_flex_control.discrepancy.describe import (
    capitalised,
    of_noise,
    torque_scale,
)
from gms_flex_control.discrepancy.free_run import all_known, free_runs, HORIZON
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE, FOUND, UNEXPLAINED
from gms_flex_control.effects.registry import find
from gms_flex_control.params.units import in_units
from gms_flex_control.reports.discrepancy_figures import (
    evidence_figure,
    gap_figure,
    maps_figure,
    over_figure,
)
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
                    + ', '.join(result.sources), units_of(result))
    pictures = add_discrepancy(report, result, folder, holdout=holdout, models=models)
    return [report.write(folder / 'report.html'), *pictures]


def units_of(result):
    """Return the function that puts a text into the units of the robot of a Discrepancy."""
    return str if result.robot is None else partial(in_units, result.robot.arm)


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
        save_figure(figure, path, units_of(result))
        pictures.append(path)
        return path

    _add_summary(report, result)
    if result.behind is not None:
        along = Along(result.behind.likelihood)
        report.figure(picture(gap_figure(result.gap), 'gap.png'),
                      'The gap on data held out')
        _add_rest_and_noise(report, result)
        _add_findings(report, result, along, picture)
        _add_left(report, result)
        _add_residuals(report, along, result.behind, picture)
        _add_free_runs(report, result.behind, holdout)
        _add_closed_loop(report, result.gap.closed_loop)
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
                    'Re-tuned means that only parameters the model has already were moved, as far '
                    'as their priors make plausible. The noise floor is a null simulation: a run '
                    'of the final model itself, read through encoders like those of the '
                    'recording, with its torque noise.')


def _add_rest_and_noise(report, result):
    gap = result.gap
    if np.isfinite(gap.rest_after).any():
        scale = torque_scale([gap.rest_before, gap.rest_after])
        report.table(
            ('joint', f're-tuned [{scale.unit}]', f'with the effects found [{scale.unit}]'),
            [(joint, scale.text(before), scale.text(after)) for joint, before, after in zip(
                gap.joints, gap.rest_before, gap.rest_after, strict=True)],
            'Residual torque while links stand, rms: friction at rest is anything up to '
            'break-away, so these figures decide nothing')
    if result.noise:
        report.heading('Torque noise of the recordings')
        report.table(('where', 'size and colour'),
                     [of_noise(one).split(': ', 1) for one in result.noise],
                     'Beyond what encoders make; the likelihood takes it into account')


def _add_findings(report, result, along, picture):
    findings = result.named
    report.heading('What was found')
    if findings:
        scale = torque_scale([one.torque for one in findings])
        report.table(
            ('effect', 'joint', 'parameters (95 %)', f'torque [{scale.unit}]', 'share',
             'probability', 'held-out gain', 'indistinguishable from'),
            [_finding_row(one, scale) for one in findings],
            'The largest first; small ones (*) are below what matters in practice. Share: of what '
            're-tuning cannot explain, what would be left without the effect. Probability: of all '
            'models that have it. Held-out gain: of log likelihood on blocks of time left out '
            'of the fit, and in standard errors of its mean over blocks in which the effect acts')
    sets = [set(model.effects) for model in result.models]
    common = set.intersection(*sets) if sets else set()
    report.table(('effects', 'probability'), [
        (_names(own - common) or ('no other' if common else 'none'), f'{model.probability:.3f}')
        for own, model in zip(sets, result.models, strict=True)],
        'The credible set: the fewest models that hold 95 % of the probability'
        + (f'. All of them have {_names(common)}; beside these:' if common else ''))
    for i, finding in enumerate(findings[:MOST_PICTURES]):
        report.heading(f'{finding.effect} of {finding.joint}', level=3)
        report.text(_summary_of(finding.effect))
        report.text(capitalised(finding.evidence))
        if finding.confusable_with:
            report.note(f'Indistinguishable in these data from '
                        f'{", ".join(finding.confusable_with)}. Discriminating experiment: '
                        f'{finding.tells_apart}.', warning=True)
        evidence = evidence_of(along, result.behind.after, finding)
        stem = file_stem(f'{finding.effect}_{finding.joint}')
        report.figure(picture(evidence_figure(evidence), f'evidence_{i + 1}_{stem}.png'),
                      f'{finding.effect} of {finding.joint}: over {evidence.x_label}')
        _add_evidence_chart(report, evidence)


def _names(effects):
    return ', '.join(f'{effect} of {joint}' for effect, joint in sorted(effects))


def _finding_row(finding, scale):
    values = '; '.join(f'{v.name} {v.value:.4g} ({v.low:.4g} .. {v.high:.4g})'
                       f'{"" if v.unit == "1" else " " + v.unit}' for v in finding.values)
    return (f'{finding.effect}{"" if finding.main else " *"}', finding.joint, values,
            scale.text(finding.torque), f'{100.0 * finding.share:.1f} %',
            f'{finding.probability:.3f}', f'{finding.held_out.nats:.3g} nats ('
            f'{finding.held_out.sigmas:.2g} sigma, {finding.held_out.blocks} blocks)',
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
    report.table(('share of what was missing', 'equation', 'joint', 'depends most on'),
                 [(f'{100.0 * left.share:.1f} %', left.equation, left.joint, left.variable)])


def _add_residuals(report, along, behind, picture):
    before, after, null = residuals_of(along, behind)
    report.heading('Where model and measurement disagree')
    report.text('Torque that is missing in the equations of motion, behind a low-pass of 8 Hz; '
                'positive pushes forward. Maps are white where the mean is chance (95 %), grey '
                'where the motion did not go.')
    over = over_all(along, before, after, null)
    for j, joint in enumerate(along.joints):
        name = f'{file_stem(joint)}_{j + 1}'
        report.figure(picture(maps_figure(maps_of(along, before, after, j), joint),
                              f'map_{name}.png'), f'{joint}: maps of the missing torque')
        for equation, _ in along.channels(j):
            own = [one for one in over if (one.joint, one.equation) == (joint, equation)]
            report.figure(picture(over_figure(own), f'over_{name}_{equation}.png'),
                          f'{joint}: missing in the {equation} equation, over each variable')
    report.table(
        ('joint', 'equation', 'variable', 'before', 'after', 'by chance',
         'bins off zero: before', 'after', 'by chance'),
        [(one.joint, one.equation, one.variable,
          *(f'{100.0 * share:.0f} %' for share in (*one.shares, *one.off_zero)))
         for one in sorted(over, key=lambda one: -one.shares[0])],
        'Share of the residual that is a function of one variable alone: known parameters '
        're-tuned, with the effects found, and in a null simulation, which shows what is chance; '
        'and the share of bins whose 95 % band leaves zero out')
    first = along.likelihood.whitenings[0]
    time, split = first.time[first.settled], first.settled.sum()
    scale = torque_scale(before[:split])
    for j, joint in enumerate(along.joints):
        for equation, column in along.channels(j):
            report.chart(f'{joint}: missing in the {equation} equation', time, [
                Series('before', scale.factor * before[:split, column], role='c1'),
                Series('after', scale.factor * after[:split, column], role='c0')],
                y_label=f'torque [{scale.unit}]')


def _add_free_runs(report, behind, holdout):
    likelihood = behind.likelihood
    motion = motion_of(holdout[0], likelihood.robot) if holdout else likelihood.motions[0]
    (starts, measured, before), (_, _, after) = (
        _simulated(likelihood, motion, model) for model in (behind.before, behind.after))
    step = max(1, int(np.ceil(measured.shape[1] * len(starts) / _POINTS)))
    time = (starts[:, None] - motion.fine_time[0]
            + motion.fine_period * np.arange(measured.shape[1]))

    def line(values):  # NaN lifts the pen before each start
        kept = np.array(values[:, ::step], dtype=float)
        kept[:, -1] = np.nan
        return kept.ravel()
    time = time[:, ::step].ravel()
    report.heading('Measured and simulated motion')
    report.text(f'From the measured state, every {HORIZON:g} s anew, each model runs on freely '
                'under the recorded torque alone; nothing corrects it'
                + (f'. Recording: {motion.source}.' if holdout or len(likelihood.motions) > 1
                   else '.'))
    for j, joint in enumerate(motion.joints):
        report.chart(f'{joint}: link angle', time, [
            Series('measured', measured[:, ::step, j].ravel(), role='reference'),
            Series('before', line(before[:, :, j]), role='c1'),
            Series('after', line(after[:, :, j]), role='c0')], y_label='angle [rad]')
        report.chart(f'{joint}: simulated - measured', time, [
            Series(name, 1e3 * line(values[:, :, j] - measured[:, :, j]), role=role)
            for name, values, role in (('before', before, 'c1'), ('after', after, 'c0'))],
            y_label='angle [mrad]')


def _simulated(likelihood, motion, model):
    """
    Return times of the starts, and measured and simulated link angles (S, H, n).

    NaN where a run crosses a hole in the angles.
    """
    starts, link, _ = free_runs(motion, likelihood.constants(model.robot, model.x))
    first = np.searchsorted(motion.fine_time, starts - 0.5 * motion.fine_period)
    measured = motion.readings[first[:, None] + np.arange(link.shape[1]), 0]
    measured[~all_known(motion, starts)] = np.nan
    return starts, measured, measured - np.clip(link, -10.0, 10.0)


def _add_closed_loop(report, again):
    if again is None:
        return
    report.heading('The closed loop, simulated anew')
    report.text('Model and controller follow the recorded reference once more; each figure is how '
                'far the simulated link angle is from the measured one. The controller believes '
                'the model as given, as it did on the robot. The noise floor is by what two '
                'runs of the final model differ that differ in encoder noise alone.')
    report.table(
        ('joint', 'as given [mrad]', 're-tuned [mrad]', 'with the effects [mrad]',
         'noise floor [mrad]'),
        [(joint, *(f'{1e3 * value[j]:.3g}' for value in (
            again.before, again.retuned, again.after, again.floor)))
         for j, joint in enumerate(again.joints)],
        f'Simulated less measured link angle, rms, over {", ".join(again.sources)}')
    for j, joint in enumerate(again.joints):
        report.chart(f'{joint}: closed loop, simulated - measured', again.time, [
            Series(name, 1e3 * (course[:, j] - again.measured[:, j]), role=role)
            for name, course, role in (('before', again.course_before, 'c1'),
                                       ('after', again.course_after, 'c0'))],
            y_label='angle [mrad]')


def _add_tables(report, result, models):
    report.heading('What was tried')
    if models:
        report.table(*comparison_rows(models, result.gap.joints),
                     'Models compared. Missing: mean square of the whitened residuals above that '
                     'of null simulations')
    report.table(('effect', 'joint', 'score'),
                 [(one.effect, one.joint, ('' if one.bounded else 'at most ') + f'{one.score:.4g}')
                  for one in result.tried],
                 'First scan: by how much -2 log likelihood would decrease with each effect '
                 'alone, known parameters re-tuned; beyond the best, bounds of parameters left '
                 'aside')
    joints = list(dict.fromkeys(joint for _, joint, _ in result.retuned))
    changes = {}
    for name, joint, change in result.retuned:
        changes.setdefault(name, {}).setdefault(joint, []).append(f'{100.0 * change:+.2f} %')
    report.table(('parameter', *joints), [
        (name, *(', '.join(of.get(joint, ())) for joint in joints))
        for name, of in changes.items()],
        'Known parameters re-tuned with their priors; velocity: forward, backward')
