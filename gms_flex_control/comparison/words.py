# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A comparison as one table for the terminal."""

from gms_flex_control.analysis.table4 import align
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
