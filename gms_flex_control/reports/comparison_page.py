# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A comparison of friction compensations: table, answer and page."""

from functools import partial

from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.comparison import study
from gms_flex_control.comparison.study import conditions, CONTESTANTS, NOMINAL
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports.page import Curve, Report, Series
import numpy as np

_GROUPS = {'friction': 'F+-30%', 'K': 'K+-20%', 'M': 'M+-30%', '4096 counts': '4k', '16384 counts':
           '16k', '65536 counts': '65k', '200 Hz': '200Hz', '1000 Hz': '1kHz'}
_NOTE = ('rms error of all joints and both motions [mrad], the plant as believed, then with one '
         'thing different at a\ntime (the worse of both signs), then of robots drawn with all '
         'of friction, K and M off (median, worst);\nlargest motion at rest [mrad] of the plant '
         'as believed and of all drawn; rms torque [N m] and rms of its\nrate [N m/s] of the '
         'plant as believed')


def _milli(value, scale=1e3):
    """Return a figure in thousandths as text, 'lost' for None."""
    return 'lost' if value is None else f'{scale * value:.3g}'


def _median(values):
    """Return the median of a list; None where most are None."""
    known = [np.inf if value is None else value for value in values]
    found = float(np.median(known)) if known else None
    return found if found is None or np.isfinite(found) else None


def _header(rows):
    """Return the column titles of `_cells`."""
    drawn, rest = (['drawn', 'worst'], ['drawn']) if rows[0].drawn else ([], [])
    return ['compensation', 'error', *(_GROUPS[group] for group in _GROUPS), *drawn,
            'at rest', *rest, 'torque', 'rate']


def _cells(row):
    """Return one Row as cells of text; units as in `_NOTE`."""
    drawn, rest = [], []
    if row.drawn:
        drawn = [_milli(_median(row.drawn)),
                 _milli(None if None in row.drawn else max(row.drawn))]
        rest = [_milli(row.drawn_hold)]
    return [row.name, _milli(row.errors['nominal']),
            *(_milli(row.errors[group]) for group in _GROUPS), *drawn,
            _milli(None if row.hold is None else max(row.hold)), *rest, _milli(row.torque, 1.0),
            _milli(row.rate, 1.0)]


def plant_text(rows) -> str:
    """Return the whole table with a note, str."""
    return f'{align(_header(rows), [_cells(row) for row in rows])}\n{_NOTE}'


def _bag_rows(predictions, joints):
    """Return header and rows of predictions along a bag, cells of text [mN m]."""
    titles = ['compensation', *(f'{joint} held out' for joint in joints),
              *(f'{joint} fitted' for joint in joints), 'remark']
    nothing = ['-'] * len(joints)
    return titles, [[
        one.name, *(nothing if one.error is None else map(_milli, one.error)),
        *(nothing if one.fitted is None else map(_milli, one.fitted)), one.remark]
        for one in predictions]


def bag_text(predictions, found, joints) -> str:
    """Return the table of predictions along a bag with a note, str."""
    rms = np.sqrt(np.mean(np.concatenate([one.friction for one in found.pieces]) ** 2, axis=0))
    size = ', '.join(f'{joint} {1e3 * value:.3g}'
                     for joint, value in zip(joints, rms, strict=True))
    return (f'{align(*_bag_rows(predictions, joints))}\nrms error of the predicted friction '
            f'torque [mN m]; the measured one is {size}')


def plant_answer(rows, outcomes, files=()) -> Answer:
    """Return which compensation errs least in simulation (Answer); ``files`` of the robot."""
    floor = study.floor_of(outcomes)
    left = study.error_of(floor)
    rest = None if left is None else max(floor['polynomial']['hold'])
    best = min(rows, key=lambda row: _least(row.errors[NOMINAL]))
    none = next(row for row in rows if row.mode == 'none')
    steadiest = min(rows, key=lambda row: _least(_median(row.drawn)))
    also = ('' if not best.drawn else ' and on robots drawn at random' if steadiest is best
            else f', on robots drawn at random that of "{steadiest.name}"')
    worst = [max(row.errors.values(), key=_least) for row in (none, best)]
    numbers = (
        measured('error, plant as believed [mrad]', none.errors[NOMINAL], best.errors[NOMINAL],
                 left),
        measured('error, robots drawn [mrad]', *(_median(row.drawn) for row in (none, best)), left)
        if best.drawn else measured('error, one thing different [mrad]', *worst, left),
        measured('motion at rest [mrad]', *(row.hold and max(row.hold) for row in (none, best)),
                 rest))
    robot = ('--robot', *files) if files else ()
    return Answer(
        f'On the plant as believed the error of "{best.name}" is the least{also}; the floor is '
        'what encoders and the controller itself leave where there is no friction at all.',
        ('none', best.name, 'floor'), numbers,
        command('simulate', *robot, '--compensation', 'none', best.mode, '--out', 'bags'))


