# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The bridge between the real controller and a robot of ros2_control conventions, as processes."""

from functools import partial
import os
from pathlib import Path
import signal
import time

from bench.faults import broken_node
from bridge_lab import (
    ask,
    assert_fault_within,
    bridge_lab,
    enable,
    fault,
    fault_of,
    move,
    report,
    start_controller,
    time_to_zero,
)
from gms_flex_control.nodes.messages import to_nanoseconds
from node_harness import Float64MultiArray, JointState, Trigger
import numpy as np
import pytest
from ros2_control_robot import EFFORTS, MAPPING, START
from std_msgs.msg import Bool

SILENCE_BOUND, STOP_BOUND, STATE_TIMEOUT = 0.1, 0.02, 0.3  # [s]
GUARDED = 0.15  # the guardian waits for 50 ms [s]


def test_an_exception_is_one_traceback_zero_torque_and_a_fault(tmp_path):
    """The function raises once, some seconds after the start, and the bridge can go on."""
    place = 'gms_flex_control.hardware.bridge:Bridge.take_command'
    with bridge_lab(tmp_path, plant=broken_node.command('plant_node', place, 700)) as lab:
        lab.tracebacks = 1
        lab.until(lambda: lab.efforts and lab.states)
        said = f'on_command raised RuntimeError: {broken_node.SENTENCE}'
        lab.until(lambda: said in move_on(lab))
        lab.until(lambda: not any(lab.efforts.last))
        assert lab.plant.printed().count('Traceback') == 1
        move(lab)


def test_efforts_go_out_as_joint_states_as_well_and_end_in_zero(tmp_path):
    """
    By the names of the robot's actuators; the guardian ends them as it ends the array.

    It has the priority of the bridge, which reports another program that sends efforts.
    """
    mapping = MAPPING.replace('effort: {sign', 'effort: {name: m1, sign').replace(
        'motor: {name: m2}', 'motor: {name: m2}\n    effort: {name: m2}')
    with bridge_lab(tmp_path, mapping=mapping, bridge__command_type='both',
                    realtime_priority=1) as lab:
        commands = lab.listen(JointState, '/robot/joint_commands')
        lab.until(lambda: lab.efforts and lab.states)
        move(lab)
        lab.more(commands, 100)
        sent = {tuple(data) for _, data in lab.efforts}
        named = [command for command in commands[:-10] if any(command.effort)]
        assert named and all(list(command.name) == ['m2', 'm1'] for command in named)
        # either topic may lose a message in a process that is late
        assert np.mean([tuple(command.effort) in sent for command in named]) > 0.8
        assert all(to_nanoseconds(command.header.stamp) > 0 for command in named)
        lab.speak(Float64MultiArray, EFFORTS)
        lab.until(lambda: f'1 more publish on {EFFORTS} and ' in lab.plant.printed())
        children = Path(f'/proc/{lab.plant.process.pid}/task').glob('*/children')
        guardian, = {int(pid) for file in children for pid in file.read_text().split()}
        lab.until(lambda: 'no realtime_priority 1' in lab.plant.printed()
                  or os.sched_getscheduler(guardian) == os.SCHED_FIFO)
        lab.plant.process.send_signal(signal.SIGKILL)
        lab.until(lambda: not any(commands[-1].effort))
        lab.plant.kill()


def move_on(lab):
    """Let the robot move until the next fault and return what the plant has printed."""
    if not fault_of(lab):
        ask(lab, 'reset')
        ask(lab, 'enable')
        ask(lab, '/trajectory/start')
    else:
        del lab.reports[:]
    return lab.plant.printed()


@pytest.fixture(scope='module')
def lab(tmp_path_factory):  # behind tests without it, which it would slow down
    """Run robot, bridge, controller and trajectory."""
    with bridge_lab(tmp_path_factory.mktemp('bridge')) as running:
        running.button = running.speak(Bool, '/emergency_stop')
        stop = running.node.create_client(Trigger, '/plant/emergency_stop')
        running.stop = stop.call_async
        running.until(lambda: running.efforts and running.states and stop.service_is_ready())
        yield running
        for process in (running.plant, running.controller, running.trajectory):
            assert process.runs


def revive(lab):
    """Start a controller if there is none any more."""
    if not lab.controller.runs:
        lab.births = getattr(lab, 'births', 0) + 1
        start_controller(lab, f'controller_node.{lab.births}')


def replace(lab):
    """Start another controller; a killed one takes a moment to be gone."""
    lab.controller.kill()
    revive(lab)


@pytest.fixture(autouse=True)
def sound(request):
    """Begin every test with all processes awake and the button released, whatever was before."""
    if 'lab' in request.fixturenames:
        running = request.getfixturevalue('lab')
        revive(running)
        for process in (running.robot, running.controller.process, running.plant.process):
            process.send_signal(signal.SIGCONT)
        running.button.publish(Bool(data=False))


