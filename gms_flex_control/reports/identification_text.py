# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""An identification as tables for a terminal, below 100 columns."""

from textwrap import fill

from gms_flex_control.identification.beside import known_values, presliding_difference
from gms_flex_control.identification.words import (
    data_sentence,
    floor_shares,
    NOT_IDENTIFIABLE,
    notes,
    number,
    SET,
    short_name,
    span,
    standing,
)
import numpy as np

_WIDTH = 98
_LONGEST_NAME = 22


def identification_text(identification, beside=None):
    """
    Return an identification as lines of text.

    Parameters
    ----------
    identification : Identification
        To be told.
    beside : RobotParams, optional
        Known parameters, printed in a column of their own.

    Returns
    -------
    str
        Lines of fewer than 100 characters.

    """
    blocks = [_wrapped(f'{data_sentence(identification)}; fitted in '
                       f'{identification.seconds:.1f} s')]
    blocks += [_wrapped(f'warning: {text}') for text in identification.warnings]
    for result in identification.joints:
        known = known_values(beside, identification.robot, result.joint) if beside else None
        blocks.append(_joint(result, known, beside))
    blocks.append('Errors on held-out data; C+v: Coulomb + viscous alone\n'
                  + aligned(*held_out_rows(identification.joints)))
    return '\n\n'.join(blocks)


def parameter_rows(result, known=None):
    """
    Return header and rows of a joint's parameters, each with its interval.

    Parameters
    ----------
    result : JointResult
        Of one joint.
    known : dict of str to float, optional
        Values of a column 'true', by the names of estimates.

    Returns
    -------
    header : tuple of str
    rows : list of tuple of str

    """
    header = ('parameter', 'unit', 'value', '95 % interval', *(('true',) if known else ()),
              'to be noted')
    rows = []
    for estimate in result.estimates:
        lost = standing(estimate) == NOT_IDENTIFIABLE
        value, interval = number(estimate.value), span(estimate.interval)
        rows.append((short_name(estimate.name, result.joint), estimate.unit,
                     f'({value})' if lost else value, interval,
                     *((number(known.get(estimate.name, np.nan)),) if known else ()),
                     _remark(estimate)))
    return header, rows


def _remark(estimate):
    if standing(estimate) == NOT_IDENTIFIABLE:
        return 'NOT IDENTIFIABLE'
    if len(estimate.flags) > 1:
        return f'{estimate.flags[0]}, +{len(estimate.flags) - 1}'
    return estimate.flags[0] if estimate.flags else SET if standing(estimate) == SET else ''


def held_out_rows(results):
    """Return header and rows of held-out errors, one row per joint."""
    header = ('joint', 'torque [%]', 'C+v [%]', 'noise [%]', 'repeat [%]', 'free run [mrad]',
              'C+v [mrad]')
    rows = []
    for result in results:
        errors = result.held_out
        noise, repeat = floor_shares(errors)
        rows.append((_clipped(result.joint), *(number(100 * share, 3) for share in (
            errors.relative, errors.coulomb_viscous, noise, repeat)),
            number(1e3 * errors.free_run_rms, 3),
            number(1e3 * errors.free_run_coulomb_viscous, 3)))
    return header, rows


def _joint(result, known, beside):
    blocks = [(candidate.n_blocks, candidate.chosen) for candidate in result.candidates]
    chosen = next((f', N = {n} blocks' for n, taken in blocks if taken), '')
    source = {'spring': 'the spring', 'motor': 'the motor torque'}.get(result.side, result.side)
    lines = [f'{_clipped(result.joint)}: friction torque by {source}{chosen}',
             aligned(*parameter_rows(result, known))]
    if known:
        share, where = presliding_difference(result, beside)
        lines.append(f'presliding curve: at most {number(100 * share, 3)} % of F_s off the true '
                     f'one, at {number(1e3 * where, 3)} mrad')
    lines += [_wrapped(f'- {note}') for note in notes(result)]
    lines += [_wrapped(f'warning: {text}') for text in result.warnings]
    return '\n'.join(lines)


def aligned(header, rows):
    """Return a table as text: the first column to the left, columns of numbers to the right."""
    cells = [header, *rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    right = [all(row[i][:1] in '-(0123456789.' for row in rows) and '..' not in
             ''.join(row[i] for row in rows) for i in range(len(header))]
    return '\n'.join('  '.join(
        f'{cell:>{width}}' if to_right else f'{cell:<{width}}'
        for cell, width, to_right in zip(row, widths, right, strict=True)).rstrip()
        for row in cells)


def _clipped(name):
    return name if len(name) <= _LONGEST_NAME else f'{name[:_LONGEST_NAME - 1]}…'


def _wrapped(text):
    return fill(text, _WIDTH, subsequent_indent='  ')
