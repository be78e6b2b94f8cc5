# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""An identification as text for a terminal, and as a page with pictures."""

from functools import partial
from pathlib import Path
from textwrap import fill

from gms_flex_control.answer import Answer, command, measured
from gms_flex_control.identification.beside import (
    known_presliding,
    known_steady,
    known_values,
    presliding_difference,
)
from gms_flex_control.identification.words import (
    data_sentence,
    DOUBTFUL,
    floor_shares,
    joint_sentences,
    NOT_IDENTIFIABLE,
    notes,
    number,
    percent,
    SET,
    short_label,
    short_name,
    span,
    standing,
    STANDINGS,
)
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports.figures import file_stem, save_figure
from gms_flex_control.reports.page import Curve, decimate, Report, Series
from gms_flex_control.reports.pictures import DIRECTIONS, loops_figure, map_figure, MOST_LOOPS
import numpy as np

MOST_TRACES = 6          # of one joint on the page
_TRACE_POINTS = 20_000   # of one line of a trace; longer ones are written as extremes
_KNOWN = ('well known', 'roughly known')
_SYMBOLS = {'static': 'F_s', 'coulomb': 'F_c', 'velocity': 'v_s', 'viscous': 'σ_2',
            'attraction': 'C', 'motor_inertia': 'J'}
_BLOCK_SYMBOLS = {'stiffness': 'k', 'weight': 'α'}
_WIDTH = 98               # of text
_LONGEST_NAME = 22       # of a joint in text


def identification_text(identification, beside=None) -> str:
    """Return an identification as lines of text; ``beside`` as of the report."""
    blocks = [_wrapped(f'{data_sentence(identification)}; fitted in '
                       f'{identification.seconds:.1f} s')]
    blocks += [_wrapped(f'warning: {text}') for text in identification.warnings]
    for result in identification.joints:
        known = known_values(beside, identification.robot, result.joint) if beside else None
        blocks.append(_joint_text(result, known, beside))
    blocks.append('Errors on held-out data; C+v: Coulomb + viscous alone\n'
                  + _aligned(*_held_out_rows(identification.joints)))
    return '\n\n'.join(blocks)


def _parameter_rows(result, known=None):
    """Return header and rows of a joint's parameters; ``known`` values by name, if any."""
    header = ('parameter', 'unit', 'value', '95 % interval', *(('true',) if known else ()),
              'to be noted')
    rows = []
    for estimate in result.estimates:
        lost = standing(estimate) == NOT_IDENTIFIABLE
        value, interval = number(estimate.value), span(estimate.interval)
        rows.append((short_name(estimate.name, result.joint), estimate.unit,
                     f'({value})' if lost else value, interval,
                     *((number(known.get(estimate.name, np.nan)),) if known else ()),
                     _remark(estimate)))
    return header, rows


def _remark(estimate):
    if standing(estimate) == NOT_IDENTIFIABLE:
        return 'NOT IDENTIFIABLE'
    if len(estimate.flags) > 1:
        return f'{estimate.flags[0]}, +{len(estimate.flags) - 1}'
    return estimate.flags[0] if estimate.flags else SET if standing(estimate) == SET else ''


def _held_out_rows(results):
    """Return header and rows of held-out errors, one row per joint."""
    header = ('joint', 'torque [%]', 'C+v [%]', 'noise [%]', 'repeat [%]', 'free run [mrad]',
              'C+v [mrad]')
    rows = []
    for result in results:
        errors = result.held_out
        noise, repeat = floor_shares(errors)
        rows.append((_clipped(result.joint), *(number(100 * share, 3) for share in (
            errors.relative, errors.coulomb_viscous, noise, repeat)),
            number(1e3 * errors.free_run_rms, 3),
            number(1e3 * errors.free_run_coulomb_viscous, 3)))
    return header, rows


def _joint_text(result, known, beside):
    blocks = [(candidate.n_blocks, candidate.chosen) for candidate in result.candidates]
    chosen = next((f', N = {n} blocks' for n, used in blocks if used), '')
    source = {'spring': 'the spring', 'motor': 'the motor torque'}.get(result.side, result.side)
    lines = [f'{_clipped(result.joint)}: friction torque by {source}{chosen}',
             _aligned(*_parameter_rows(result, known))]
    if known:
        share, where = presliding_difference(result, beside)
        lines.append(f'presliding curve: at most {number(100 * share, 3)} % of F_s off the true '
                     f'one, at {number(1e3 * where, 3)} mrad')
    lines += [_wrapped(f'- {note}') for note in notes(result)]
    lines += [_wrapped(f'warning: {text}') for text in result.warnings]
    return '\n'.join(lines)


