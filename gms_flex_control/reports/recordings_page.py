# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Reports on recordings: Table 4 with the paper's Figs. 6 to 10, and what was identified."""

from pathlib import Path

from gms_flex_control.file_io import write_json, written_together
from gms_flex_control.identification import outcome
from gms_flex_control.reports import figure_style
from gms_flex_control.reports.answers import held_out_rows, identification_answer, worst_joint
from gms_flex_control.reports.figure_style import free_path, save_figure
from gms_flex_control.reports.page import ChartSeries, decimate, Report
from gms_flex_control.reports.pictures import loops_figure, map_figure
from gms_flex_control.tuning.tracking import link_error, PAPER_WITHOUT, Table4, table4
from matplotlib.figure import Figure
import numpy as np

NAMES = {'none': 'without compensation', 'gms_paper': "with the paper's observer (gms_paper)",
         'gms': 'with the improved observer (gms)', 'stribeck': 'with a static Stribeck curve',
         'lugre': 'with a LuGre model', 'gms_desired': 'with GMS of the desired motion',
         'gms_adaptive': 'with adaptive GMS',
         'disturbance_observer': 'with a disturbance observer'}
_LOOKS = {'none': (1, '-'), 'gms_paper': (2, '-.'), 'gms': (0, '-')}  # colour and line style


@written_together()
def write_tracking_report(runs, folder, title='Tracking report', *, subtitle=None, beside=None,
                          words=str) -> Table4:
    """
    Write table4.json, report.html, PNGs of runs, ``beside`` others by name; return Table4.

    ``words`` changes the units of texts.
    """
    folder = Path(folder)
    table = table4(runs)
    others = {name: table4(some) for name, some in (beside or {}).items()}
    everything = table_values(table, words) | {
        name.replace(' ', '_'): table_values(other, words) for name, other in others.items()}
    write_json(folder / 'table4.json', everything)
    _save_pictures(runs, folder, words)
    report = Report(title, table.answer(), subtitle or (
        f'{len(runs)} recording{"s" if len(runs) != 1 else ""}: link angle against reference'),
                    words)
    hardest = next(iter(table.hardest), None)
    _add_error_charts(report, runs, lambda place: place == hardest)
    report.heading('Table 4')
    report.table(*table.rows(), caption='Mean square error, link angle − reference '
                 '[rad^2], and ratio without / with')
    report.note(table.as_dict()['note'])
    for finding in table.findings():
        report.note(finding, warning=True)
    report.table(*table.detail_rows(), caption='Every run')
    for name, other in others.items():
        report.heading(f'The same with the {name}', level=3)
        report.table(*other.rows())
    report.heading('Position errors')
    _add_error_charts(report, runs, lambda place: place != hardest)
    for run in runs:
        _add_run(report, run)
    report.write(folder / 'report.html')
    return table


def table_values(table, words) -> dict:
    """Return a Table4 as plain values, in the units of ``words``."""
    values = table.as_dict()
    return values | {'unit': words(values['unit'])}


def _add_run(report, run):
    """Add angle, torsion, torque and friction of each joint, so far as they were recorded."""
    recording = run.recording
    report.heading(_title(run))
    report.text(f'{recording.source}: {len(recording.time)} samples in '
                f'{recording.time[-1]:.6g} s, median period {1e3 * recording.period:.4g} ms.')
    for i, joint in enumerate(recording.joints):
        report.heading(joint, level=3)
        for name, unit, series in _joint_charts(recording, i):
            report.chart(f'{joint}: {name}', recording.time, series, y_label=f'{name} [{unit}]',
                         group=f'{run.trajectory} {run.compensation} {recording.source}')


def _joint_charts(recording, i):
    yield 'angle', 'rad', [
        ChartSeries('link', recording.q_link[:, i], role='c0'),
        ChartSeries('motor', recording.q_motor[:, i], role='c4', hidden=True),
        ChartSeries('reference', recording.reference[:, 0, i], role='reference', dashed=True)]
    yield 'torsion', 'mrad', [
        ChartSeries('motor − link', 1e3 * (recording.q_motor - recording.q_link)[:, i],
                    role='c4')]
    yield 'torque', 'N m', [
        ChartSeries('applied', recording.tau_motor[:, i], role='c0'),
        ChartSeries('command', recording.command[:, i], role='c1', dashed=True)]
    yield 'friction', 'N m', [ChartSeries('estimate', recording.friction_hat[:, i], role='c2')]


def _by_trajectory(runs):
    drawn = [run for run in runs if np.isfinite(link_error(run.recording)).any()]
    for trajectory in dict.fromkeys(run.trajectory for run in drawn):
        yield trajectory, [run for run in drawn if run.trajectory == trajectory]


def _joints(runs):
    return list(dict.fromkeys(name for run in runs for name in run.recording.joints))


