# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Two processes run a node of one name: the later one ends, and nothing is heard of it."""

import re

from bridge_lab import bridge_lab, EFFORTS, enable, fault_of
from node_harness import Lab, MOTION, stamp_of
import numpy as np
import pytest

DiagnosticArray = pytest.importorskip('diagnostic_msgs.msg').DiagnosticArray
PERIOD = 5_000_000  # [ns]
THREE = ['plant_node', 'controller_node', 'trajectory_node']
RUNS = r'/\w+ runs already, as process \d+ on .+: end it, or start this one in another namespace'


def start(lab, name, number='', **parameters):
    """Start a node of the loop; the arm moves as soon as all are there."""
    return lab.start(f'{name}.{number}', files=MOTION, rate=1e9 / PERIOD, silence_timeout=1.0,
                     trajectory__autostart=True, **parameters)


@pytest.mark.parametrize('name', ['plant_node', 'trajectory_node'])
def test_of_two_that_start_at_once_one_is_left(tmp_path, name):
    with Lab(tmp_path) as lab:
        both = [start(lab, name, number) for number in 'ab']
        lab.until(lambda: not all(process.runs for process in both))
        lab.until(lambda: sum(process.runs for process in both) == 1)
        ended, = (process for process in both if not process.runs)
        left, = (process for process in both if process.runs)
        assert ended.wait() == 2 and len(re.findall(RUNS, ended.printed())) == 1
        assert f'process {left.process.pid} on' in ended.printed()
        heard = lab.listen(DiagnosticArray, '/diagnostics')
        lab.more(heard, 2)
        assert left.runs


def test_a_node_that_was_killed_stands_in_nobodys_way(tmp_path):
    with Lab(tmp_path) as lab:
        states = lab.hear('states')
        first = start(lab, 'plant_node')
        lab.until(lambda: states)
        first.kill()
        second = start(lab, 'plant_node', 'again')
        lab.more(states, 200)
        assert second.runs


@pytest.mark.flaky(reruns=2)  # a machine too busy discovers the first too late
def test_a_second_bridge_leaves_the_torque_of_the_first_alone(tmp_path):
    with bridge_lab(tmp_path, silence_timeout=1.0, bridge__state_timeout=1.0) as lab:
        enable(lab)
        publishers = lab.node.count_publishers(EFFORTS)
        second = lab.start('plant_node.second', files=lab.files, **lab.given)
        most = []
        lab.until(lambda: most.append(lab.node.count_publishers(EFFORTS)) or not second.runs)
        assert second.wait() == 2 and re.search(RUNS, second.printed())
        assert max(most) == publishers  # neither a bridge nor a guardian came
        lab.more(lab.efforts, 50)
        assert lab.plant.runs
        assert ' at once' not in fault_of(lab)  # a busy machine may make other faults


@pytest.fixture(scope='module')
def lab(tmp_path_factory):  # behind tests without it, which it would slow down
    """Run the loop along its sinusoid."""
    with Lab(tmp_path_factory.mktemp('namesakes')) as running:
        running.first = [start(running, name) for name in THREE]
        running.states, running.commands = running.hear('states', 'commands')
        running.until(lambda: running.commands and running.states
                      and max(running.states[-1].effort[2:]) > 0.01)
        yield running


@pytest.mark.parametrize('name', [*THREE, 'loop_node'])
def test_a_second_node_of_one_name_ends_with_a_sentence_and_says_nothing(lab, name):
    begin = len(lab.states)
    second = start(lab, name, 'second')
    lab.until(lambda: not second.runs)
    assert second.wait() == 2
    # on a busy machine it says as well that it takes long
    assert re.fullmatch(rf'(.*: still starting: .*\n)?{name}: {RUNS}.*\n', second.printed())
    lab.more(lab.states, 50)
    lab.more(lab.commands, 50)
    assert all(process.runs for process in lab.first)
    assert 'at once' not in ''.join(process.printed() for process in lab.first)
    stamps = np.array([stamp_of(state) for state in lab.states[begin:]])
    # one arm: whole samples lie between its states, whatever a busy machine leaves out
    assert (np.diff(stamps) > 0).all() and len(set(stamps % PERIOD)) == 1
    senders = {dim.label for command in lab.commands for dim in command.layout.dim
               if dim.label.startswith('source:')}
    assert len(senders) == 1


def test_another_namespace_is_another_robot(lab):
    other = lab.start('plant_node.left', files=MOTION, arguments=('-r', '__ns:=/left'))
    lab.until(lambda: 'joints, ' in other.printed())
    assert other.signal(2) == 0


def test_reports_of_others_and_broken_ones_end_nothing(lab):
    """Of a name that ours is part of, without marks, with marks that make no number."""
    speak = lab.speak(DiagnosticArray, '/diagnostics')
    lab.until(lambda: speak.get_subscription_count() >= 3)
    heard = lab.listen(DiagnosticArray, '/diagnostics')
    lab.until(lambda: any(status.hardware_id == '/plant' for one in heard
                          for status in one.status))
    plant = next(status for one in heard for status in one.status
                 if status.hardware_id == '/plant')
    marks = {pair.key: pair for pair in plant.values if 'since' in pair.key}
    assert list(marks) == ['running since [ns]']
    for name, since in (('/left/plant', '1'), ('/plant', ''), ('/plant', '-1'),
                        ('/plant', 'x'), ('/plant', '9' * 5000)):
        plant.hardware_id = name
        marks['running since [ns]'].value = since
        speak.publish(DiagnosticArray(status=[plant]))
    plant.values = []
    speak.publish(DiagnosticArray(status=[plant]))
    lab.more(lab.states, 100)
    assert all(process.runs for process in lab.first)
    assert not any('FAULT' in process.printed() for process in lab.first)
