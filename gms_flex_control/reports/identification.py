# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The report of an identification: what can be trusted, shown in pictures and tables."""

from functools import partial
from pathlib import Path

from gms_flex_control.identification.beside import known_presliding, known_steady, known_values
from gms_flex_control.identification.words import (
    data_sentence,
    floor_shares,
    joint_sentences,
    NOT_IDENTIFIABLE,
    notes,
    number,
    percent,
    quantity,
    short_label,
    short_name,
    span,
    standing,
    STANDINGS,
)
from gms_flex_control.params.units import in_units
from gms_flex_control.reports.figures import file_stem, save_figure
from gms_flex_control.reports.identification_figures import (
    DIRECTIONS,
    held_out_figure,
    loops_figure,
    map_figure,
    MOST_LOOPS,
    residual_figure,
    residuals,
    sliding_figure,
)
from gms_flex_control.reports.page import Curve, Report, Series
from gms_flex_control.reports.series import decimate
import numpy as np

MOST_TRACES = 6          # of one joint on the page
_TRACE_POINTS = 20_000   # of one line of a trace; longer ones are written as extremes
_CLOUD = 4_000           # points of a cloud
_SYMBOLS = {'static': 'F_s', 'coulomb': 'F_c', 'velocity': 'v_s', 'viscous': 'σ_2',
            'attraction': 'C', 'motor_inertia': 'J'}
_BLOCK_SYMBOLS = {'stiffness': 'k', 'weight': 'α'}


def write_identification_report(identification, folder, *, beside=None):
    """
    Write report.html and the PNGs.

    Parameters
    ----------
    identification : Identification
        What to show.
    folder : str or Path
        Made if need be; files of the same names are replaced.
    beside : RobotParams, optional
        Friction known otherwise, such as that of a simulated plant: drawn and tabled as true.

    Returns
    -------
    list of Path
        What was written, the page first.

    """
    folder, words = Path(folder), partial(in_units, identification.robot.arm)
    pictures = list(_save_pictures(identification, folder, beside))
    report = Report('Friction identification', data_sentence(identification), words)
    _add_summary(report, identification)
    report.figure(pictures[0][0], pictures[0][1])
    for result in identification.joints:
        _add_joint(report, result, identification, beside)
    paper = [(path, caption) for path, caption in pictures
             if path.name.startswith(('map_', 'presliding_'))]
    report.heading("Pictures (as the paper's Figs. 3 and 4)")
    for path, caption in paper:
        report.figure(path, caption)
    return [report.write(folder / 'report.html'), *(path for path, _ in pictures)]


def _save_pictures(identification, folder, beside):
    """Yield path and caption of each picture written."""
    words, path = partial(in_units, identification.robot.arm), folder / 'held_out.png'
    save_figure(held_out_figure(identification.joints), path, words)
    yield path, 'Errors on data that took no part in the fit'
    for i, result in enumerate(identification.joints):
        stem = file_stem(result.joint)
        clash = any(file_stem(other.joint) == stem for other in identification.joints[:i])
        stem = f'{stem}_{i + 1}' if clash else stem
        steady, curve = _known_curves(result, beside)
        figures = [('map', map_figure(result, steady), 'friction over velocity'),
                   ('presliding', loops_figure(result, curve), 'presliding'),
                   ('residual', residual_figure(result), 'residual')]
        if result.traces:
            trace = max(result.traces, key=lambda trace: np.ptp(trace.velocity))
            figures.append(('sliding', sliding_figure(trace, result.joint), 'motion over time'))
        for name, figure, caption in figures:
            path = folder / f'{name}_{stem}.png'
            save_figure(figure, path, words)
            yield path, f'{result.joint}: {caption}'


def _known_curves(result, beside):
    """Return steady friction and presliding curve of a robot that is known; None without."""
    if beside is None or result.joint not in beside.joints:
        return None, None
    return (known_steady(beside, result.joint, result.steady_velocity),
            known_presliding(beside, result.joint, result.curve[0]))


def _add_summary(report, identification):
    report.heading('Summary')
    report.text(f'Fitted in {identification.seconds:.1f} s.')
    for text in identification.warnings:
        report.note(text, warning=True)
    rows = []
    for result in identification.joints:
        counts = [sum(standing(estimate) == kind for estimate in result.estimates)
                  for kind in STANDINGS]
        rows.append((result.joint, percent(result.held_out.relative),
                     percent(result.held_out.coulomb_viscous), *counts))
    report.table(('joint', 'error', 'Coulomb + viscous', *STANDINGS), rows,
                 'Held-out torque error relative to the drive torque, with Coulomb + viscous '
                 'friction alone beside it; how many parameters are how well known')
    for result in identification.joints:
        report.heading(result.joint, level=3)
        for text, warning in joint_sentences(result):
            (report.note(text, warning=True) if warning else report.text(text))


