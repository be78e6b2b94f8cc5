# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The bootstrap's replicates are the same to the last bit wherever they are made."""

import json
import signal
import threading

from gms_flex_control.batches.executor import open_executor
from gms_flex_control.cli.main import main
from gms_flex_control.identification import replicates
from gms_flex_control.identification.objective import Evaluation
from gms_flex_control.identification.refine import Prior
from gms_flex_control.identification.uncertainty import _inverse, draw, REPLICATES
from gms_flex_control.schema.files import save_robot
from identified_axis import axis, experiment
from loopback_cluster import cluster, until
import numpy as np
import pytest

SIZE, BLOCKS = 17, 300


def fit(seed, blocks=BLOCKS):
    """Return the Evaluation and Prior of a made-up fit of so many blocks of time."""
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((blocks, 5, SIZE))
    evaluation = Evaluation(
        square=1.0 + rng.random(blocks), gradient=rng.standard_normal((blocks, SIZE)),
        curvature=np.einsum('bkp,bkq->bpq', slopes, slopes), count=np.full(blocks, 100),
        seen=np.full(blocks, 100), floor=0.1)
    return evaluation, Prior(np.zeros(SIZE), np.full(SIZE, 1.0 / 9.0))


def drawn(seed, blocks=BLOCKS):
    """Return what replicates of a made-up fit are made of."""
    return draw(*fit(seed, blocks), np.random.default_rng([seed, 1]))


DRAWS = [drawn(0), drawn(1)]


def from_one_stream(seed):
    """Return steps as they were made one after the other, a draw and a step at a time."""
    evaluation, prior = fit(seed)
    rng = np.random.default_rng([seed, 1])
    scores = evaluation.weight[:, None] * evaluation.gradient
    scores = scores - scores.mean(axis=0)
    weighted = evaluation.weight[:, None, None] * evaluation.curvature
    steps = []
    for _ in range(REPLICATES):
        times = np.bincount(rng.integers(BLOCKS, size=BLOCKS), minlength=BLOCKS)
        again = np.tensordot(times, weighted, 1) + np.diag(prior.precision)
        steps.append(np.clip(_inverse(again) @ (times @ scores), -5.0, 5.0))
    return np.stack(steps)


def assert_equal(found, draws=DRAWS):
    """Raise unless the steps are those of this process, bit for bit."""
    here = replicates.make_steps(draws)
    assert len(found) == len(draws)
    for one, other in zip(found, here, strict=True):
        np.testing.assert_array_equal(one, other)


def test_drawing_all_first_changes_no_number():
    for seed, steps in enumerate(replicates.make_steps(DRAWS)):
        with replicates.alone_in_one_thread():
            np.testing.assert_array_equal(steps, from_one_stream(seed))


@pytest.mark.parametrize('part', [7, 100, 400])
def test_parts_of_any_size_are_the_same_in_processes(monkeypatch, part):
    monkeypatch.setattr(replicates, '_PART', part)
    with open_executor(workers=2) as executor:
        assert_equal(replicates.make_steps(DRAWS, executor))


def test_a_cluster_makes_the_same_even_when_a_worker_is_killed(tmp_path, monkeypatch):
    """Parts of four replicates, 200 in all; the worker is killed after some of them."""
    monkeypatch.setattr(replicates, '_PART', 4)
    seen, draws = [], [drawn(seed, blocks=20) for seed in range(2)]
    with cluster(tmp_path) as (address, workers):
        def disturb():
            until(lambda: len(seen) > 20)
            workers[0].kill()

        monkeypatch.setattr('gms_flex_control.batches.progress.Progress.step',
                            lambda self: seen.append(1))
        thread = threading.Thread(target=disturb)
        thread.start()
        with open_executor(scheduler=address) as executor:
            assert_equal(replicates.make_steps(draws, executor), draws)
        thread.join()
        assert workers[0].wait() == -signal.SIGKILL
    assert len(seen) == 2 * REPLICATES / 4


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return the path of a bag of an axis on a spring, and of its robot's file."""
    from gms_flex_control.bags.experiment import write_recording
    folder = tmp_path_factory.mktemp('axis')
    recording, phases = experiment()
    write_recording(folder / 'bag', recording, axis().motors, phases=phases)
    save_robot(axis(), folder / 'robot.yaml')
    return str(folder / 'bag'), str(folder / 'robot.yaml')


def test_the_report_is_the_same_with_workers(bag, tmp_path, monkeypatch):
    """All of it, once the replicates are made here and once in two processes."""
    made, reports = [], []
    monkeypatch.setattr('gms_flex_control.identification.replicates.run_batch',
                        lambda *a, **k: made.append(1) or run_batch(*a, **k))
    from gms_flex_control.batches.batch import run_batch
    for further in ([], ['--workers', '2']):
        assert main(['identify', bag[0], '--robot', bag[1], '--blocks', '4', '--out',
                     str(tmp_path), *further]) == 0
        reports.append(json.loads((tmp_path / 'report.json').read_text()) | {'seconds': 0.0})
    assert reports[0] == reports[1]
    assert made == [1]


def test_workers_that_are_none_are_refused_before_anything_is_read(bag, tmp_path, capsys):
    assert main(['identify', bag[0], '--robot', bag[1], '--workers', '0', '--out',
                 str(tmp_path / 'out')]) == 2
    assert '--workers 0: at least one is needed' in capsys.readouterr().err
