# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Table 4 with its pictures and interactive charts, as files in one folder."""

import json
from pathlib import Path
import re

from gms_flex_control.analysis.tracking import link_error, table4
from gms_flex_control.files import write_text
from gms_flex_control.reports.figures import (
    compensation_index,
    compensation_name,
    error_figure,
    save_figure,
    tracking_figure,
    trajectory_name,
)
from gms_flex_control.reports.page import Report, Series
import numpy as np


def write_tracking_report(runs, folder, friction_true=None, title='Tracking report', *,
                          subtitle=None, beside=None):
    """
    Write table4.json, report.html and the PNGs of the paper's Figs. 6 to 10.

    Parameters
    ----------
    runs : sequence of Run
        Experiments of any trajectories, compensations and robots.
    folder : str or Path
        Made if need be; files of the same names are replaced.
    friction_true : mapping of int to ndarray (T, n), optional
        True friction [N m] of a simulated run, by its index in ``runs``.
    title, subtitle : str, optional
        Of the page.
    beside : mapping of str to sequence of Run, optional
        Further runs of which only the table is given, under their name; the key in
        table4.json is the name with '_' for blanks.

    Returns
    -------
    Table4
        The figures written to table4.json.

    """
    folder = Path(folder)
    table = table4(runs)
    others = {name: table4(some) for name, some in (beside or {}).items()}
    everything = table.as_dict() | {
        name.replace(' ', '_'): other.as_dict() for name, other in others.items()}
    write_text(folder / 'table4.json', json.dumps(everything, indent=2, allow_nan=False) + '\n')
    _save_pictures(runs, folder)
    report = Report(title, table.answer(), subtitle or (
        f'{len(runs)} recording{"s" if len(runs) != 1 else ""}: link angle against reference'))
    hardest = next(iter(table.hardest), None)
    _add_error_charts(report, runs, lambda place: place == hardest)
    add_table4(report, table)
    for name, other in others.items():
        report.heading(f'The same with the {name}', level=3)
        report.table(*other.rows())
    report.heading('Position errors')
    _add_error_charts(report, runs, lambda place: place != hardest)
    for i, run in enumerate(runs):
        add_run(report, run, (friction_true or {}).get(i))
    report.write(folder / 'report.html')
    return table


def add_table4(report, table):
    """Add both tables of a ``Table4`` to a ``Report``."""
    report.heading('Table 4')
    report.table(*table.rows(), caption='Mean square error, link angle − reference '
                 '[rad²], and ratio without / with')
    report.note(table.as_dict()['note'])
    for finding in table.findings():
        report.note(finding, warning=True)
    report.table(*table.detail_rows(), caption='Every run')
    return report


def add_run(report, run, friction_true=None):
    """
    Add the charts of one run: angle, error, torsion, torque and friction per joint.

    Parameters
    ----------
    report : Report
        Grows by a section.
    run : Run
        Quantities that were not recorded are left out.
    friction_true : ndarray, shape (T, n), optional
        Friction of the simulated plant [N m].

    """
    recording = run.recording
    group = f'{run.trajectory} {run.compensation} {recording.source}'
    report.heading(run_name(run))
    report.text(f'{recording.source}: {len(recording.time)} samples in '
                f'{recording.time[-1]:.6g} s, median period {1e3 * recording.period:.4g} ms.')
    for i, joint in enumerate(recording.joints):
        report.heading(joint, level=3)
        for name, unit, series in _joint_charts(recording, i, friction_true):
            shown = [item for item in series if np.isfinite(item.y).any()]
            if shown:
                report.chart(f'{joint}: {name}', recording.time, shown,
                             y_label=f'{name} [{unit}]', group=group)
    return report


def run_name(run):
    """Return the title of a run, for instance 'Sinusoid: without compensation'."""
    return f'{trajectory_name(run.trajectory)}: {compensation_name(run.compensation)}'


def _joint_charts(recording, i, friction_true):
    yield 'angle', 'rad', [
        Series('link', recording.q_link[:, i], role='c0'),
        Series('motor', recording.q_motor[:, i], role='c4', hidden=True),
        Series('reference', recording.reference[:, 0, i], role='reference', dashed=True)]
    yield 'torsion', 'mrad', [
        Series('motor − link', 1e3 * (recording.q_motor - recording.q_link)[:, i], role='c4')]
    yield 'torque', 'N m', [
        Series('applied', recording.tau_motor[:, i], role='c0'),
        Series('command', recording.command[:, i], role='c1', dashed=True)]
    truth = np.full(len(recording.time), np.nan) if friction_true is None else friction_true[:, i]
    yield 'friction', 'N m', [
        Series('estimate', recording.friction_hat[:, i], role='c2'),
        Series('true', truth, role='reference', dashed=True)]


def _add_error_charts(report, runs, wanted):
    """Overlay the errors of all runs of each (trajectory, joint) that is wanted."""
    drawn = [run for run in runs if np.isfinite(link_error(run.recording)).any()]
    for trajectory in dict.fromkeys(run.trajectory for run in drawn):
        chosen = [run for run in drawn if run.trajectory == trajectory]
        for joint in dict.fromkeys(name for run in chosen for name in run.recording.joints):
            if not wanted((trajectory, joint)):
                continue
            series = [_error_series(run, joint) for run in chosen
                      if joint in run.recording.joints]
            report.chart(f'{trajectory_name(trajectory)}, {joint}: link angle - reference',
                         series[0].x, series, y_label='error [mrad]',
                         group=f'errors {trajectory}')


def _error_series(run, joint):
    recording = run.recording
    error = link_error(recording)[:, recording.joints.index(joint)]
    return Series(run.compensation, 1e3 * error, x=recording.time,
                  role=f'c{compensation_index(run.compensation)}')


def _save_pictures(runs, folder):
    """Write the pictures for print."""
    drawn = [run for run in runs if np.isfinite(link_error(run.recording)).any()]
    taken = set()
    for run in drawn:
        save_figure(tracking_figure(run),
                    _free(folder, f'tracking_{run.trajectory}_{run.compensation}', taken))
    for trajectory in dict.fromkeys(run.trajectory for run in drawn):
        save_figure(error_figure(drawn, trajectory), _free(folder, f'errors_{trajectory}', taken))


def _free(folder, stem, taken):
    """Return a path safe as a file name and not taken, and take it."""
    stem = re.sub(r'[^A-Za-z0-9._-]+', '_', stem).strip('_')
    path, count = folder / f'{stem}.png', 1
    while path in taken:
        count += 1
        path = folder / f'{stem}_{count}.png'
    taken.add(path)
    return path
