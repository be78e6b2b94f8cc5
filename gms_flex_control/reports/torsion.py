# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A torsion study as text and as a page."""

from pathlib import Path

from gms_flex_control.analysis.torsion import rms
from gms_flex_control.answer import Answer, command, measured
from gms_flex_control.reports.page import Report, Series
import numpy as np


def text(study):
    """Return a TorsionStudy as lines of text."""
    measured, error = study.torque_error
    torsion, first = rms(study.torsion), study.explanations[0]
    header, rows = explanation_rows(study)
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    table = ['  '.join(f'{cell:<{w}}' if i == 0 else f'{cell:>{w}}'
                       for i, (cell, w) in enumerate(zip(row, widths, strict=True)))
             for row in [header, *rows]]
    return '\n'.join([
        f'{study.source}, {study.joint}: {len(study.time)} samples, '
        f'{int(study.moving.sum())} of them moving',
        f'inertia M + J {study.inertia:.5g} kg m^2, J taken as {study.motor_inertia:.5g}; '
        f'Coulomb {study.coulomb[0]:.4g} / {study.coulomb[1]:.4g} N m forward / backward, '
        f'viscous {study.viscous:.4g} N m s/rad',
        f'motor torque: rms measured {measured:.4g} N m, rms error {error:.4g} N m, relative '
        f'error {error / measured:.3f}',
        f'torsion: rms measured {1e3 * np.degrees(torsion):.4g} mdeg, rms error '
        f'{1e3 * np.degrees(first.rms_error):.4g} mdeg, relative error '
        f'{first.relative_error:.3f} (mean of {1e3 * np.degrees(study.torsion_offset):.4g} mdeg '
        'taken off)', '', *table, '', verdict(study)])


def explanation_rows(study):
    """Return header and rows of the table of explanations."""
    header = ('torsion explained by', 'stiffness [N m/rad]', 'delay [ms]', 'rms error [mdeg]',
              'relative error')
    return header, [
        (e.name, f'{e.stiffness:.4g}' if np.isfinite(e.stiffness) else '-',
         f'{1e3 * e.delay:.3f}', f'{1e3 * np.degrees(e.rms_error):.3f}',
         f'{e.relative_error:.3f}') for e in study.explanations]


def verdict(study):
    """Return in a sentence or two what the torsion shows."""
    spring, delay, both, free = study.explanations
    lines = []
    if delay.relative_error < spring.relative_error:
        lines.append(f'A delay of {1e3 * delay.delay:.2f} ms between the encoders explains the '
                     'torsion better than the spring does: it is not flexibility.')
    if both.relative_error >= delay.relative_error:
        lines.append('With the delay, the given spring does not improve the model: these data do '
                     'not confirm its stiffness.')
    if free.stiffness < 0:
        lines.append('With the delay, the best spring has negative stiffness: what remains is '
                     'not the torsion of a spring.')
    return ' '.join(lines) or 'The given spring explains the torsion better than a delay does.'


def torsion_answer(study, folder) -> Answer:
    """Return what the torsion shows, robot.yaml of the study being in ``folder`` (Answer)."""
    *told, free = study.explanations
    return Answer(
        f'{verdict(study)} The floor is what spring and delay together leave, both free.',
        ('measured', 'left', 'floor'), tuple(
            measured(f'{one.name} [mdeg]', *np.degrees((rms(study.torsion), one.rms_error,
                                                        free.rms_error))) for one in told),
        command('discrepancy', study.source, '--robot', Path(folder) / 'robot.yaml', '--out',
                Path(folder) / 'gap'))


def write_torsion_report(study, folder):
    """
    Write report.html.

    Parameters
    ----------
    study : TorsionStudy
        What to show.
    folder : str or Path
        Made if need be; files of the same names are replaced.

    Returns
    -------
    Path
        The page.

    """
    folder = Path(folder)
    report = Report(f'Torsion of {study.joint}', torsion_answer(study, folder),
                    f'{study.source}: flexible joint of a decoupled axis, measured and modelled')
    group = f'torsion {study.source}'
    report.chart(
        'torsion: motor - link, without its mean', study.time, [
            Series('measured', _mdeg(study.torsion), role='c0'),
            Series('spring torque / stiffness', _mdeg(study.torsion_model), role='reference',
                   dashed=True),
            Series('delay between the encoders', _mdeg(_delayed(study)), role='c2')],
        y_label='torsion [mdeg]', group=group)
    report.heading('Motor torque').chart(
        'torque', study.time, [
            Series('measured', study.torque, role='c0'),
            Series('inertia and friction', study.torque_model, role='reference', dashed=True),
            Series('error', study.torque - study.torque_model, role='c1', hidden=True)],
        y_label='torque [N m]', group=group)
    report.table(*explanation_rows(study), caption='What explains the torsion')
    return report.write(folder / 'report.html')


def _mdeg(values):
    return 1e3 * np.degrees(values)


def _delayed(study):
    return study.explanations[1].delay * (study.velocity - study.velocity.mean())