def _error(run, joint):
    return 1e3 * link_error(run.recording)[:, run.recording.joints.index(joint)]


def _add_error_charts(report, runs, wanted):
    """Overlay the errors of all runs of each (trajectory, joint) that is wanted."""
    for trajectory, chosen in _by_trajectory(runs):
        for joint in _joints(chosen):
            if not wanted((trajectory, joint)):
                continue
            series = [ChartSeries(run.compensation, _error(run, joint), x=run.recording.time,
                                  role=f'c{_look(run)[0]}')
                      for run in chosen if joint in run.recording.joints]
            report.chart(f'{_capital(trajectory)}, {joint}: link angle - reference',
                         series[0].x, series, y_label='error [mrad]',
                         group=f'errors {trajectory}')


def tracking_figure(run) -> Figure:
    """Return reference and measured link angle of a Run, a panel per joint (Figs. 6 to 9)."""
    recording = run.recording
    figure, panels = figure_style.stacked_panels(recording.n_joints)
    keep = figure_style.thinned(len(recording.time))
    for i, panel in enumerate(panels):
        panel.plot(recording.time[keep], recording.q_link[keep, i], color=figure_style.COLOURS[0],
                   label='measured')
        panel.plot(recording.time[keep], recording.reference[keep, 0, i], 'k--', linewidth=1.0,
                   label='reference')
        panel.set_ylabel(f'{recording.joints[i]} [rad]', parse_math=False)
    panels[0].legend(loc='upper right', ncols=2)
    return figure_style.finished(figure, panels, _title(run))


def error_figure(runs, trajectory) -> Figure:
    """Return the errors of all runs of one trajectory, a panel per joint [mrad] (Fig. 10)."""
    chosen = [run for run in runs if run.trajectory == trajectory]
    joints = _joints(chosen)
    figure, panels = figure_style.stacked_panels(len(joints))
    for panel, joint in zip(panels, joints, strict=True):
        panel.axhline(0.0, color='0.6', linewidth=0.6)
        for run in chosen:
            if joint in run.recording.joints:
                colour, style = _look(run)
                keep = figure_style.thinned(len(run.recording.time))
                panel.plot(run.recording.time[keep], _error(run, joint)[keep], style,
                           color=figure_style.COLOURS[colour], label=_name(run))
        panel.set_ylabel(f'{joint} [mrad]', parse_math=False)
    panels[0].legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure_style.finished(figure, panels, f'{_capital(trajectory)}: position error')


def _look(run):
    """Return colour and style of a compensation, the same in every picture and chart."""
    return _LOOKS.get(run.compensation, (3, figure_style.STYLES[1]))


def _name(run):
    return NAMES.get(run.compensation, run.compensation)


def _capital(trajectory):
    """Return the paper's trajectories as titles; others keep their names."""
    return trajectory.capitalize() if trajectory in PAPER_WITHOUT else trajectory


def _title(run):
    return f'{_capital(run.trajectory)}: {_name(run)}'


def _save_pictures(runs, folder, words):
    used = set()
    for trajectory, drawn in _by_trajectory(runs):
        for run in drawn:
            name = f'tracking_{run.trajectory}_{run.compensation}'
            figure_style.save_figure(tracking_figure(run), free_path(folder, name, used), words)
        figure_style.save_figure(error_figure(drawn, trajectory),
                                 free_path(folder, f'errors_{trajectory}', used), words)


MOST_TRACES = 6          # of one joint on the page
_TRACE_POINTS = 20_000   # of one line of a trace; longer ones are written as extremes
_SYMBOLS = {'static': 'F_s', 'coulomb': 'F_c', 'velocity': 'v_s', 'viscous': 'σ_2',
            'attraction': 'C', 'motor_inertia': 'J'}
_BLOCK_SYMBOLS = {'stiffness': 'k', 'weight': 'α'}


def write_identification_report(identification, folder, *, robot=()) -> list:
    """Write report.html and PNGs; return their paths, the page first; ``robot`` are its files."""
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
    if identification.others.estimates:
        report.heading('Other joints')
        _add_parameters(report, identification.others)
    return [report.write(folder / 'report.html'), *paths]


def _add_map(report, result, figure):
    report.figure(figure, f'{result.joint}: friction over velocity, measured and fitted')


def _add_summary(report, identification):
    report.heading('Summary')
    report.text(f'Fitted in {identification.seconds:.1f} s.')
    for text in identification.warnings:
        report.note(text, warning=True)
    rows = []
    for result in identification.joints_and_others:
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
                    ChartSeries('measured', measured, role='c5'),
                    ChartSeries('model', model, role='reference'),
                    ChartSeries('model, held out', held, role='c1')]),
                ('residual', 'N m', [ChartSeries('measured − model', residual, role='c1')]),
                ('velocity', 'rad/s', [ChartSeries('link', velocity, role='c2')])):
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
