# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What the identification node sees of the robot, and when it calls it off."""

from pathlib import Path

from bench.identification_simulated import read_identification_plan
from gms_flex_control.schema.files import load_controller, load_robot
from node_harness import joint_state
import pytest

messages = pytest.importorskip('gms_flex_control.nodes.messages')
experiment_watch = pytest.importorskip('gms_flex_control.nodes.step_runner')

CONFIG = Path(__file__).parents[1] / 'config'
DEMO = CONFIG.parent / 'bench' / 'demos' / 'identification.yaml'
ROBOT = load_robot(CONFIG / 'robot.yaml')
PLAN = read_identification_plan([DEMO], ROBOT, load_controller(
    CONFIG / 'controller.yaml', ROBOT))
PERIOD = 2_000_000


@pytest.fixture
def watch():
    return experiment_watch.Watch(PLAN)


def moved(watch, speed, *, samples=100, q=0.0, begin=0):
    """Feed states of joint1 moving at ``speed`` [rad/s]."""
    for k in range(samples):
        angle = q + speed * k * PERIOD * 1e-9
        watch.take(joint_state(begin + k * PERIOD, (angle, 0.0, angle, 0.0)))


def test_it_knows_time_rate_place_and_travel(watch):
    moved(watch, 0.5)
    assert watch.stamp == 99 * PERIOD and watch.samples == 100
    assert watch.period == pytest.approx(2e-3)
    watch.mark()
    moved(watch, -0.5, q=watch.q_link[0], begin=watch.stamp + PERIOD)
    assert watch.travel(0) == pytest.approx(0.5 * 99 * 2e-3)
    assert watch.travel(1) == 0.0 and watch.fault is None


@pytest.mark.parametrize(('speed', 'q', 'sentence'), [
    (1.6, 0.0, 'joint1 moves at 1.6 rad/s, the limit is 1.2 rad/s: zero torque'),
    (0.1, -1.25, 'joint1 is at -1.25 rad, outside its range -1.2 to 1.2 rad: zero torque')])
def test_a_limit_passed_is_a_fault_while_it_is_on_guard(watch, speed, q, sentence):
    moved(watch, speed, q=q)
    assert watch.fault is None
    watch.guarded = True
    moved(watch, speed, q=q, begin=watch.stamp + PERIOD)
    assert watch.fault == sentence


def test_encoder_counts_and_the_limit_itself_are_no_fault(watch):
    watch.guarded = True
    moved(watch, 1.2)
    for k in range(200):  # a count forth and back at each sample is 0.16 rad/s
        watch.take(joint_state(watch.stamp + PERIOD, (0.24 + 3.14e-4 * (k % 2), 0, 0, 0)))
    assert watch.fault is None


def test_a_state_sent_again_counts_once_and_a_bad_one_not_at_all(watch):
    moved(watch, 0.0, samples=3)
    watch.take(joint_state(watch.stamp))
    assert watch.samples == 3
    for bad in (joint_state(9 * PERIOD, (float('nan'), 0, 0, 0)),
                joint_state(9 * PERIOD, (0.0,), names=['joint1']),
                joint_state(9 * PERIOD, (0.0,))):
        with pytest.raises(messages.RefusedError):
            watch.take(bad)
    assert watch.samples == 3
