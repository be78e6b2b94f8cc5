# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The page of an identification: what can be trusted, shown in pictures and tables."""

from pathlib import Path

from gms_flex_control.identification import outcome
from gms_flex_control.reports.answers import held_out_rows, identification_answer, worst_joint
from gms_flex_control.reports.figure_style import free_path, save_figure
from gms_flex_control.reports.page import decimate, Report, Series
from gms_flex_control.reports.pictures import loops_figure, map_figure
import numpy as np

MOST_TRACES = 6          # of one joint on the page
_TRACE_POINTS = 20_000   # of one line of a trace; longer ones are written as extremes
_SYMBOLS = {'static': 'F_s', 'coulomb': 'F_c', 'velocity': 'v_s', 'viscous': 'σ_2',
            'attraction': 'C', 'motor_inertia': 'J'}
_BLOCK_SYMBOLS = {'stiffness': 'k', 'weight': 'α'}


def write_identification_report(identification, folder, *, robot=()) -> list:
    """
    Write report.html and the PNGs to a folder; return their paths, the page first.

    ``robot`` are the files of the robot that was believed.
    """
    folder, words = Path(folder), identification.in_units
    answer = identification_answer(identification, folder, robot)
    report = Report('Friction identification', answer, outcome.data_sentence(identification),
                    words)
    worst, paths, used = worst_joint(identification), [], set()
    shown = [(map_figure(result), loops_figure(result)) for result in identification.joints]
    for figures, result in zip(shown, identification.joints, strict=True):
        for name, figure in zip(('map', 'presliding'), figures, strict=True):
            paths.append(free_path(folder, f'{name}_{result.joint}', used))
            save_figure(figure, paths[-1], words)
    _add_map(report, worst, shown[identification.joints.index(worst)][0])
    _add_summary(report, identification)
    for result, (friction_map, loops) in zip(identification.joints, shown, strict=True):
        _add_joint(report, result, None if result is worst else friction_map, loops)
    return [report.write(folder / 'report.html'), *paths]


def _add_map(report, result, figure):
    report.figure(figure, f'{result.joint}: friction over velocity, measured and fitted')


def _add_summary(report, identification):
    report.heading('Summary')
    report.text(f'Fitted in {identification.seconds:.1f} s.')
    for text in identification.warnings:
        report.note(text, warning=True)
    rows = []
    for result in identification.joints:
        counts = [sum(outcome.standing(estimate) == kind for estimate in result.estimates)
                  for kind in outcome.STANDINGS]
        rows.append((result.joint, *counts))
    report.table(('joint', *outcome.STANDINGS), rows, 'Parameters by how well they are known')
    report.table(*held_out_rows(identification.joints),
                 'Errors on held-out data. Torque: of the rms of the drive torque; C+v: Coulomb '
                 '+ viscous alone; noise: that of the readings; repeat: of equal motions. Free '
                 'run: rms of the angle')
    for result in identification.joints:
        report.heading(result.joint, level=3)
        for text, warning in outcome.joint_sentences(result):
            (report.note(text, warning=True) if warning else report.text(text))


def _add_joint(report, result, friction_map, loops):
    """Add a joint; ``friction_map`` is None where the page begins with it."""
    report.heading(result.joint)
    report.text('Friction torque taken from ' + (
        'the spring between motor and link.' if result.side == 'spring' else
        'the motor torque, with the motor inertia part of the link.'))
    _add_parameters(report, result)
    if friction_map is not None:
        report.heading(f'{result.joint}: friction over velocity (Fig. 3)', level=3)
        _add_map(report, result, friction_map)
    report.heading(f'{result.joint}: presliding (Fig. 4)', level=3)
    if not len(result.curve[0]):
        report.note('No stiffness is identifiable from these data: no curve from rest is drawn.')
    if not result.loops:
        report.note('The data hold no presliding motion' + (
            ': the curve rests on reversals alone.' if len(result.curve[0]) else '.'))
    report.figure(loops, f'{result.joint}: hysteresis loops, and from rest')
    _add_motion(report, result)
    _add_candidates(report, result)


def _add_parameters(report, result):
    report.heading(f'{result.joint}: parameters', level=3)
    lost = [outcome.short_name(estimate.name, result.joint) for estimate in result.estimates
            if outcome.standing(estimate) == outcome.NOT_IDENTIFIABLE]
    if lost:
        report.note(f"NOT identifiable from these data: {', '.join(lost)}. Their values, in "
                    'brackets, are where the fit ended.', warning=True)
    rows = []
    for estimate in result.estimates:
        kind = outcome.standing(estimate)
        value = outcome.number(estimate.value, 5)
        words = ', '.join(estimate.flags) or kind
        rows.append((outcome.short_name(estimate.name, result.joint), _symbol(estimate.name),
                     f'({value})' if kind == outcome.NOT_IDENTIFIABLE else value,
                     estimate.unit, words.upper() if kind == outcome.NOT_IDENTIFIABLE else words,
                     outcome.span(estimate.interval)))
    report.table(('parameter', 'symbol', 'estimate', 'unit', 'standing', '95 % interval'), rows,
                 'Estimates as in friction.yaml')
    for note in outcome.notes(result):
        report.note(note)


def _symbol(name):
    """Return the paper's symbol of a parameter; its blocks count from 1."""
    leaf, _, index = name.split('.')[-1].partition('[')
    if index:
        return f'{_BLOCK_SYMBOLS.get(leaf, leaf)}_{int(index.rstrip("]")) + 1}'
    if leaf == 'stiffness':
        return 'K'
    return _SYMBOLS.get(leaf, '')


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
            report.chart(f'{outcome.short_label(trace.label)}: {name}', time, lines,
                         y_label=f'{name} [{unit}]', group=group)


def _add_candidates(report, result):
    if not result.candidates:
        return
    report.heading(f'{result.joint}: numbers of blocks tried', level=3)
    best = min(candidate.cost for candidate in result.candidates)
    report.table(('blocks N', '', 'held-out cost per sample', 'above the best',
                  'standard error of that'), [
        (candidate.n_blocks, 'chosen' if candidate.chosen else '', *(
            outcome.number(value, digits) for value, digits in (
                (candidate.cost, 6), (candidate.cost - best, 3), (candidate.error, 3))))
        for candidate in result.candidates],
        'The fit uses the fewest blocks that no other number beats by more than chance')
