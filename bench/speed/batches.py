# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a batch costs beside its work: docs/scale.md, measured."""

from contextlib import contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
import resource
import subprocess
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

from bench.speed.timing import Measurement
from gms_flex_control.batches import Journal, open_executor, run_batch
from gms_flex_control.comparison.study import Cell, Condition, NOMINAL, Setting, try_cell
from gms_flex_control.errors import GmsFlexError
from gms_flex_control.experiment.driven import executable
from gms_flex_control.schema.files import save_robot
import numpy as np

_WORKERS, _FEW = 2, 20


def nothing(_):
    """Return as little as a result can be."""
    return {'value': 0.0}


def measure(robot, gains, quick=False):
    """
    Time items that do nothing, in processes and on a Dask cluster where it is installed.

    Robot and gains are part of every item, as in gms_flex compare; ``quick`` takes fewer items.
    Processor time is that of all processes, so it holds on a busy machine too.
    """
    count = 200 if quick else 1000
    cell = Cell(Setting(robot, gains, np.ones(robot.n_joints), 500.0, 0, 0), 'gms',
                Condition(NOMINAL, NOMINAL))
    try_cell(cell)
    begin = process_time()
    try_cell(cell)
    rows = [_row('work of one cell of gms_flex compare, processor time', process_time() - begin)]
    kinds = {'processes': lambda: open_executor(_WORKERS)}
    if find_spec('distributed') is not None:
        kinds['Dask'] = _cluster
    for name, opened in kinds.items():
        few, many = (_spent(opened, {f'item {k}': cell for k in range(n)})
                     for n in (_FEW, _FEW + count))
        rows += [_row(f'{name}: {_FEW} items, time', few[0]),
                 _row(f'{name}: each further item, time', (many[0] - few[0]) / count),
                 _row(f'{name}: each further item, processor time', (many[1] - few[1]) / count)]
    rows.append(_row('each item that the journal has, time', many[2] / (_FEW + count)))
    return [*rows, *_each_bag(robot, count)]


def _spent(opened, items):
    """Return time and processor time of a journalled batch, and time when all is known [s]."""
    begin, spent = perf_counter(), _processor_time()
    with TemporaryDirectory() as folder:
        with opened() as executor:
            run_batch(nothing, items, executor=executor, journal=Journal(folder, 'bench'))
            elapsed, again = perf_counter() - begin, perf_counter()
            run_batch(nothing, items, executor=executor, journal=Journal(folder, 'bench'))
            known = perf_counter() - again
    return elapsed, _processor_time() - spent, known


def _each_bag(robot, count):
    """Return rows on bags that `gms_flex identify --each` refuses at once: all but the work."""
    kinds = {'processes': lambda: nullcontext(None)}
    if find_spec('distributed') is not None:
        kinds['Dask'] = _scheduler
    rows = []
    for name, opened in kinds.items():
        few, many = (_spent_on_bags(opened, robot, number) for number in (_FEW, _FEW + count))
        rows += [_row(f'identify --each, {name}: each further bag, {what}', (b - a) / count)
                 for what, a, b in zip(('time', 'processor time'), few, many, strict=True)]
    return rows


def _spent_on_bags(opened, robot, count):
    """Return time and processor time of the command on empty bags [s]."""
    spent = _processor_time()
    with TemporaryDirectory() as folder:
        bags = [Path(folder) / f'bag_{k}' for k in range(count)]
        for bag in bags:
            bag.mkdir()
        save_robot(robot, Path(folder) / 'robot.yaml')
        with opened() as address:
            begin = perf_counter()
            done = subprocess.run(
                [*executable('gms_flex'), 'identify', *map(str, bags), '--each', '--robot',
                 f'{folder}/robot.yaml', '--out', f'{folder}/out', '--workers', str(_WORKERS),
                 *(['--scheduler', address] if address else [])],
                check=False, capture_output=True, text=True)
            elapsed = perf_counter() - begin
    if done.returncode != 1:
        raise GmsFlexError(f'gms_flex identify --each ended with {done.returncode}, expected 1: '
                           f'{done.stderr.strip()}')
    return elapsed, _processor_time() - spent


def _processor_time():
    """Return what this process and those that ended have used [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


@contextmanager
def _scheduler():
    from distributed import LocalCluster
    with LocalCluster(n_workers=_WORKERS, threads_per_worker=1, dashboard_address=None,
                      host='127.0.0.1') as cluster:
        yield cluster.scheduler_address


@contextmanager
def _cluster():
    with _scheduler() as address, open_executor(scheduler=address) as executor:
        yield executor


def _row(name, seconds):
    return Measurement(suite='batches', name=name, value=1e3 * seconds, unit='ms')
