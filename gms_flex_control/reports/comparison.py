# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The page of a comparison of friction compensations."""

from functools import partial

from gms_flex_control.comparison import study, words
from gms_flex_control.comparison.contestants import Condition, conditions, CONTESTANTS, NOMINAL
from gms_flex_control.experiment.believed import FRICTION, MASS, STIFFNESS
from gms_flex_control.params.units import in_units
from gms_flex_control.reports.page import Curve, Report, Series
import numpy as np

_MIXED = 'friction, K and M off together'


def plant_page(rows, outcomes, setting, source):
    """
    Return the page of a comparison in simulation.

    Parameters
    ----------
    rows : list of Row
        From study.table.
    outcomes : dict of str to dict
        Of the cells by their keys.
    setting : Setting
        Of the comparison.
    source : sequence of str
        The robot files, none for the arm of the paper.

    Returns
    -------
    Report

    """
    robot, answer = setting.robot, words.plant_answer(rows, outcomes, source)
    page = Report('Friction compensations compared', answer,
                  f'{", ".join(source) or "the arm of the paper"}, {setting.rate:g} Hz, sinusoid '
                  f'and polynomial of {setting.amplitude[0]:g} rad, simulated',
                  partial(in_units, robot.arm))
    *traces, (motion, joint, series, time) = _traces(setting, _named(NOMINAL))
    page.chart(f'{motion}, {joint}: link angle - reference', time, [
        one._replace(hidden=one.label not in ('none', answer.columns[1])) for one in series],
        y_label='error [mrad]')
    page.heading('All in one table').table(
        words.header(rows), [words.cells_of(row) for row in rows])
    page.text(' '.join(words.NOTE.split()) + '.')
    page.heading('Plant as believed').table(
        ['compensation', *(f'{motion}, {joint}' for motion in rows[0].mse
                           for joint in robot.joints),
         *(f'at rest, {joint} [mrad]' for joint in robot.joints)],
        [[row.name, *(words.plain(value) for motion in row.mse.values()
                      for value in motion or [None] * robot.n_joints),
          *(words.milli(value) for value in row.hold or [None] * robot.n_joints)]
         for row in rows], caption='Mean square error [rad^2] and motion at rest')
    page.heading('One thing different at a time').table(
        ['condition', *CONTESTANTS.values()],
        [[one.name, *(words.milli(study.error_of(outcomes[f'{mode} | {one.name}']))
                      for mode in CONTESTANTS)] for one in conditions(0)],
        caption='rms error of all joints and both motions [mrad]')
    if rows[0].drawn:
        page.heading('Robots drawn at random').xy_chart(
            'error of all drawn robots, the best first', [_ranked(row) for row in rows],
            'share of robots', 'rms error [mrad]', log_x=False)
    for title, shown in (('Error over time, plant as believed', traces),
                         (f'Error over time, {_MIXED}', _traces(setting, mixed()))):
        page.heading(title)
        for motion, joint, series, time in shown:
            page.chart(f'{motion}, {joint}', time, series, y_label='error [mrad]',
                       group=f'{motion} {title}')
    page.note(f'{_MIXED}: friction {1 / FRICTION:.3g}, K {1 / STIFFNESS:.3g} and M '
              f'{1 / MASS:.3g} times what the controller believes, as in docs/model.md.')
    return page


def mixed():
    """Return the Condition of docs/model.md in which friction, K and M are off together."""
    return Condition('mixed', 'mixed', friction=1 / FRICTION, stiffness=1 / STIFFNESS,
                     mass=1 / MASS)


def _named(name):
    return next(one for one in conditions(0) if one.name == name)


def _role(mode):
    """Return the colour of a compensation, the same in every chart."""
    return ('reference', *(f'c{k}' for k in range(7)))[list(CONTESTANTS).index(mode)]


def _ranked(row):
    known = sorted(value for value in row.drawn if value is not None)
    return Curve(row.name, (np.arange(len(known)) + 0.5) / max(len(row.drawn), 1),
                 1e3 * np.array(known), role=_role(row.mode), hidden=row.mode == 'none')


def _traces(setting, condition):
    """Yield motion, joint, Series of all compensations and time."""
    found = {}
    for mode in CONTESTANTS:
        for motion, _, run in study.runs_of(study.Cell(setting, mode, condition)):
            found.setdefault(motion, {})[mode] = run
    for motion, runs in found.items():
        for j, joint in enumerate(setting.robot.joints):
            series = [Series(CONTESTANTS[mode],
                             1e3 * (run.true[:, 0, j] - run.reference[:, 0, j]),
                             role=_role(mode), hidden=mode in ('none', 'stribeck', 'lugre'))
                      for mode, run in runs.items()]
            yield motion, joint, series, runs['none'].time


def bag_page(predictions, found, robot, source, share, files=()):
    """
    Return the page of a comparison along a bag.

    Parameters
    ----------
    predictions : list of Prediction
        From held_out.compare_along.
    found : Along
        The recording.
    robot : RobotParams
        As believed.
    source : str
        The bag.
    share : float
        Of it that was fitted.
    files : sequence of str
        Of the robot, if not the arm of the paper.

    Returns
    -------
    Report

    """
    joints = robot.joints
    answer = words.bag_answer(predictions, joints, source, files)
    page = Report('Friction torque along a recording', answer, f'{source}: the first '
                  f'{100 * share:.0f} % fitted, the rest judged', partial(in_units, robot.arm))
    (title, time, lines, _), *others = _torques(predictions, found, joints)
    page.chart(f'{title}: friction torque', time, [
        one._replace(hidden=one.label not in ('measured', answer.columns[1])) for one in lines],
        y_label='friction torque [N m]')
    page.heading('Errors').table(*words.bag_rows(predictions, joints),
                                 caption='rms error of the friction torque [mN m]')
    page.text('Measured is what the link equation lacks, behind the same low-pass as the '
              'predictions. One that sees the torque, or adapts to it, predicts nothing.')
    if others:
        page.heading('Torque over time')
    for title, time, lines, group in others:
        page.chart(title, time, lines, y_label='friction torque [N m]', group=group)
    return page


def _torques(predictions, found, joints):
    """Yield title, time, Series of measurement and predictions, and group of each chart."""
    for k, piece in enumerate(found.pieces):
        name = f', piece {k + 1}' if len(found.pieces) > 1 else ''
        for j, joint in enumerate(joints):
            lines = [Series('measured', piece.friction[:, j], role='reference')]
            lines += [Series(one.name, one.torque[k][:, j], role=_role(one.mode),
                             hidden=one.mode in ('stribeck', 'disturbance_observer'))
                      for one in predictions if one.torque and one.mode != 'none']
            yield f'{joint}{name}', piece.time, lines, f'piece {k}'
