# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Batches give the same results wherever they run and whoever is killed, and can go on."""

import io
import signal
import sys
import threading

import batch_items
from gms_flex_control.batches import Journal, open_executor, Progress, run_batch
from gms_flex_control.comparison import study
from gms_flex_control.comparison.study import Condition
from gms_flex_control.errors import BatchError, SimulationError
from gms_flex_control.file_io import controller_file, robot_file
from gms_flex_control.schema.files import load_controller, load_robot
from loopback_cluster import cluster, until
import numpy as np
import pytest

ITEMS = {f'walk {seed}': seed for seed in range(6)}
ROBOT = load_robot(robot_file())
SETTING = study.Setting(ROBOT, load_controller(controller_file(), ROBOT), np.ones(2), 500.0, 0, 0)
CELL = {'a simulation': study.Cell(SETTING, 'gms', Condition('M +30 %', 'M', mass=1.3))}
SERIAL = {key: batch_items.walk(seed) for key, seed in ITEMS.items()}


@pytest.fixture(scope='module')
def processes():
    with open_executor(workers=2) as executor:
        yield executor


def test_processes_return_what_a_plain_loop_returns(processes):
    found = run_batch(batch_items.walk, ITEMS, executor=processes)
    assert found == SERIAL and list(found) == list(ITEMS)


def test_a_killed_run_goes_on_and_ends_as_an_undisturbed_one(tmp_path, processes):
    """The first run saw three items; the second works on the other three alone."""
    items = {key: (seed, str(tmp_path)) for key, seed in ITEMS.items()}
    journal = Journal(tmp_path / 'out', 'sources')
    run_batch(batch_items.noted_walk, dict(list(items.items())[:3]), executor=processes,
              journal=journal)
    with journal.path.open('a') as file:
        file.write('{"key": "walk 3", "sour')  # killed while writing
    again = Journal(tmp_path / 'out', 'sources')
    assert run_batch(batch_items.noted_walk, items, executor=processes,
                     journal=again) == SERIAL
    assert sorted(path.name for path in tmp_path.glob('*_*')) == [f'{i}_0' for i in range(6)]
    assert len(Journal(tmp_path / 'out', 'sources').outcomes) == 6


def test_a_killed_worker_process_costs_no_result(tmp_path, processes):
    items = {key: (seed, str(tmp_path), 2) for key, seed in ITEMS.items()}
    assert run_batch(batch_items.deadly_walk, items, executor=processes) == SERIAL
    assert (tmp_path / 'killed').exists()


def test_an_item_that_kills_every_worker_ends_in_a_sentence(processes):
    with pytest.raises(BatchError, match='enough memory'):
        run_batch(batch_items.always_deadly, {'a': 1}, executor=processes)


def test_an_item_that_kills_every_worker_can_be_passed_over(tmp_path, processes):
    """All others are done, though it kills every process before one of them is finished."""
    items = {key: (seed, 3) for key, seed in ITEMS.items()}
    journal = Journal(tmp_path, 'sources')
    found = run_batch(batch_items.soon_deadly_walk, items, executor=processes, journal=journal,
                      lost=lambda error: str(error))
    assert 'enough memory' in found.pop('walk 3')
    assert found == {key: value for key, value in SERIAL.items() if key != 'walk 3'}
    assert set(journal.outcomes) == set(found)


def test_what_an_item_raises_comes_through(processes):
    with pytest.raises(SimulationError, match='diverged'):
        run_batch(batch_items.fail, {'a': 0, 'b': 1}, executor=processes)


def test_without_workers_nothing_begins():
    with pytest.raises(BatchError, match='--workers 0'), open_executor(workers=0):
        pass


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


def test_the_bar_is_drawn_on_a_terminal_only():
    for stream, drawn in ((Terminal(), True), (io.StringIO(), False)):
        with Progress(2, label='runs', stream=stream) as bar:
            bar.step()
            bar.step()
        assert ('runs [##############################] 2/2' in stream.getvalue()) == drawn
        assert bool(stream.getvalue()) == drawn


def test_a_cluster_returns_the_same_even_when_a_worker_is_killed(tmp_path):
    """Kill -9 while it works on an item; the other worker does it again."""
    with cluster(tmp_path) as (address, workers):
        with open_executor(scheduler=address) as executor:
            assert run_batch(batch_items.walk, ITEMS, executor=executor) == SERIAL
            assert run_batch(study.try_cell, CELL, executor=executor) == {
                key: study.try_cell(cell) for key, cell in CELL.items()}
            with pytest.raises(SimulationError, match='diverged'):
                run_batch(batch_items.fail, {'a': 0, 'b': 1}, executor=executor)
            items = [(seed, str(tmp_path)) for seed in range(6)]
            finished = executor.finished(batch_items.slow_walk, items)
            found = {}
            index, result = next(_released(finished, tmp_path, workers[0]))
            found[index] = result()
            found |= {index: result() for index, result in finished}
        assert workers[0].poll() == -signal.SIGKILL
        assert [found[i] for i in range(6)] == list(SERIAL.values())


def test_a_cluster_passes_over_an_item_that_kills_its_worker(tmp_path):
    """The scheduler gives it up; what comes after is done by the worker that is left."""
    with cluster(tmp_path, allowed_failures=0) as (address, workers):
        with open_executor(scheduler=address) as executor:
            with pytest.raises(BatchError, match='enough memory'):
                run_batch(batch_items.always_deadly, {'a': 1}, executor=executor)
            assert run_batch(batch_items.walk, ITEMS, executor=executor,
                             lost=lambda error: str(error)) == SERIAL
        assert [worker.poll() for worker in workers].count(-signal.SIGKILL) == 1


def _released(finished, folder, victim):
    """Start the items, kill a worker that has begun one, then let all of them end."""
    def disturb():
        until(lambda: list(folder.glob(f'begun_*_{victim.pid}')))
        victim.kill()
        (folder / 'go').touch()

    thread = threading.Thread(target=disturb)
    thread.start()
    yield next(finished)
    thread.join()


def test_a_scheduler_that_is_not_there_is_reported(monkeypatch):
    pytest.importorskip('distributed', reason="Dask is not installed (extra 'dask')")
    monkeypatch.setattr('gms_flex_control.batches._PATIENCE', '1s')
    with pytest.raises(BatchError, match='does not answer'), open_executor(
            scheduler='tcp://127.0.0.1:9'):
        pass


def test_without_dask_the_way_out_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(BatchError, match=r"pip install '\.\[dask\]'"):
        with open_executor(scheduler='tcp://127.0.0.1:8786'):
            pass
