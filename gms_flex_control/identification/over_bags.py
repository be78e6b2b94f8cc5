# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Bags identified each by itself, side by side: how a parameter scatters from bag to bag.

The scatter is put beside what the intervals of the bags foresee. More than that is what changed
between the recordings: temperature, load, wear, another machine.
"""

from collections import Counter
import math
from typing import NamedTuple

from gms_flex_control.identification.result import CONFIDENT
from gms_flex_control.identification.words import NOT_IDENTIFIABLE, SET, standing
import numpy as np

_NORMAL = 1.4826       # standard deviation over median distance from the median
_FAR = 3.5             # such deviations: an outlier
_FEWEST = 4            # of three values that differ nobody knows which is the odd one
# by how much the median distance of few values is too small (Croux and Rousseeuw, 1992)
_FEW = {4: 1.363, 5: 1.206, 6: 1.200, 7: 1.140, 8: 1.129, 9: 1.107}


class OverBags(NamedTuple):
    """One parameter over all bags that tell it."""

    name: str
    unit: str
    bags: int                  # that tell it: neither set nor flagged as not identifiable
    mean: float
    median: float
    standard_deviation: float  # over the bags; NaN for one
    foreseen: float            # standard deviation by the intervals of the bags
    outliers: tuple            # names of bags


def bag_values(identification):
    """
    Return what is compared of an Identification, plain values for JSON.

    Parameters
    ----------
    identification : Identification
        Of one bag.

    Returns
    -------
    dict
        ``estimates`` with ``low`` and ``high`` of the interval, ``held_out`` and
        ``coulomb_viscous`` (errors relative to the torque) of each joint, and ``warnings``;
        a number that is not finite is None. The time it took is not in it: all else is the same
        wherever it was done.

    """
    joints = identification.joints
    return {
        'estimates': [_estimate(one) for result in joints for one in result.estimates],
        'held_out': {one.joint: _plain(one.held_out.relative) for one in joints},
        'coulomb_viscous': {one.joint: _plain(one.held_out.coulomb_viscous) for one in joints},
        'warnings': [*identification.warnings, *(f'{one.joint}: {text}' for one in joints
                                                 for text in one.warnings)]}


def _estimate(estimate):
    low, high = estimate.interval
    return {'name': estimate.name, 'unit': estimate.unit, 'value': _plain(estimate.value),
            'low': _plain(low), 'high': _plain(high), 'flags': list(estimate.flags),
            'standing': standing(estimate)}


def _plain(value):
    return float(value) if math.isfinite(value) else None


def over_bags(bags):
    """
    Return how each parameter comes out over bags.

    Parameters
    ----------
    bags : dict of str to dict
        `bag_values` by the name of the bag.

    Returns
    -------
    tuple of OverBags
        Stiffnesses of blocks only from the bags that have the commonest number of blocks.

    """
    usual = _usual_blocks(bags)
    told, units = {}, {}
    for bag, values in bags.items():
        blocks = _blocks(values)
        for one in values['estimates']:
            units[one['name']] = one['unit']
            told.setdefault(one['name'], {})
            joint = _block_of(one['name'])
            if is_told(one) and (joint is None or blocks[joint] == usual[joint]):
                told[one['name']][bag] = one
    return tuple(_row(name, units[name], rows) for name, rows in told.items() if rows)


def is_told(estimate):
    """Return whether data, and not a prior or a person, gave an estimate of `bag_values`."""
    return (estimate['standing'] not in (NOT_IDENTIFIABLE, SET)
            and None not in (estimate['value'], estimate['low'], estimate['high']))


def _block_of(name):
    """Return the prefix that the blocks of a joint have in common, None for other parameters."""
    prefix, bracket, _ = name.partition('.stiffness[')
    return prefix if bracket else None


def _blocks(values):
    """Return the number of blocks of each joint of a bag."""
    return Counter(filter(None, (_block_of(one['name']) for one in values['estimates'])))


def _usual_blocks(bags):
    """Return the commonest number of blocks of each joint, the smaller of two as common."""
    counts = {}
    for values in bags.values():
        for joint, number in _blocks(values).items():
            counts.setdefault(joint, Counter())[number] += 1
    return {joint: min(found, key=lambda number: (-found[number], number))
            for joint, found in counts.items()}


def _row(name, unit, rows):
    values = np.array([one['value'] for one in rows.values()])
    errors = np.array([0.5 * (one['high'] - one['low']) for one in rows.values()]) / CONFIDENT
    far = is_outlier(values, errors)
    return OverBags(
        name, unit, len(values), float(values.mean()), float(np.median(values)),
        float(values.std(ddof=1)) if len(values) > 1 else float('nan'),
        float(np.sqrt(np.mean(errors ** 2))),
        tuple(bag for bag, out in zip(rows, far, strict=True) if out))


def is_outlier(values, errors):
    """
    Return which values lie farther from the others than scatter and own error explain.

    Parameters
    ----------
    values, errors : ndarray, shape (B,)
        One of each bag, and its standard error.

    Returns
    -------
    ndarray of bool, shape (B,)
        None of fewer than four.

    """
    if len(values) < _FEWEST:
        return np.zeros(len(values), dtype=bool)
    distance = np.abs(values - np.median(values))
    scatter = _NORMAL * _FEW.get(len(values), 1.0) * np.median(distance)
    return distance > _FAR * np.hypot(scatter, errors)