def _add_joint(report, result, identification, beside):
    steady, curve = _known_curves(result, beside)
    known = known_values(beside, identification.robot, result.joint) if beside else None
    report.heading(result.joint)
    report.text('Friction torque taken from ' + (
        'the spring between motor and link.' if result.side == 'spring' else
        'the motor torque, with the motor inertia part of the link.'))
    _add_parameters(report, result, known)
    _add_map(report, result, steady)
    _add_presliding(report, result, curve)
    _add_motion(report, result)
    _add_errors(report, result)
    _add_candidates(report, result)


def _add_parameters(report, result, known):
    report.heading(f'{result.joint}: parameters', level=3)
    lost = [short_name(estimate.name, result.joint) for estimate in result.estimates
            if standing(estimate) == NOT_IDENTIFIABLE]
    if lost:
        report.note(f"NOT identifiable from these data: {', '.join(lost)}. Their values, in "
                    'brackets, are where the fit happened to end.', warning=True)
    rows = []
    for estimate in result.estimates:
        kind = standing(estimate)
        value = number(estimate.value, 5)
        words = ', '.join(estimate.flags) or kind
        rows.append((short_name(estimate.name, result.joint), _symbol(estimate.name),
                     f'({value})' if kind == NOT_IDENTIFIABLE else value,
                     *((number(known.get(estimate.name, np.nan), 5),) if known else ()),
                     estimate.unit, words.upper() if kind == NOT_IDENTIFIABLE else words,
                     span(estimate.interval)))
    report.table(('parameter', 'symbol', 'estimate', *(('true',) if known else ()), 'unit',
                  'standing', '95 % interval'), rows,
                 'Estimates as in friction.yaml')
    for note in notes(result):
        report.note(note)


def _symbol(name):
    """Return the paper's symbol of a parameter; its blocks count from 1."""
    leaf, _, index = name.split('.')[-1].partition('[')
    if index:
        return f'{_BLOCK_SYMBOLS.get(leaf, leaf)}_{int(index.rstrip("]")) + 1}'
    if leaf == 'stiffness':
        return 'K'
    return _SYMBOLS.get(leaf, '')


def _add_map(report, result, known):
    measured, fit = result.friction_map, result.steady_velocity
    over, log = [], []
    for i, (sign, name, _) in enumerate(DIRECTIONS):
        way = sign * measured.velocity > 0.0
        for steady, label, role in ((True, f'{name}, steady', f'c{i}'),
                                    (False, f'{name}, not steady', 'c6')):
            rows = _thinned(np.flatnonzero(way & (measured.steady == steady)))
            point = measured.velocity[rows], measured.torque[rows]
            over.append(Curve(label, *point, role, points=True))
            log.append(Curve(label, sign * point[0], sign * point[1], role, points=True))
        rows = sign * fit > 0.0
        for torque, label, dashed in ((result.steady_torque, f'{name}, fitted', False),
                                      (known, f'{name}, true', True)):
            if torque is not None:
                role = 'reference' if dashed else f'c{i + 3}'
                over.append(Curve(label, fit[rows], torque[rows], role, dashed=dashed))
                log.append(Curve(label, sign * fit[rows], sign * torque[rows], role,
                                 dashed=dashed))
    report.heading(f'{result.joint}: friction over velocity (Fig. 3)', level=3)
    _curves(report, 'over velocity', over, 'velocity [rad/s]', 'friction torque [N m]')
    _curves(report, 'over the logarithm of speed', log, 'speed [rad/s]',
            'torque against the motion [N m]', log_x=True)


