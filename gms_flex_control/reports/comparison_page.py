# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A comparison of friction compensations: table, answer and page."""

from functools import partial

from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports.figure_style import COLOURS, labelled, side_by_side, STYLES
from gms_flex_control.reports.page import ChartSeries, Report
from gms_flex_control.tuning import study
from gms_flex_control.tuning.study import conditions, CONTESTANTS, NOMINAL
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
        drawn = [_milli(_median(row.drawn)), _milli(None if None in row.drawn else max(row.drawn))]
        rest = [_milli(row.drawn_hold)]
    return [row.name, _milli(row.errors['nominal']),
            *(_milli(row.errors[group]) for group in _GROUPS), *drawn,
            _milli(None if row.hold is None else max(row.hold)), *rest, _milli(row.torque, 1.0),
            _milli(row.rate, 1.0)]


def plant_text(rows) -> str:
    """Return the whole table with a note, str."""
    return f'{align(_header(rows), [_cells(row) for row in rows])}\n{_NOTE}'


def plant_answer(rows, outcomes, again=()) -> Answer:
    """Return which compensation errs least (Answer); ``again``: options of `simulate`."""
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
    return Answer(
        f'On the plant as believed the error of "{best.name}" is the least{also}; the floor is '
        'what encoders and the controller itself leave where there is no friction at all.',
        ('none', best.name, 'floor'), numbers,
        command('simulate', *again, '--compensation', 'none', best.mode, '--out', 'bags'))


def _least(error):
    """Return an error for comparison: one that was lost is the largest."""
    return np.inf if error is None else error


def plant_page(rows, outcomes, setting, source, answer) -> Report:
    """Return the page of rows and outcomes of a Setting, of robot files ``source``, if any."""
    robot = setting.robot
    page = Report('Friction compensations compared', answer,
                  f'{", ".join(source) or "the arm of the paper"}, {setting.rate:g} Hz, sinusoid '
                  f'and polynomial of {setting.amplitude[0]:g} rad, simulated',
                  partial(in_units, robot.arm))
    *traces, (motion, joint, series, time) = _traces(setting, conditions(0)[0])
    page.chart(f'{motion}, {joint}: link angle - reference', time, [
        one._replace(hidden=one.label not in ('none', answer.columns[1])) for one in series],
        y_label='error [mrad]')
    page.heading('All in one table').table(_header(rows), [_cells(row) for row in rows])
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
        page.heading('Robots drawn at random').figure(
            _ranked_figure(rows), 'rms error of all drawn robots, the best first')
    page.heading('Error over time, plant as believed')
    for motion, joint, series, time in traces:
        page.chart(f'{motion}, {joint}', time, series, y_label='error [mrad]', group=motion)
    return page


def _role(mode):
    """Return the colour of a compensation, the same in every chart."""
    return ('reference', *(f'c{k}' for k in range(7)))[list(CONTESTANTS).index(mode)]


def _ranked_figure(rows):
    """Return the errors of all drawn robots, a curve for each compensation, the best first."""
    figure, (panel,) = side_by_side(1)
    for k, row in enumerate(rows[1:]):  # without any, errors are far larger
        known = 1e3 * np.sort([value for value in row.drawn if value is not None])
        share = (np.arange(len(known)) + 0.5) / max(len(row.drawn), 1)
        panel.plot(share, known, STYLES[k // len(COLOURS)], color=COLOURS[k % len(COLOURS)],
                   label=row.name)
    panel.legend(loc='best')
    return labelled(figure, [panel], [('share of robots', 'rms error [mrad]')],
                    'Robots drawn at random')


def _traces(setting, condition):
    """Yield motion, joint, ChartSeries of all compensations and time."""
    found = {}
    for mode in CONTESTANTS:
        for motion, _, run in study.runs_of(study.Cell(setting, mode, condition)):
            found.setdefault(motion, {})[mode] = run
    for motion, runs in found.items():
        for j, joint in enumerate(setting.robot.joints):
            series = [ChartSeries(CONTESTANTS[mode],
                                  1e3 * (run.true[:, 0, j] - run.reference[:, 0, j]),
                                  role=_role(mode), hidden=mode in ('none', 'stribeck', 'lugre'))
                      for mode, run in runs.items()]
            yield motion, joint, series, runs['none'].time
