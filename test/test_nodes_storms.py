# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Bursts of messages of no use: what matters among them is heard; and priority over others."""

from functools import partial
import os

from bridge_lab import ask
from gms_flex_control.nodes.health import Health
from gms_flex_control.nodes.messages import EFFORT, ReferenceWriter
from gms_flex_control.nodes.topics import all_waiting, Direct, Inbox, Outlet
from node_harness import (
    array_message,
    COMMANDS,
    EventsExecutor,
    Float64MultiArray,
    joint_state,
    JointState,
    Lab,
    rclpy,
    REFERENCE,
    stamp_of,
    STATES,
)
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Bool

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)

PERIOD = 2_000_000   # [ns]
BURST = 120          # messages; a socket holds more than those
ROUNDS = 20
POSITION = (0.1, 0.2, 0.15, 0.25)
TORQUE = np.array([[0.01, -0.02]])


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run a controller alone in real time; it has answered once."""
    with Lab(tmp_path_factory.mktemp('storms')) as running:
        running.controller = running.start('controller_node')
        running.states = running.speak(JointState, STATES)
        running.references = running.speak(Float64MultiArray, REFERENCE)
        running.commands = running.listen(Float64MultiArray, COMMANDS)
        running.stamp, running.writer = 10 ** 9, ReferenceWriter(2, '/test')
        running.until(lambda: running.states.get_subscription_count()
                      and running.references.get_subscription_count())
        running.until(lambda: send_state(running) or running.commands)
        yield running
        assert running.controller.runs and 'Traceback' not in running.controller.printed()


def send_state(lab):
    """Publish the next joint state."""
    lab.stamp += PERIOD
    lab.states.publish(joint_state(lab.stamp, POSITION))


def answer(lab):
    """Wait for the command that answers the last state."""
    return lab.until(lambda: [command for command in lab.commands
                              if stamp_of(command) == lab.stamp])[0]


def test_a_state_before_a_burst_of_others_on_its_topic_is_answered(lab):
    odd = joint_state(0, names=['other'] * 4)
    for _ in range(ROUNDS):
        send_state(lab)
        for _ in range(BURST):
            lab.states.publish(odd)
        answer(lab)
    assert 'joint state refused' in lab.controller.printed()


def test_what_waits_behind_a_burst_on_another_topic_is_looked_at_before_its_end(lab):
    """An executor hands out the burst's events first; inboxes of a node do not wait for them."""
    heard, boxes = [], []
    node = rclpy.create_node('hearer', context=lab.node.context)
    node.health, node.direct = Health(node), Direct()
    executor = EventsExecutor(context=lab.node.context)
    executor.add_node(node)
    for topic in ('burst', 'single'):
        Inbox(node, JointState, topic, lambda message, topic=topic: heard.append(topic) or True,
              boxes=boxes)
    burst, single = (lab.speak(JointState, topic) for topic in ('burst', 'single'))
    seen = lab.listen(JointState, 'single')
    lab.until(lambda: burst.get_subscription_count() and single.get_subscription_count() == 2)
    try:
        executor.spin_once(timeout_sec=0.1)
        for _ in range(BURST):
            burst.publish(joint_state(0))
        single.publish(joint_state(0))
        lab.until(lambda: seen)  # so it waits at the node as well
        while not heard:
            executor.spin_once(timeout_sec=0.1)
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
    assert heard[-1] == 'single' and len(heard) < BURST // 4  # behind the newest of the burst


def test_who_speaks_or_listens_after_the_end_of_its_node_gets_an_error(lab):
    """A callback that outlasts the end of a process must not touch memory that is free."""
    node = rclpy.create_node('ended', context=lab.node.context)
    node.direct = Direct()
    outlet = Outlet(node, JointState, 'ended')
    subscription = node.create_subscription(JointState, 'ended', print, 1, raw=True)
    node.destroy_node()
    for call in (partial(outlet._publish, serialize_message(joint_state(0))),
                 outlet.count_others, partial(list, all_waiting(subscription, 1))):
        with pytest.raises(RuntimeError, match='pointer is invalid'):
            call()


def test_a_message_too_long_for_any_robot_is_refused_unread(lab):
    long = joint_state(0, [0.1] * 10**5, names=[f'joint{k}' for k in range(10**5)])

    def is_refused():
        lab.states.publish(long)
        return '/joint_states: a message of ' in lab.controller.printed()
    lab.until(is_refused)
    send_state(lab)
    answer(lab)


def test_bytes_that_are_no_message_are_refused_without_a_fault(lab):
    def is_refused():
        for data in (b'', b'\0\1\0\0', serialize_message(joint_state(0))[:-1]):
            lab.states.publish(data)
        return '/joint_states: 4 bytes are refused' in lab.controller.printed()
    lab.until(is_refused)
    send_state(lab)
    answer(lab)
    assert 'FAULT' not in lab.controller.printed()


@pytest.mark.parametrize('odd', [
    array_message([0.1] * 10, 'stamp:-1000000000000'), array_message([float('nan')] * 10)])
def test_a_reference_before_a_burst_of_others_is_followed(lab, odd):
    followed = 0
    for _ in range(ROUNDS):
        lab.references.publish(lab.writer.write(TORQUE, EFFORT, lab.stamp + PERIOD))
        for _ in range(BURST):
            lab.references.publish(odd)
        send_state(lab)
        followed += list(answer(lab).data) == TORQUE[0].tolist()
    assert followed >= ROUNDS // 2  # topics may overtake each other


def test_a_button_pressed_once_in_a_burst_of_releases_is_heard(tmp_path):
    with Lab(tmp_path) as lab:
        plant, lab.clients = lab.start('plant_node', rate=200.0, silence_timeout=1.0), {}
        button = lab.speak(Bool, '/emergency_stop')
        lab.until(button.get_subscription_count)
        for count in range(1, 6):
            for k in range(BURST):
                button.publish(Bool(data=k == BURST // 2))
            lab.until(lambda count=count: plant.printed().count('FAULT') >= count)
            lab.until(lambda: ask(lab, 'reset').success)


@pytest.mark.parametrize('name', ['plant_node', 'controller_node', 'trajectory_node'])
def test_a_priority_holds_for_every_thread_or_is_said_to_be_impossible(tmp_path, name):
    with Lab(tmp_path) as lab:
        node = lab.start(name, realtime_priority=1)
        lab.until(lambda: 'INFO' in node.printed() or 'WARN' in node.printed())
        lab.until(lambda: 'no realtime_priority 1' in node.printed() or all(
            os.sched_getscheduler(int(thread)) == os.SCHED_FIFO
            for thread in os.listdir(f'/proc/{node.process.pid}/task')))
