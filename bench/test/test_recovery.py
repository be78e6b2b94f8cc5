# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Trials of a recovery: what is counted, and that they are kept."""

import json
import math

from bench.__main__ import main
from bench.recover import as_values, from_values, recovered, table, Trial
from gms_flex_control.identification.outcome import Estimate, Interval
from gms_flex_control.schema.build import controller_values
from gms_flex_control.schema.files import save_robot, save_values
from identified_axis import axis, GAINS
import pytest


def trial(seed, value, *, curve=0.01, flags=()):
    """Return a Trial of one parameter whose truth is 1 and whose intervals are +-0.1."""
    around = Interval(*([math.nan] * 2 if flags else [value - 0.1, value + 0.1]))
    estimate = Estimate('friction.joint1.forward.static', 'N m', value, around, flags, '')
    return Trial(seed, ((estimate, 1.0),), (6,), (curve,), 1.0)


def test_intervals_that_hold_the_truth_are_counted():
    """Of 0.95, 1.02, 1.2 and 1.3, the last without an interval, two are within 0.1 of 1."""
    row, = recovered([trial(0, 0.95), trial(1, 1.02), trial(2, 1.2),
                      trial(3, 1.3, flags=('not identifiable',))])
    assert (row.covered, row.identified) == pytest.approx((2 / 3, 3 / 4))
    assert (row.middle, row.worst) == pytest.approx((1.11, 0.3))
    assert '67 %' in table([row])


def test_a_trial_is_the_same_after_json():
    """Intervals without end, and flags, included."""
    one = trial(3, 0.9, flags=('at bound', 'not identifiable'))
    estimate, true = one.estimates[0]
    wide = estimate._replace(interval=Interval(-math.inf, math.inf))
    one = one._replace(estimates=((wide, true),))
    text = json.dumps(as_values(one), allow_nan=False)
    assert from_values(json.loads(text)) == one


PLAN = """
identification:
  experiments: [constant_velocity, break_away]
  speeds: 4
  repeats: 1
  dwell_time: 0.3
  counts: 6.0
  rest_time: 0.1
  torque_rate: 0.5
  break_away_repeats: 1
  joint1: {lower: -1.6, upper: 1.6, velocity: 2.5, acceleration: 6.0}
"""


@pytest.fixture
def recover(tmp_path):
    """Return a function that recovers a rigid axis, one seed; it returns figures and journal."""
    robot = axis(rigid=True)
    save_robot(robot, tmp_path / 'robot.yaml')
    save_values(controller_values(GAINS, robot.joints), tmp_path / 'controller.yaml')
    (tmp_path / 'plan.yaml').write_text(
        '/**:\n  ros__parameters:' + PLAN.replace('\n', '\n    ').rstrip() + '\n')
    files = [word for name in ('robot', 'controller', 'plan')
             for word in (f'--{name}', str(tmp_path / f'{name}.yaml'))]

    def run(*options):
        out = tmp_path / 'out'
        assert main(['recover', *files, '--seeds', '1', '--rate', '200', '--out', str(out),
                     *options]) in (0, 1)
        return (out / 'recovery.json').read_text(), out / 'outcomes.jsonl'
    return run


def test_a_recovery_asked_for_again_comes_from_its_journal(recover):
    figures, journal = recover()
    kept = journal.read_text()
    assert json.loads(figures)['seeds'] == [0] and len(kept.splitlines()) == 1
    assert recover('--workers', '1')[0] == figures and journal.read_text() == kept
