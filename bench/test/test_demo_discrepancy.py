# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The discrepancy demo, shortened: nine node processes, three bags, one effect found."""

import json

from bench.demos.hidden_effect import draw_effect, drawable
from gms_flex_control.data.reader import read_recording
from gms_flex_control.effects import registry
from gms_flex_control.effects.base import Scales, Travel
from gms_flex_control.experiment.simulated import read_plan, simulate
from gms_flex_control.file_io import controller_file
from gms_flex_control.schema.files import load_robot
import numpy as np
from processes import run_with_nodes
import pytest

SEED, DURATION = 0, 20.0


@pytest.fixture(scope='module')
def outcome(tmp_path_factory):
    """Run the demo on 20 s; return its folder and what it printed."""
    folder = tmp_path_factory.mktemp('demo_discrepancy') / 'output'
    return folder, run_with_nodes('demo-discrepancy', '--out', folder, '--seed', SEED,
                                  '--duration', DURATION).stdout


@pytest.fixture(scope='module')
def report(outcome):
    """Return its report.json."""
    return json.loads((outcome[0] / 'report.json').read_text(encoding='utf-8'))


def test_what_was_hidden_is_named_and_the_gap_shrinks(outcome, report):
    spec, = load_robot(outcome[0] / 'hidden_robot.yaml').effects
    found = report['discrepancy']['findings'][0]
    assert report['name_right'] and report['gap_shrank'] and report['seed'] == SEED
    assert len(list((outcome[0] / 'log').glob('*/*.log'))) == 12
    assert (found['effect'], found['joint']) == spec.key
    assert spec.name in drawable()
    gap = report['discrepancy']['gap']
    for before, after in (('retuned', 'after'), ('free_before', 'free_after')):
        assert sum(gap[after].values()) < 0.5 * sum(gap[before].values())


def test_the_arm_follows_better_nearly_as_with_the_truth(report):
    before, found, true = (np.array(list(report['tracking'][belief].values()))
                           for belief in ('believed', 'found', 'true'))
    assert np.sum(true) < 0.6 * np.sum(before)
    assert np.sum(before - found) > 0.8 * np.sum(before - true)
    assert np.all(found < 1.5 * true)


@pytest.mark.parametrize('belief', ['found', 'true'])
def test_nodes_that_know_the_effect_agree_with_one_process(outcome, belief):
    folder = outcome[0]
    model = folder / ('robot.yaml' if belief == 'found' else 'hidden_robot.yaml')
    plan = read_plan(
        [folder / 'believed_robot.yaml', controller_file(), folder / 'trajectory.yaml',
         folder / 'hidden_robot.yaml'], model=model, duration=5.0,
        overrides={'rate': 500.0, 'compensation': 'gms'})
    run, recording = simulate(plan), read_recording(folder / 'bags' / belief)
    samples = len(run.time)
    assert np.abs(recording.q_link[:samples] - run.q_link).max() < 1e-9
    assert np.abs(recording.command[:samples] - run.command).max() < 1e-9


@pytest.mark.parametrize('name', drawable())
def test_every_effect_that_may_be_drawn_is_of_usual_size_and_allowed(name, robot):
    """As a robot file with it is read; half to one and a half times what is usual."""
    kind, rng = registry.find(name), np.random.default_rng(1)
    scales = [Scales(friction=0.1, torque=1.0, spring=0.3, torsion=0.05, speed=0.4, inertia=5e-3,
                     link_inertia=0.1, travel=Travel(-1.0, 1.0, 2.0), duration=20.0)] * 2
    for _ in range(5):
        spec = draw_effect(rng, name, robot, scales)
        given = dict(zip((one.name for one in kind.parameters), spec.values, strict=True))
        assert kind.values(given, 'effects') == spec.values
        usual = kind.typical(scales[0])[0]
        assert 0.49 * usual < abs(spec.values[0]) < 1.51 * usual
