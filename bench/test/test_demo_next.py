# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The demo of `next`: real nodes follow designed motions until one name is left."""

import json
from pathlib import Path

from gms_flex_control.data.reader import read_recording
from gms_flex_control.schema.files import load_limits, load_robot, read_values
import numpy as np
from processes import run_with_nodes
import pytest

ROOT = Path(__file__).parents[2]
BUDGET = 30.0


@pytest.fixture(scope='module')
def outcome(tmp_path_factory):
    """Run the demo; return its folder."""
    folder = tmp_path_factory.mktemp('demo_next') / 'output'
    run_with_nodes('demo-next', '--out', folder, '--budget', BUDGET)
    return folder


def test_two_names_are_left_by_the_first_recording_and_the_hidden_one_by_the_last(outcome):
    values = json.loads((outcome / 'separation.json').read_text())
    spec, = load_robot([outcome / 'hidden_robot.yaml']).effects
    assert len(values['rounds'][0]['explanations']) == 2
    assert values['verdict'] == 'one_left' and values['robot_time'] <= BUDGET
    assert values['left'] == [f'{spec.name} of {spec.joint}']
    assert values['log_odds'][0][1] >= values['wanted'] == pytest.approx(np.log(99.0))
    assert (outcome / 'separation.png').stat().st_size > 10_000


def test_the_nodes_drove_what_was_planned_within_the_limits(outcome):
    robot = load_robot([outcome / 'believed_robot.yaml'])
    limits = load_limits([ROOT / 'config' / 'bridge.yaml'], robot.joints)
    plan = json.loads((outcome / '1' / 'plan.json').read_text())
    found = read_recording(outcome / '1' / 'bag', robot.joints, robot.motors)
    assert found.time[-1] - found.time[0] > plan['best']['duration']
    assert np.all(found.q_link <= limits.upper) and np.all(found.q_link >= limits.lower)
    values, _ = read_values([outcome / '1' / 'trajectory.yaml'])
    if values['trajectory.type'] == 'sinusoid':
        asked = [values[f'trajectory.{joint}.amplitude'] for joint in robot.joints]
        reached = np.nanmax(np.abs(found.reference[:, 0]), axis=0)
        assert np.all(reached >= np.array(asked) - 0.02)  # braking at the end goes farther
        assert np.all(reached <= np.minimum(limits.upper, -limits.lower))