def _aligned(header, rows):
    """Return a table as text: the first column to the left, columns of numbers to the right."""
    cells = [header, *rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    right = [all(row[i][:1] in '-(0123456789.' for row in rows) and '..' not in
             ''.join(row[i] for row in rows) for i in range(len(header))]
    return '\n'.join('  '.join(
        f'{cell:>{width}}' if to_right else f'{cell:<{width}}'
        for cell, width, to_right in zip(row, widths, right, strict=True)).rstrip()
        for row in cells)


def _clipped(name):
    return name if len(name) <= _LONGEST_NAME else f'{name[:_LONGEST_NAME - 1]}…'


def _wrapped(text):
    return fill(text, _WIDTH, subsequent_indent='  ')


def write_identification_report(identification, folder, *, beside=None, robot=()) -> list:
    """
    Write report.html and the PNGs to a folder; return their paths, the page first.

    ``beside`` (RobotParams) is friction known otherwise, such as that of a simulated plant, drawn
    and listed as true; ``robot`` are the files of the robot that was believed.
    """
    folder, words = Path(folder), partial(in_units, identification.robot.arm)
    answer = identification_answer(identification, folder, robot)
    report = Report('Friction identification', answer, data_sentence(identification), words)
    worst = _worst(identification)
    _add_map(report, worst, _known_curves(worst, beside)[0])
    _add_summary(report, identification)
    for result in identification.joints:
        _add_joint(report, result, identification, beside, opened=result is worst)
    return [report.write(folder / 'report.html'), *_save_pictures(identification, folder, beside)]


def identification_answer(identification, folder, robot=()) -> Answer:
    """Return how far the friction found predicts (Answer); ``robot`` files were believed."""
    worst, folder = _worst(identification), Path(folder)
    errors, joint = worst.held_out, worst.joint
    numbers = [
        measured(f'torque error of {joint} [% of the drive torque]', errors.coulomb_viscous,
                 errors.relative, np.fmax(*floor_shares(errors)), scale=100.0),
        measured(f'error of free runs of {joint} [mrad]', errors.free_run_coulomb_viscous,
                 errors.free_run_rms, _reading(identification.robot.encoder, errors))]
    known = next((one for one in worst.estimates if standing(one) in _KNOWN), None)
    if known is not None:
        low, high = known.interval
        numbers.append(measured(f'{short_name(known.name, joint)} of {joint} [{known.unit}]', None,
                                known.value, 0.5 * (high - low), scale=1.0))
    files = robot or (('robot.yaml',) if identification.described else ())
    return Answer(_sentence(identification, worst),
                  ('Coulomb + viscous', 'identified', 'noise floor'), tuple(numbers), command(
                      'discrepancy', *identification.sources, '--robot', *files,
                      folder / 'friction.yaml', '--out', folder / 'gap'))


def _reading(encoder, errors):
    """Return what encoder steps make of a reading, if unknown the error a sample ahead [rad]."""
    known = encoder.counts > 0.0
    return 2.0 * np.pi / encoder.counts / np.sqrt(12.0) if known else errors.innovation_rms


def _worst(identification):
    """Return the joint whose torque is predicted worst."""
    return max(identification.joints, key=lambda result: np.nan_to_num(result.held_out.relative))


def _sentence(identification, worst):
    errors = worst.held_out
    standings = [standing(one) for result in identification.joints for one in result.estimates]
    found, fitted = (len(standings) - sum(map(standings.count, those)) for those in (
        (NOT_IDENTIFIABLE, DOUBTFUL, SET), (SET,)))
    known = (f'{found} of {fitted} parameters {"is" if found == 1 else "are"} identified'
             if found < fitted else
             f'all {fitted} parameters are identified')
    if not np.isfinite(errors.relative):
        return f'{known.capitalize()}, but no held-out data check them.'
    simple = ('no better than Coulomb + viscous friction alone' if errors.relative
              >= errors.coulomb_viscous else 'Coulomb + viscous friction alone to '
              + percent(errors.coulomb_viscous))
    return ('On motion left out of the fit, the identified friction predicts the torque of '
            f'{worst.joint}, the worst joint, to {percent(errors.relative)}, {simple}; {known}. '
            'The noise floor is what the readings alone, or the repeated motion, would leave.')


def _save_pictures(identification, folder, beside):
    """Yield the path of each picture for print, written."""
    words = partial(in_units, identification.robot.arm)
    for i, result in enumerate(identification.joints):
        stem = file_stem(result.joint)
        clash = any(file_stem(other.joint) == stem for other in identification.joints[:i])
        stem = f'{stem}_{i + 1}' if clash else stem
        steady, curve = _known_curves(result, beside)
        for name, figure in (('map', map_figure(result, steady)),
                             ('presliding', loops_figure(result, curve))):
            path = folder / f'{name}_{stem}.png'
            save_figure(figure, path, words)
            yield path


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
        rows.append((result.joint, *counts))
    report.table(('joint', *STANDINGS), rows, 'Parameters by how well they are known')
    report.table(*_held_out_rows(identification.joints),
                 'Errors on held-out data. Torque: of the rms of the drive torque; C+v: Coulomb '
                 '+ viscous alone; noise: that of the readings; repeat: of equal motions. Free '
                 'run: rms of the angle')
    for result in identification.joints:
        report.heading(result.joint, level=3)
        for text, warning in joint_sentences(result):
            (report.note(text, warning=True) if warning else report.text(text))


def _add_joint(report, result, identification, beside, *, opened):
    steady, curve = _known_curves(result, beside)
    known = known_values(beside, identification.robot, result.joint) if beside else None
    report.heading(result.joint)
    report.text('Friction torque taken from ' + (
        'the spring between motor and link.' if result.side == 'spring' else
        'the motor torque, with the motor inertia part of the link.'))
    _add_parameters(report, result, known)
    report.heading(f'{result.joint}: friction over velocity (Fig. 3)', level=3)
    if not opened:
        _add_map(report, result, steady)
    _add_map(report, result, steady, log=True)
    _add_presliding(report, result, curve)
    _add_motion(report, result)
    _add_candidates(report, result)


def _add_parameters(report, result, known):
    report.heading(f'{result.joint}: parameters', level=3)
    lost = [short_name(estimate.name, result.joint) for estimate in result.estimates
            if standing(estimate) == NOT_IDENTIFIABLE]
    if lost:
        report.note(f"NOT identifiable from these data: {', '.join(lost)}. Their values, in "
                    'brackets, are where the fit ended.', warning=True)
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


def _add_map(report, result, known, log=False):
    """Add friction over velocity, or that against the motion over the logarithm of speed."""
    measured, fit, curves = result.friction_map, result.steady_velocity, []
    for i, (sign, name, _) in enumerate(DIRECTIONS):
        way, turn = sign * measured.velocity > 0.0, sign if log else 1.0
        for steady, label, role in ((True, f'{name}, steady', f'c{i}'),
                                    (False, f'{name}, not steady', 'c6')):
            rows = way & (measured.steady == steady)
            curves.append(Curve(label, turn * measured.velocity[rows],
                                turn * measured.torque[rows], role, points=True))
        rows = sign * fit > 0.0
        curves += [Curve(f'{name}, {kind}', turn * fit[rows], turn * torque[rows], role,
                         dashed=torque is known)
                   for kind, torque, role in (('fitted', result.steady_torque, f'c{i + 3}'),
                                              ('true', known, 'reference'))
                   if torque is not None]
    title, x = (('friction against the motion', 'speed') if log else
                ('friction over velocity, measured and fitted', 'velocity'))
    report.xy_chart(f'{result.joint}: {title}', curves, f'{x} [rad/s]', 'friction torque [N m]',
                    log_x=log)


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
    report.xy_chart('hysteresis loops', loops, 'displacement [mrad]', 'friction torque [N m]')
    report.xy_chart('from rest', curves, 'displacement [mrad]', 'friction torque [N m]',
                    log_x=True)


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
            report.chart(f'{short_label(trace.label)}: {name}', time, lines,
                         y_label=f'{name} [{unit}]', group=group)
    velocity, residual, out = _residuals(result)
    report.xy_chart('residual over velocity', [
        Curve(name, velocity[rows], residual[rows], role, points=True)
        for name, rows, role in (('fitted', ~out, 'c5'), ('held out', out, 'c1'))],
        'velocity [rad/s]', 'measured − model [N m]')


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
        'The fit uses the fewest blocks that no other number beats by more than chance')


def _residuals(result):
    """Return velocity, measured less modelled torque and held_out of all traces, (T,) each."""
    if not result.traces:
        return np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)
    velocity, residual, out = (np.concatenate(columns) for columns in zip(*(
        (trace.velocity, trace.measured - trace.model, trace.held_out)
        for trace in result.traces), strict=True))
    good = np.isfinite(velocity) & np.isfinite(residual)
    return velocity[good], residual[good], out[good].astype(bool)
