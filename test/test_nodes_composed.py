# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Plant or bridge, controller and trajectory in one process: as three, and to the last bit."""

import os
from pathlib import Path
import re

from bridge_lab import bridge_lab, move
from gms_flex_control.data.reader import read_recording
from gms_flex_control.experiment.driven import executable, TOPICS
from gms_flex_control.experiment.simulated import read_plan, simulate_to_bag
from node_harness import COMMANDS, JointState, Lab, MOTION, REFERENCE, stamp_of, STATES, TERM
import numpy as np
import pytest
from test_nodes_lockstep import assert_equal
from test_nodes_loop import (  # noqa: F401  what no lockstep shows holds here as well
    listen,
    RATE,
    test_a_gain_changes_and_a_whole_number_is_taken_for_a_double,
    test_controller_publishes_error_estimate_and_blocks,
)


@pytest.fixture(scope='module')
def loop(tmp_path_factory):
    """Run the loop in one process, moving along the sinusoid; yield a Lab as test_nodes_loop."""
    with Lab(tmp_path_factory.mktemp('loop')) as lab:
        lab.controller = lab.trajectory = lab.plant = lab.start(
            'loop_node', files=MOTION, rate=RATE, trajectory__autostart=True, silence_timeout=1.0)
        listen(lab)
        yield lab


def test_each_state_is_answered_once_and_nothing_is_heard_twice(loop):
    loop.more(loop.states, 100)
    stamps = [stamp_of(command) for command in loop.commands
              if any(command.data)]  # zero is sent again where the whole process stood still
    assert len(set(stamps)) == len(stamps) > 100
    assert 'at once' not in loop.plant.printed()  # two controllers, or two trajectories


def test_names_topics_and_services_are_those_of_three_nodes(loop):
    names = {'plant', '_plant_safety', 'cascade_controller', 'trajectory'}
    assert names <= set(loop.node.get_node_names())
    for name, topics in {
            'plant': {STATES}, 'trajectory': {REFERENCE},
            'cascade_controller': {COMMANDS, *(f'/cascade_controller/{what}' for what in (
                'state', 'blocks', 'sticking'))}}.items():
        assert topics <= {topic for topic, _ in
                          loop.node.get_publisher_names_and_types_by_node(name, '/')}
    for name, topics in {'plant': {COMMANDS}, 'trajectory': {STATES},
                         'cascade_controller': {STATES, REFERENCE}}.items():
        assert topics <= {topic for topic, _ in
                          loop.node.get_subscriber_names_and_types_by_node(name, '/')}


def test_a_signal_leaves_zero_torque(loop):  # the last with it: no loop runs beside other tests
    assert loop.plant.signal(TERM) == 0
    loop.until(lambda: not any(loop.commands[-1].data))


def test_lockstep_in_one_process_is_the_simulation_to_the_last_bit(tmp_path):
    with Lab(tmp_path) as lab:
        recorder = lab.run([*executable('gms_flex'), 'record', '--topics', *TOPICS, '--out',
                            str(tmp_path / 'driven')], 'recorder')
        loop = lab.start('loop_node', files=MOTION, trajectory__autostart=True, mode='lockstep',
                         rate=500.0, duration=3.0, wait_for_subscribers=3)
        assert loop.wait() == 0
        assert recorder.signal(TERM) == 0
        heard = [line for line in recorder.printed().splitlines() if 'subscribed to' in line]
        assert STATES in heard[-1]  # the plant begins then: every answer is heard by then
    plan = read_plan(MOTION, duration=3.0, overrides={'compensation': 'gms', 'rate': 500.0})
    simulate_to_bag(plan, tmp_path / 'simulated')
    driven, simulated = (read_recording(tmp_path / name, plan.robot.joints, plan.robot.motors)
                         for name in ('driven', 'simulated'))
    assert len(driven.time) == 1500 and np.ptp(driven.q_link[:, 0]) > 0.3  # it moved
    assert_equal(driven, simulated)


def test_a_recorder_interrupts_no_loop_and_wakes_it_seldom(lab, tmp_path):
    recorder = lab.run([*executable('gms_flex'), 'record', '--topics', *TOPICS, '--out',
                        str(tmp_path / 'bag')], 'recorder')
    loop = lab.start('loop_node', files=MOTION, trajectory__autostart=True, rate=1000.0,
                     wait_for_subscribers=3)
    lab.states = lab.listen(JointState, STATES)
    lab.until(lambda: len(lab.states) > 100)
    assert {os.sched_getscheduler(thread) for thread in (
        recorder.process.pid, *threads(recorder, 'dds'))} == {os.SCHED_BATCH}
    events, = threads(loop, 'dds.ev')
    assert os.sched_getscheduler(loop.process.pid) == os.SCHED_OTHER
    assert os.sched_getscheduler(events) == os.SCHED_BATCH
    # of messages that have to be acknowledged; there are six to a state
    before, first = wakes(events), stamp_of(lab.states[-1])
    lab.more(lab.states, 1000)
    samples = (stamp_of(lab.states[-1]) - first) / 1_000_000
    assert wakes(events) - before < 3 * samples
    assert recorder.signal(TERM) == loop.signal(TERM) == 0


def threads(started, name):
    """Return the numbers of the threads of a process whose names begin so."""
    return [int(path.name) for path in Path(f'/proc/{started.process.pid}/task').iterdir()
            if (path / 'comm').read_text().startswith(name)]


def wakes(thread):
    """Return how often a thread has slept so far."""
    return int(re.search(r'\nvoluntary_ctxt_switches:\s+(\d+)',
                         Path(f'/proc/{thread}/status').read_text())[1])


@pytest.mark.flaky(reruns=5)  # a machine that stands still for 30 ms stops the torque
def test_a_bridge_in_one_process_moves_a_robot_and_leaves_zero(tmp_path):
    with bridge_lab(tmp_path, composed=True) as lab:
        move(lab)
        figures = lab.until(lambda: next((
            values for one in lab.reports if 'efforts sent ahead' in (
                values := {item.key: item.value for item in one.values})), None))
        assert int(figures['efforts sent ahead']) > 0 == int(figures['efforts corrected'])
        assert lab.plant.signal(TERM) == 0
        lab.until(lambda: not any(lab.efforts.last))


def test_a_profile_that_lets_nodes_hear_their_own_process_is_refused(tmp_path):
    profile = tmp_path / 'profile.xml'
    profile.write_text('<dds/>')
    with Lab(tmp_path) as lab:
        lab.environment['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(profile)
        loop = lab.start('loop_node', files=MOTION)
        assert loop.wait() == 2
        assert 'loop_node needs the property fastdds.ignore_local_endpoints' in loop.printed()
