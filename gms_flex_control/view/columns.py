# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The signals of the page as columns, the same from a bag as live."""

import numpy as np

PER_JOINT = ('link', 'motor', 'reference', 'error', 'twist', 'command', 'friction')


def column_names(n, blocks):
    """
    Return the names of all columns, ``time`` first.

    Parameters
    ----------
    n, blocks : int
        Joints, and friction blocks of each (0 for none).

    Returns
    -------
    list of str
        ``<signal>.<joint>`` for each of PER_JOINT, then ``block.<joint>.<block>`` [N m] and
        ``stick.<joint>.<block>`` (1 sticks, 0 slips), counted from 0. Angles are in rad,
        ``error`` is link - reference, ``twist`` motor - link.

    """
    names = ['time', *(f'{signal}.{j}' for signal in PER_JOINT for j in range(n))]
    return names + [f'{signal}.{j}.{i}' for signal in ('block', 'stick')
                    for j in range(n) for i in range(blocks)]


def columns_of(recording, torque=None, sticking=None):
    """
    Return the columns of a recording.

    Parameters
    ----------
    recording : Recording
        Of T samples and n joints.
    torque, sticking : ndarray, shape (T, n, N), optional
        Of the friction blocks; NaN where unknown.

    Returns
    -------
    dict of str to ndarray, shape (T,)
        In the order of `column_names`.

    """
    reference = recording.reference[:, 0]
    tables = {'link': recording.q_link, 'motor': recording.q_motor, 'reference': reference,
              'error': recording.q_link - reference,
              'twist': recording.q_motor - recording.q_link,
              'command': recording.command, 'friction': recording.friction_hat}
    columns = {'time': np.asarray(recording.time)}
    columns |= {f'{signal}.{j}': tables[signal][:, j]
                for signal in PER_JOINT for j in range(recording.n_joints)}
    for signal, values in (('block', torque), ('stick', sticking)):
        if values is not None:
            columns |= {f'{signal}.{j}.{i}': values[:, j, i]
                        for j in range(values.shape[1]) for i in range(values.shape[2])}
    return columns


def beside(recording, time, number):
    """
    Return the columns of another recording of the same joints, to be drawn over the first.

    Parameters
    ----------
    recording : Recording
        Of n joints; its first sample is put at 0.
    time : ndarray, shape (T,)
        Of the first recording, from its first sample [s].
    number : int
        Of the recording, from 1.

    Returns
    -------
    dict of str to ndarray, shape (T,)
        ``<signal>.<joint>@<number>``, NaN where the recording has ended.

    """
    return {f'{name}@{number}': np.interp(time, recording.time, values, right=np.nan)
            for name, values in columns_of(recording).items() if name != 'time'}


def present(columns):
    """
    Return which signals have a number anywhere.

    Parameters
    ----------
    columns : dict of str to ndarray
        As from `columns_of`.

    Returns
    -------
    dict of str to bool
        For each of PER_JOINT, ``block`` and ``stick``.

    """
    found = dict.fromkeys((*PER_JOINT, 'block', 'stick'), False)
    for name, values in columns.items():
        signal = name.partition('.')[0]
        if signal in found and not found[signal]:
            found[signal] = bool(np.isfinite(values).any())
    return found
