# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How parameters and state can reach compiled kernels: docs/decisions.md, measured.

The kernels name fields only, so the very same plant runs on numpy records and on NamedTuples of
arrays made from them.
"""

from collections import namedtuple
from functools import cache
from time import perf_counter

from bench.speed.timing import interleaved, Measurement
from gms_flex_control.compiled import compiled
from gms_flex_control.records import boxed
from gms_flex_control.simulation import plant
import numpy as np

_DT = 1e-4


@cache
def _tuple_class(fields):
    return namedtuple('Fields', fields)


def as_tuples(record):
    """Return a record as a NamedTuple of arrays, nested as the record is; values are copied."""
    values = []
    for name in record.dtype.names:
        value = record[name]
        nested = isinstance(value, np.void)
        values.append(as_tuples(value) if nested else np.array(value))
    return _tuple_class(record.dtype.names)(*values)


@compiled
def tuples_loop(count, state, command, constants, work):
    """Take ``count`` substeps with NamedTuples."""
    for k in range(count):
        plant.substep(state, command, k * _DT, _DT, constants, work)


@compiled
def records_loop(count, state, command, constants, work):
    """Take ``count`` substeps with records."""
    for k in range(count):
        plant.substep(state, command, k * _DT, _DT, constants, work)


@compiled
def boxes_loop(count, state, command, constants, work):
    """Take ``count`` substeps with records in arrays of one."""
    for k in range(count):
        plant.substep(state[0], command, k * _DT, _DT, constants[0], work[0])


def measure(robot, gains, quick=False):
    """
    Measure a plant substep inside a loop, and what a call from Python costs on top.

    Parameters
    ----------
    robot : RobotParams
        The robot.
    gains : ControllerParams
        Not used.
    quick : bool
        Fewer repetitions.

    Returns
    -------
    list of Measurement

    """
    records = (plant.init(robot), np.full(robot.n_joints, 0.15), plant.constants_of(robot),
               plant.workspace(robot.n_joints))
    forms = {'NamedTuples of arrays': (tuples_loop, [
                 as_tuples(x) if isinstance(x, np.void) else x for x in records]),
             'records': (records_loop, records),
             'records in boxes': (boxes_loop, [
                 boxed(x) if isinstance(x, np.void) else x for x in records])}
    count, calls = (200, 200) if quick else (5000, 2000)
    rows, cases = [], {}
    for name, (loop, arguments) in forms.items():
        begin = perf_counter()
        loop(1, *arguments)
        rows.append(_row(name, 'first call, compiled or cached', perf_counter() - begin, 's'))
        cases[name, 'loop'] = lambda loop=loop, arguments=arguments: loop(count, *arguments)
        cases[name, 'call'] = lambda loop=loop, arguments=arguments: [
            loop(0, *arguments) for _ in range(calls)]
    times = interleaved(cases, 3 if quick else 11)
    for name in forms:
        rows += [_row(name, 'substep in a loop', 1e9 * times[name, 'loop'] / count, 'ns'),
                 _row(name, 'call from Python', 1e6 * times[name, 'call'] / calls, 'us')]
    return rows


def _row(name, what, value, unit):
    return Measurement(suite='arguments', name=f'{name}: {what}', value=value, unit=unit)
