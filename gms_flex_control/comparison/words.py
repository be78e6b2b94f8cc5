# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A comparison as one table for the terminal, and its answer."""

from gms_flex_control.analysis.table4 import align
from gms_flex_control.answer import Answer, command, measured
from gms_flex_control.comparison import study
from gms_flex_control.comparison.contestants import NOMINAL
import numpy as np

_GROUPS = {'friction': 'F+-30%', 'K': 'K+-20%', 'M': 'M+-30%', '4096 counts': '4k', '16384 counts':
           '16k', '65536 counts': '65k', '200 Hz': '200Hz', '1000 Hz': '1kHz'}


def milli(value):
    """Return a figure in thousandths as text, 'lost' for None."""
    return 'lost' if value is None else f'{1e3 * value:.3g}'


def plain(value):
    """Return a figure as text, 'lost' for None."""
    return 'lost' if value is None else f'{value:.3g}'


def middle(values):
    """Return the median of a list; None where most are None."""
    known = [np.inf if value is None else value for value in values]
    found = float(np.median(known)) if known else None
    return found if found is None or np.isfinite(found) else None


def largest(values):
    """Return the largest of a list; None where one is None, or there is none."""
    return None if not values or None in values else max(values)


def header(rows):
    """Return the column titles of `cells_of`."""
    drawn, rest = (['drawn', 'worst'], ['drawn']) if rows[0].drawn else ([], [])
    return ['compensation', 'error', *(_GROUPS[group] for group in _GROUPS), *drawn,
            'at rest', *rest, 'torque', 'rate']


def cells_of(row):
    """Return one Row as cells of text; units as in `NOTE`."""
    drawn, rest = [], []
    if row.drawn:
        drawn = [milli(middle(row.drawn)), milli(largest(row.drawn))]
        rest = [milli(row.drawn_hold)]
    return [row.name, milli(row.errors['nominal']),
            *(milli(row.errors[group]) for group in _GROUPS), *drawn,
            milli(None if row.hold is None else max(row.hold)), *rest, plain(row.torque),
            plain(row.rate)]


NOTE = ('rms error of all joints and both motions [mrad], the plant as believed, then with one '
        'thing different at a\ntime (the worse of both signs), then of robots drawn with all '
        'of friction, K and M off (median, worst);\nlargest motion at rest [mrad] of the plant '
        'as believed and of all drawn; rms torque [N m] and rms of its\nrate [N m/s] of the '
        'plant as believed')


def text(rows):
    """Return the whole table with a note, str."""
    return f'{align(header(rows), [cells_of(row) for row in rows])}\n{NOTE}'


def bag_rows(predictions, joints):
    """Return header and rows of predictions along a bag, cells of text [mN m]."""
    titles = ['compensation', *(f'{joint} held out' for joint in joints),
              *(f'{joint} fitted' for joint in joints), 'remark']
    nothing = ['-'] * len(joints)
    return titles, [[
        one.name, *(nothing if one.error is None else map(milli, one.error)),
        *(nothing if one.fitted is None else map(milli, one.fitted)), one.remark]
        for one in predictions]


def bag_text(predictions, found, joints):
    """Return the table of predictions along a bag with a note, str."""
    rms = np.sqrt(np.mean(np.concatenate([one.friction for one in found.pieces]) ** 2, axis=0))
    size = ', '.join(f'{joint} {1e3 * value:.3g}'
                     for joint, value in zip(joints, rms, strict=True))
    return (f'{align(*bag_rows(predictions, joints))}\nrms error of the predicted friction torque '
            f'[mN m]; the measured one is {size}')


def plant_answer(rows, outcomes, files=()) -> Answer:
    """Return which compensation errs least in simulation (Answer); ``files`` of the robot."""
    floor = study.floor_of(outcomes)
    left = study.error_of(floor)
    rest = None if left is None else max(floor['polynomial']['hold'])
    best = min(rows, key=lambda row: _least(row.errors[NOMINAL]))
    none = next(row for row in rows if row.mode == 'none')
    steadiest = min(rows, key=lambda row: _least(middle(row.drawn)))
    also = ('' if not best.drawn else ' and on robots drawn at random' if steadiest is best
            else f', on robots drawn at random that of "{steadiest.name}"')
    worst = [max(row.errors.values(), key=_least) for row in (none, best)]
    numbers = (
        measured('error, plant as believed [mrad]', none.errors[NOMINAL], best.errors[NOMINAL],
                 left),
        measured('error, robots drawn [mrad]', *(middle(row.drawn) for row in (none, best)), left)
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
