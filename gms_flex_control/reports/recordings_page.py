# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What recordings show without a fit: Table 4 with the paper's Figs. 6 to 10."""

from pathlib import Path

from gms_flex_control.comparison.tracking import link_error, PAPER_WITHOUT, Table4, table4
from gms_flex_control.file_io import write_json, written_together
from gms_flex_control.reports import figure_style
from gms_flex_control.reports.figure_style import free_path
from gms_flex_control.reports.page import Report, Series
from matplotlib.figure import Figure
import numpy as np

NAMES = {'none': 'without compensation', 'gms_paper': "with the paper's observer (gms_paper)",
         'gms': 'with the improved observer (gms)', 'stribeck': 'with a static Stribeck curve',
         'lugre': 'with a LuGre model', 'gms_desired': 'with GMS of the desired motion',
         'gms_adaptive': 'with adaptive GMS',
         'disturbance_observer': 'with a disturbance observer'}
_LOOKS = {'none': (1, '-'), 'gms_paper': (2, '-.'), 'gms': (0, '-')}  # colour and line style


@written_together()
def write_tracking_report(runs, folder, title='Tracking report', *, subtitle=None, beside=None
                          ) -> Table4:
    """
    Write table4.json, report.html and the PNGs of runs (Run) to a folder; return the Table4.

    ``beside`` are further runs of which only the table is given, under their name.
    """
    folder = Path(folder)
    table = table4(runs)
    others = {name: table4(some) for name, some in (beside or {}).items()}
    everything = table.as_dict() | {
        name.replace(' ', '_'): other.as_dict() for name, other in others.items()}
    write_json(folder / 'table4.json', everything)
    _save_pictures(runs, folder)
    report = Report(title, table.answer(), subtitle or (
        f'{len(runs)} recording{"s" if len(runs) != 1 else ""}: link angle against reference'))
    hardest = next(iter(table.hardest), None)
    _add_error_charts(report, runs, lambda place: place == hardest)
    report.heading('Table 4')
    report.table(*table.rows(), caption='Mean square error, link angle − reference '
                 '[rad²], and ratio without / with')
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
        Series('link', recording.q_link[:, i], role='c0'),
        Series('motor', recording.q_motor[:, i], role='c4', hidden=True),
        Series('reference', recording.reference[:, 0, i], role='reference', dashed=True)]
    yield 'torsion', 'mrad', [
        Series('motor − link', 1e3 * (recording.q_motor - recording.q_link)[:, i], role='c4')]
    yield 'torque', 'N m', [
        Series('applied', recording.tau_motor[:, i], role='c0'),
        Series('command', recording.command[:, i], role='c1', dashed=True)]
    yield 'friction', 'N m', [Series('estimate', recording.friction_hat[:, i], role='c2')]


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
            series = [Series(run.compensation, _error(run, joint), x=run.recording.time,
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


def _save_pictures(runs, folder):
    used = set()
    for trajectory, drawn in _by_trajectory(runs):
        for run in drawn:
            name = f'tracking_{run.trajectory}_{run.compensation}'
            figure_style.save_figure(tracking_figure(run), free_path(folder, name, used))
        figure_style.save_figure(error_figure(drawn, trajectory),
                                 free_path(folder, f'errors_{trajectory}', used))
