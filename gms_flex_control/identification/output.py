# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Files for machines: report.json, and friction.yaml for controller, plant and tools.

Of bags identified each by itself, also how a parameter scatters from bag to bag, beside what the
intervals of the bags foresee. More than that is what changed between the recordings: temperature,
load, wear, another machine.
"""

from collections import Counter
import math
from textwrap import wrap
from typing import NamedTuple

from gms_flex_control import __version__
from gms_flex_control.file_io import plain, write_json
from gms_flex_control.identification.outcome import (
    CONFIDENT,
    data_sentence,
    Identification,
    joint_sentences,
    NOT_IDENTIFIABLE,
    percent,
    SET,
    short_name,
    standing,
)
from gms_flex_control.params.robot import KINDS
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.files import save_values
import numpy as np

REPORT_FORMAT = 1
_COMMENT_WIDTH = 90
# times what is usual: intervals know nothing of what a model lacks, nor of other days
_LEAST_TOLD, _MOST_TOLD = 0.5, 4.0


def report_json(identification: Identification) -> dict:
    """Return an identification as plain data for JSON, without the long arrays; None for NaN."""
    words = identification.in_units
    return plain({
        'format': REPORT_FORMAT, 'version': __version__, 'sources': identification.sources,
        'holdouts': identification.holdouts,
        'duration': identification.duration,
        'period': identification.period, 'seconds': identification.seconds,
        'warnings': plain(identification.warnings, words),
        'joints': [plain(_joint(result), words) for result in identification.joints]})


def _joint(result):
    return {
        'joint': result.joint, 'side': result.side,
        'summary': [text for text, _ in joint_sentences(result)],
        'estimates': [estimate._asdict() | {'standing': standing(estimate)}
                      for estimate in result.estimates],
        'candidates': [candidate._asdict() for candidate in result.candidates],
        'held_out': result.held_out._asdict(), 'warnings': result.warnings}


def write_report_json(identification: Identification, path) -> None:
    """Write `report_json` to ``path``, whole or not at all."""
    write_json(path, report_json(identification))


def friction_values(identification: Identification) -> dict:
    """
    Return the flat parameters that were identified.

    Names of joints and motors, friction of all joints, and what else the fit has changed; of a
    robot that no file has described, the whole arm. A joint the fit made rigid, for want of a
    trusted spring, keeps motor and stiffness of the believed robot.
    """
    found = robot_values(identification.robot)
    believed = robot_values(identification.believed)
    values = {name: believed[name] for name in ('joints', 'motors')}
    for name, value in found.items():
        part = name.split('.')[0]
        if part == 'friction':
            values[name] = value
        elif part == 'arm' and not identification.described:
            values[name] = value
        elif part in ('arm', 'effects') and value != believed.get(name):
            if not (name.endswith('.stiffness') and math.isinf(value)):
                values[name] = value
    for joint in identification.robot.joints:
        _drop_empty_blocks(values, f'friction.{joint}.')
    return values | uncertainty_values(identification)


# kinds of known parameters by the parameters of friction that determine them
_KNOWN_BY = {'level': 'coulomb', 'viscous': 'viscous', 'static': 'static',
             'velocity': 'velocity', 'attraction': 'attraction', 'blocks': 'stiffness['}


def uncertainty_values(identification: Identification) -> dict:
    """
    Return how well friction is known: flat ``uncertainty`` parameters, from the intervals.

    Relative standard deviations; flagged estimates say nothing.
    """
    values = {}
    for result in identification.joints:
        for kind, name in _KNOWN_BY.items():
            sizes = [0.5 * (one.interval.high - one.interval.low)
                     / CONFIDENT / abs(one.value) for one in result.estimates
                     if not one.flags and one.value and one.name.startswith('friction.')
                     and one.name.split('.')[-1].startswith(name)]
            sizes = [size for size in sizes if np.isfinite(size) and size > 0.0]
            if sizes:
                values[f'uncertainty.{result.joint}.{kind}'] = float(np.clip(
                    np.median(sizes), _LEAST_TOLD * KINDS[kind].sd, _MOST_TOLD * KINDS[kind].sd))
    return values


def _drop_empty_blocks(values, prefix):
    """Leave out the blocks at the end that carry nothing."""
    count = 1 + max(i for i, weight in enumerate(values[f'{prefix}weight']) if weight > 0.0)
    for name in ('stiffness', 'weight'):
        values[prefix + name] = values[prefix + name][:count]


def write_friction(identification: Identification, path) -> None:
    """Write friction.yaml: a ROS parameter file to be loaded after the robot's own."""
    save_values(friction_values(identification), path, comment=_comment(identification))


def _comment(identification):
    lines = [f'Friction identified by gms_flex identify {__version__}.',
             'Load it after the robot file: [robot.yaml, friction.yaml].',
             f'{data_sentence(identification)}.',
             *identification.warnings]
    for result in identification.joints:
        errors = result.held_out
        lines.append(f'{result.joint}: held-out torque error {percent(errors.relative)}, '
                     f'with Coulomb + viscous alone {percent(errors.coulomb_viscous)}')
        lines += [f'  {short_name(estimate.name, result.joint)}: '
                  f"{', '.join(estimate.flags).upper()}; {estimate.note}".rstrip('; ')
                  for estimate in result.estimates if estimate.flags]
    return '\n'.join(part for line in lines for part in wrap(
        line, _COMMENT_WIDTH, subsequent_indent='    '))


class OverBags(NamedTuple):
    """One parameter over all bags that identify it."""

    name: str
    unit: str
    bags: int                  # that identify it: neither set nor flagged as not identifiable
    mean: float
    standard_deviation: float  # over the bags; NaN for one
    foreseen: float            # standard deviation by the intervals of the bags


def bag_values(identification: Identification) -> dict:
    """
    Return what is compared of an Identification of one bag, plain values for JSON.

    ``estimates`` with ``low`` and ``high`` of the interval, ``held_out`` and ``coulomb_viscous``
    (errors relative to the torque) of each joint, and ``warnings``; None for NaN. The same
    wherever and however fast it was computed.
    """
    joints = identification.joints
    return plain({
        'estimates': [_estimate(one) for result in joints for one in result.estimates],
        'held_out': {one.joint: one.held_out.relative for one in joints},
        'coulomb_viscous': {one.joint: one.held_out.coulomb_viscous for one in joints},
        'warnings': [*identification.warnings, *(f'{one.joint}: {text}' for one in joints
                                                 for text in one.warnings)]})


def _estimate(estimate):
    low, high = estimate.interval
    return {'name': estimate.name, 'unit': estimate.unit, 'value': estimate.value,
            'low': low, 'high': high, 'flags': estimate.flags, 'standing': standing(estimate)}


def over_bags(bags: dict) -> tuple:
    """
    Return an OverBags of each parameter, from `bag_values` by the name of the bag.

    Stiffnesses of blocks only from the bags that have the commonest number of blocks.
    """
    usual = _usual_blocks(bags)
    found, units = {}, {}
    for bag, values in bags.items():
        blocks = _blocks(values)
        for one in values['estimates']:
            units[one['name']] = one['unit']
            found.setdefault(one['name'], {})
            joint = _block_of(one['name'])
            if is_identified(one) and (joint is None or blocks[joint] == usual[joint]):
                found[one['name']][bag] = one
    return tuple(_row(name, units[name], rows) for name, rows in found.items() if rows)


def is_identified(estimate: dict) -> bool:
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
    return OverBags(
        name, unit, len(values), float(values.mean()),
        float(values.std(ddof=1)) if len(values) > 1 else float('nan'),
        float(np.sqrt(np.mean(errors ** 2))))
