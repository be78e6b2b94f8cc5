# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What an experiment remembers: finished steps, break-away torques; and what space it needs."""

from pathlib import Path

from gms_flex_control.errors import BagError
from gms_flex_control.experiment.identification_plan import (
    Adaptation,
    ExperimentError,
    Journal,
    read_identification_plan,
    require_space,
)
from gms_flex_control.schema.files import load_controller, load_robot
import pytest

CONFIG = Path(__file__).parents[1] / 'config'
DEMO = CONFIG.parent / 'bench' / 'demos' / 'identification.yaml'
ROBOT = load_robot(CONFIG / 'robot.yaml')
GAINS = load_controller(CONFIG / 'controller.yaml', ROBOT)


def planned(**overrides):
    changed = {f'identification.{key}': value for key, value in overrides.items()}
    return read_identification_plan([DEMO], ROBOT, GAINS, overrides=changed)


def test_a_journal_is_read_back_and_names_bags_beside_the_first(tmp_path):
    plan, bag = planned(), tmp_path / 'bag'
    journal = Journal(bag, plan)
    assert journal.next_bag() == bag
    bag.mkdir()
    journal.found['joint1'] = 0.1
    journal.finish(plan.experiments[0].name)
    again = Journal(bag, plan, resume=True)
    assert again.finished == [plan.experiments[0].name] and again.found == {'joint1': 0.1}
    assert again.next_bag() == tmp_path / 'bag_2'
    assert again.bags == ['bag', 'bag_2']


def test_what_cannot_be_begun_or_resumed_is_said(tmp_path):
    plan, bag = planned(), tmp_path / 'bag'
    with pytest.raises(ExperimentError, match='journal.json: cannot be read'):
        Journal(bag, plan, resume=True)
    Journal(bag, plan).next_bag()
    with pytest.raises(ExperimentError, match='has been recorded already; set'):
        Journal(bag, plan)
    with pytest.raises(ExperimentError, match='belongs to another plan'):
        Journal(bag, planned(speeds=5), resume=True)
    for text in ('', '[]', '{"plan": 1}', '{"plan": "x", "finished": 3, "bags": [], "found": {}}'):
        (tmp_path / 'bag.journal.json').write_text(text)
        with pytest.raises(ExperimentError, match='is no journal of an experiment'):
            Journal(bag, plan, resume=True)


def test_a_journal_that_cannot_be_written_is_an_error_of_the_bag(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot be written'):
        Journal(tmp_path / 'file' / 'bag', planned()).next_bag()


def test_a_recording_needs_space(tmp_path):
    require_space(tmp_path / 'not' / 'yet', 1000)
    with pytest.raises(ExperimentError, match=r'MB free and the recording needs about \d+ MB'):
        require_space(tmp_path, 1e18)


def test_amplitudes_follow_the_least_break_away_torque():
    plan = planned()
    adaptation = Adaptation(plan)
    broken = next(step for step in plan.experiments if step.phase == 'break_away')
    slid = next(step for step in plan.experiments if step.phase == 'presliding')
    assert adaptation.applied_to(slid) == slid
    top = 0.5 * plan.trajectory(broken).end
    assert adaptation.broke_away(broken, 10 * top) == pytest.approx(abs(broken.value))
    half = adaptation.broke_away(broken, 0.5 * top)
    assert half == pytest.approx(0.5 * abs(broken.value))
    assert adaptation.found == {'joint1': half}
    adaptation.broke_away(broken, top)
    adapted = adaptation.applied_to(slid)
    factor = 0.85 * half / 0.10433
    assert adapted.value == pytest.approx(factor * slid.value)
    name = 'trajectory.joint1.levels'
    assert adapted.trajectory_parameters[name] == pytest.approx(
        [factor * level for level in slid.trajectory_parameters[name]])
    assert adaptation.applied_to(broken) == broken
    assert Adaptation(plan, {'joint1': 50.0}).applied_to(slid).value == pytest.approx(
        3.0 * slid.value)
    assert Adaptation(plan, {'joint1': 1e-9}).applied_to(slid).value == pytest.approx(
        0.2 * slid.value)