def _least(error):
    """Return an error for comparison: one that was lost is the largest."""
    return np.inf if error is None else error


def bag_answer(predictions, joints, source, files=()) -> Answer:
    """Return which compensation predicts the rest of a bag best (Answer)."""
    none = next(one for one in predictions if one.mode == 'none')
    best = min((one for one in predictions if one.error is not None and not one.remark),
               key=lambda one: np.sum(np.square(one.error)))
    share = np.sqrt([np.sum(np.square(one)) / np.sum(np.square(of)) for one, of in (
        (best.error, none.error), (best.fitted, none.fitted))])
    rows = [measured('left of the friction torque [%]', 1.0, *share, scale=100.0)] + [
        measured(f'error of {joint} [mN m]', *figures) for joint, *figures in zip(
            joints, none.error, best.error, best.fitted, strict=True)]
    return Answer(
        f'"{best.name}" predicts the friction torque of the rest of the recording best and leaves '
        f'{100.0 * share[0]:.3g} % of it; the floor is what the same model leaves of the part '
        'that it was fitted to.', ('none', best.name, 'floor'), tuple(rows[:3]), command(
            'identify', source, *(('--robot', *files) if files else ()), '--out', 'friction'))


def plant_page(rows, outcomes, setting, source) -> Report:
    """
    Return the page of a comparison in simulation.

    ``rows`` (study.table) and ``outcomes`` by the keys of its cells were found with ``setting``
    (Setting); ``source`` are the robot files, none for the arm of the paper.
    """
    robot, answer = setting.robot, plant_answer(rows, outcomes, source)
    page = Report('Friction compensations compared', answer,
                  f'{", ".join(source) or "the arm of the paper"}, {setting.rate:g} Hz, sinusoid '
                  f'and polynomial of {setting.amplitude[0]:g} rad, simulated',
                  partial(in_units, robot.arm))
    *traces, (motion, joint, series, time) = _traces(setting, conditions(0)[0])
    page.chart(f'{motion}, {joint}: link angle - reference', time, [
        one._replace(hidden=one.label not in ('none', answer.columns[1])) for one in series],
        y_label='error [mrad]')
    page.heading('All in one table').table(
        _header(rows), [_cells(row) for row in rows])
    page.text(' '.join(_NOTE.split()) + '.')
    page.heading('Plant as believed').table(
        ['compensation', *(f'{motion}, {joint}' for motion in rows[0].mse
                           for joint in robot.joints),
         *(f'at rest, {joint} [mrad]' for joint in robot.joints)],
        [[row.name, *(_milli(value, 1.0) for motion in row.mse.values()
                      for value in motion or [None] * robot.n_joints),
          *(_milli(value) for value in row.hold or [None] * robot.n_joints)]
         for row in rows], caption='Mean square error [rad^2] and motion at rest')
    page.heading('One thing different at a time').table(
        ['condition', *CONTESTANTS.values()],
        [[one.name, *(_milli(study.error_of(outcomes[f'{mode} | {one.name}']))
                      for mode in CONTESTANTS)] for one in conditions(0)],
        caption='rms error of all joints and both motions [mrad]')
    if rows[0].drawn:
        page.heading('Robots drawn at random').xy_chart(
            'error of all drawn robots, the best first', [_ranked(row) for row in rows],
            'share of robots', 'rms error [mrad]', log_x=False)
    page.heading('Error over time, plant as believed')
    for motion, joint, series, time in traces:
        page.chart(f'{motion}, {joint}', time, series, y_label='error [mrad]', group=motion)
    return page


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


def bag_page(predictions, found, robot, source, share, files=()) -> Report:
    """
    Return the page of a comparison along a bag.

    ``predictions`` are those of prediction.compare_along for the recording ``found`` (Along), of
    which a ``share`` was fitted; ``files`` are those of the robot, if not the arm of the paper.
    """
    joints = robot.joints
    answer = bag_answer(predictions, joints, source, files)
    page = Report('Friction torque along a recording', answer, f'{source}: the first '
                  f'{100 * share:.0f} % fitted, the rest judged', partial(in_units, robot.arm))
    (title, time, lines, _), *others = _torques(predictions, found, joints)
    page.chart(f'{title}: friction torque', time, [
        one._replace(hidden=one.label not in ('measured', answer.columns[1])) for one in lines],
        y_label='friction torque [N m]')
    page.heading('Errors').table(*_bag_rows(predictions, joints),
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
