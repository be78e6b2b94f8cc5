# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The identification demo, shortened: four node processes, a bag with phases, robots alike."""

import contextlib
from dataclasses import replace
import os
import pty
import subprocess

from bench.demos.hidden_effect import link_rms
from bench.demos.identify import tracking_of_copies
from gms_flex_control.cli.demo import plan_of
from gms_flex_control.experiment.simulated import mixed_error, simulate
import numpy as np
from processes import BENCH, environment_of
import pytest

PLAN = """/**:
  ros__parameters:
    identification:
      joints: [joint2]
      experiments: [break_away, sliding]
      break_away_repeats: 1
      torque_rate: 1.0
      sliding_speeds: [2.0]
      sliding_duration: 2.5
      rest_time: 0.05
"""


@pytest.fixture(scope='module')
def outcome(tmp_path_factory):
    """Run the short plan; return the folder and what was printed."""
    harness = pytest.importorskip('node_harness')
    domain, lock = harness.take_domain()
    folder = tmp_path_factory.mktemp('demo_identify')
    (folder / 'plan.yaml').write_text(PLAN)
    terminal, end = pty.openpty()
    process = subprocess.Popen(
        [*BENCH, 'demo-identify', '--out', str(folder / 'output'), '--plan',
         str(folder / 'plan.yaml')], text=True, stdout=subprocess.PIPE, stderr=end,
        env=environment_of(ROS_DOMAIN_ID=str(domain)))
    os.close(end)
    shown = shown_on(terminal)
    printed = process.communicate(timeout=200)[0]
    lock.close()
    assert process.returncode == 0, printed + shown
    return folder / 'output', printed, shown


def shown_on(terminal):
    """Return what comes on a pseudo terminal until its other end is closed."""
    parts = []
    with contextlib.suppress(OSError):  # which is how Linux reports the end
        while part := os.read(terminal, 4096):
            parts.append(part)
    os.close(terminal)
    return b''.join(parts).decode()


def test_progress_is_shown_step_by_step_up_to_the_end_on_a_terminal(outcome):
    _, printed, shown = outcome
    assert ' %, ' not in printed
    for text in ('4 steps on 1 joints over DDS', ' %, ', 's to go: break_away/joint2/+',
                 's to go: sliding/joint2/-', '100 %, done in'):
        assert text in shown


@pytest.fixture(scope='module')
def plan():
    """Return ten seconds of the polynomial motion."""
    return plan_of('polynomial', 'gms', duration=10.0)


def test_copies_without_a_difference_track_alike(plan):
    errors = tracking_of_copies(plan, plan.robot, count=2, spread=0.0)
    alone = link_rms(simulate(replace(plan, model=plan.robot), 'alone'))
    np.testing.assert_allclose(errors, [alone, alone], rtol=1e-12)


def test_every_belief_meets_the_same_robots(plan):
    believed = mixed_error(plan.robot)
    errors = [tracking_of_copies(plan, believed, count=4, spread=0.05, seed=seed)
              for seed in (3, 3, 4)]
    np.testing.assert_array_equal(errors[0], errors[1])
    assert (errors[0] != errors[2]).all() and np.ptp(errors[0], axis=0).all()