def _add_presliding(report, result, known):
    loops = []
    for i, loop in enumerate(result.loops):
        hidden, label = i >= MOST_LOOPS, short_label(loop.label)
        loops += [Curve(f'{label}, measured', 1e3 * loop.displacement, loop.torque,
                        f'c{i % 6}', hidden=hidden),
                  Curve(f'{label}, fitted', 1e3 * loop.model_displacement, loop.torque,
                        'reference', dashed=True, hidden=hidden)]
    x, torque, low, high = result.curve
    curves = [Curve('fitted', 1e3 * x, torque, 'c0'),
              Curve('95 % low', 1e3 * x, low, 'c5', dashed=True),
              Curve('95 % high', 1e3 * x, high, 'c5', dashed=True)]
    if known is not None:
        curves.append(Curve('true', 1e3 * x, known, 'reference', dashed=True))
    report.heading(f'{result.joint}: presliding (Fig. 4)', level=3)
    if not len(x):
        report.note('No stiffness is identifiable from these data: no curve from rest is drawn.')
    if not result.loops:
        report.note('The data hold no presliding motion' + (
            ': the curve rests on reversals alone.' if len(x) else '.'))
    _curves(report, 'hysteresis loops', loops, 'displacement [mrad]', 'friction torque [N m]')
    _curves(report, 'from rest', curves, 'displacement [mrad]', 'friction torque [N m]',
            log_x=True)


def _curves(report, title, curves, x_label, y_label, **options):
    """Add a chart of the curves that have a point to draw."""
    drawn = [curve for curve in curves if np.any(
        np.isfinite(curve.x) & np.isfinite(curve.y))]
    if drawn:
        report.xy_chart(title, drawn, x_label, y_label, **options)


def _add_motion(report, result):
    report.heading(f'{result.joint}: friction torque over time', level=3)
    if len(result.traces) > MOST_TRACES:
        report.text(f'The first {MOST_TRACES} of {len(result.traces)} pieces.')
    for i, trace in enumerate(result.traces[:MOST_TRACES]):
        held = np.where(trace.held_out, trace.model, np.nan)
        time, (measured, model, held, residual, velocity) = decimate(
            trace.time, [trace.measured, trace.model, held, trace.measured - trace.model,
                         trace.velocity], _TRACE_POINTS)
        group = f'{result.joint} {i}'
        for name, unit, lines in (
                ('friction', 'N m', [
                    Series('measured', measured, role='c5'),
                    Series('model', model, role='reference'),
                    Series('model, held out', held, role='c1')]),
                ('residual', 'N m', [Series('measured − model', residual, role='c1')]),
                ('velocity', 'rad/s', [Series('link', velocity, role='c2')])):
            lines = [line for line in lines if np.isfinite(line.y).any()]
            if lines:
                report.chart(f'{short_label(trace.label)}: {name}', time, lines,
                             y_label=f'{name} [{unit}]', group=group)
    velocity, residual, out = residuals(result)
    clouds = []
    for name, rows, role in (('fitted', ~out, 'c5'), ('held out', out, 'c1')):
        rows = _thinned(np.flatnonzero(rows))
        clouds.append(Curve(name, velocity[rows], residual[rows], role, points=True))
    _curves(report, 'residual over velocity', clouds, 'velocity [rad/s]',
            'measured − model [N m]')


def _add_errors(report, result):
    errors = result.held_out
    noise, repeat = floor_shares(errors)
    report.heading(f'{result.joint}: errors on held-out data', level=3)
    simple = errors.coulomb_viscous / errors.relative if errors.relative else np.nan
    report.table(('', 'torque error', 'of the drive torque', 'free-run error'), [
        ('identified model', quantity(errors.torque_rms, 'N m'), percent(errors.relative),
         quantity(1e3 * errors.free_run_rms, 'mrad')),
        ('Coulomb + viscous alone', quantity(simple * errors.torque_rms, 'N m'),
         percent(errors.coulomb_viscous),
         quantity(1e3 * errors.free_run_coulomb_viscous, 'mrad')),
        ('same motion repeated', quantity(errors.repeatability, 'N m'), percent(repeat), '-'),
        ('measurement noise alone', quantity(errors.noise_floor, 'N m'), percent(noise), '-')],
        f'rms; free run over {number(errors.horizon)} s; one-step prediction of the angle '
        f'{number(1e3 * errors.innovation_rms)} mrad')


def _add_candidates(report, result):
    if not result.candidates:
        return
    report.heading(f'{result.joint}: numbers of blocks tried', level=3)
    best = min(candidate.cost for candidate in result.candidates)
    report.table(('blocks N', '', 'held-out cost per sample', 'above the best',
                  'standard error of that'), [
        (candidate.n_blocks, 'chosen' if candidate.chosen else '', number(candidate.cost, 6),
         number(candidate.cost - best, 3), number(candidate.error, 3))
        for candidate in result.candidates],
        'The fewest blocks that no other number beats beyond chance are taken')


def _thinned(rows):
    """Return few enough of the rows, evenly."""
    return rows[::max(1, int(np.ceil(len(rows) / _CLOUD)))]