def test_zero_until_enabled_then_the_measured_state_is_held(lab):
    assert len(lab.efforts) and not any(any(data) for _, data in lab.efforts)
    enable(lab)
    begin = len(lab.states)
    lab.more(lab.states, 250)
    held = np.array([state.position for state in lab.states[begin:]])
    # names, signs, gear and offset undone; joint 1 without velocity, joint 2 with
    np.testing.assert_allclose(held, np.broadcast_to([*START, *START], held.shape), atol=0.02)
    assert list(lab.states[-1].name) == ['joint1', 'joint2', 'joint1_motor', 'joint2_motor']


def test_what_takes_torque_away_while_it_is_asked_for_prevails(lab):
    """~/enable waits for the reference to hold, of a process that stands still meanwhile."""
    enable(lab)
    assert ask(lab, 'disable').success
    lab.trajectory.process.send_signal(signal.SIGSTOP)
    try:
        waiting = lab.clients['/plant/enable'].call_async(Trigger.Request())
        lab.until(lambda: 'already waits' in ask(lab, 'enable').message or waiting.done())
        assert ask(lab, 'disable').message == 'ZERO'
    finally:
        lab.trajectory.process.send_signal(signal.SIGCONT)
    lab.until(waiting.done)
    answer = waiting.result()
    assert not answer.success and 'not enabled: ' in answer.message
    flowing = len(lab.efforts)
    lab.more(lab.efforts, 30)
    assert not any(any(data) for _, data in lab.efforts[flowing:])


def test_a_frozen_controller_is_zero_torque_and_a_fault_that_says_how_long(lab):
    name = f'no command from /cascade_controller#{lab.controller.process.pid} for '
    freeze, thaw = (partial(lab.controller.process.send_signal, number)
                    for number in (signal.SIGSTOP, signal.SIGCONT))
    try:
        assert_fault_within(SILENCE_BOUND, lab, freeze, f'FAULT: {name}', undo=thaw)
        assert not ask(lab, 'enable').success
    finally:
        thaw()
    report(lab, 'they come again')
    assert not any(lab.efforts.last)  # latched


def test_a_killed_controller_is_zero_torque_and_a_new_one_takes_over_after_a_reset(lab):
    kill = partial(lab.controller.process.send_signal, signal.SIGKILL)
    assert_fault_within(SILENCE_BOUND, lab, kill, 'FAULT: no ', undo=partial(replace, lab))
    assert 'no command from' in ask(lab, 'reset').message + ask(lab, 'enable').message
    replace(lab)
    move(lab)


def test_an_emergency_stop_is_zero_at_once_latched_and_survives_a_new_controller(lab):
    release = partial(lab.button.publish, Bool(data=False))
    press = (lambda: lab.button.publish(Bool(data=True)), lambda: lab.stop(Trigger.Request()))
    for way in press:
        assert_fault_within(STOP_BOUND, lab, way, 'FAULT: emergency stop by', undo=release)
        release()
        lab.more(lab.states, 10)
        assert 'emergency stop by' in ask(lab, 'enable').message  # latched
    replace(lab)
    commands = lab.hear('commands')
    lab.until(lambda: len(commands) > 50)
    assert 'emergency stop by' in ask(lab, 'enable').message and not any(lab.efforts.last)
    lab.button.publish(Bool(data=True))
    lab.until(lambda: 'release the button' in ask(lab, 'reset').message)
    lab.button.publish(Bool(data=False))
    lab.until(lambda: ask(lab, 'reset').success)


def test_a_robot_that_stops_speaking_is_zero_torque(lab):
    freeze, thaw = (partial(lab.robot.send_signal, number)
                    for number in (signal.SIGSTOP, signal.SIGCONT))
    try:
        assert_fault_within(STATE_TIMEOUT + SILENCE_BOUND, lab, freeze,
                            'FAULT: no new joint states for ', undo=thaw)
    finally:
        thaw()


def test_the_last_word_is_zero(lab):
    move(lab)
    assert any(lab.efforts.last)
    assert lab.plant.signal(signal.SIGTERM) == 0
    lab.until(lambda: not any(lab.efforts.last))
    lab.plant = lab.start('plant_node.second', files=lab.files, **lab.given)
    lab.until(lambda: 'ZERO' in lab.plant.printed())
    lab.stop = lab.node.create_client(Trigger, '/plant/emergency_stop').call_async


def test_a_frozen_bridge_leaves_zero_and_stops_when_it_is_back(lab):
    def freeze():
        begin = time.monotonic()
        lab.plant.process.send_signal(signal.SIGSTOP)
        try:
            assert time_to_zero(lab, begin, lab.driven) < GUARDED
        finally:
            lab.plant.process.send_signal(signal.SIGCONT)
    fault(lab, freeze, 'FAULT: the bridge stood still for ')


def test_a_killed_bridge_leaves_zero(lab):
    move(lab, lambda: any(lab.driven.last))
    begin = time.monotonic()
    lab.plant.process.send_signal(signal.SIGKILL)
    assert time_to_zero(lab, begin, lab.driven) < GUARDED
    lab.plant.kill()
    lab.plant = lab.start('plant_node.last', files=lab.files, **lab.given)
    lab.until(lambda: 'ZERO' in lab.plant.printed())
