# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Inboxes and outlets of a node: nothing waits behind others, all is read as it was written."""

from functools import partial
import os
import struct
from types import SimpleNamespace

from bridge_lab import ask
from gms_flex_control.nodes import health, messages, topics
from gms_flex_control.nodes.health import Health, Namesakes
from gms_flex_control.nodes.topics import Deserialized, Direct, Serialized
from node_harness import EventsExecutor, Float64MultiArray, joint_state, JointState, Lab, rclpy
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Bool, MultiArrayDimension

BURST = 120  # messages; a socket holds more than those


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Yield a Lab without any process."""
    with Lab(tmp_path_factory.mktemp('topics')) as running:
        yield running


def test_what_waits_behind_a_burst_on_another_topic_is_looked_at_before_its_end(lab):
    """An executor hands out the burst's events first; inboxes of a node do not wait for them."""
    heard = []
    node = rclpy.create_node('hearer', context=lab.node.context)
    node.direct, node.inboxes = Direct(), []
    node.namesakes = Namesakes(node)
    node.health = Health(node)
    executor = EventsExecutor(context=lab.node.context)
    executor.add_node(node)
    for topic in ('burst', 'single'):
        topics.Inbox(node, JointState, topic,
                     lambda message, topic=topic: heard.append(topic) or True)
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
    outlet = topics.Outlet(node, JointState, 'ended')
    subscription = node.create_subscription(JointState, 'ended', print, 1, raw=True)
    node.destroy_node()
    for call in (partial(outlet._publish, serialize_message(joint_state(0))),
                 outlet.count_others, partial(list, topics.all_waiting(subscription, 1))):
        with pytest.raises(RuntimeError, match='pointer is invalid'):
            call()


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


def test_a_priority_holds_for_every_thread_or_is_said_to_be_impossible(tmp_path):
    with Lab(tmp_path) as lab:
        node = lab.start('controller_node', realtime_priority=1)
        lab.until(lambda: 'INFO' in node.printed() or 'WARN' in node.printed())
        lab.until(lambda: 'no realtime_priority 1' in node.printed() or all(
            os.sched_getscheduler(int(thread)) == os.SCHED_FIFO
            for thread in os.listdir(f'/proc/{node.process.pid}/task')))


def test_a_reused_message_is_serialized_as_it_is_each_time():
    state = JointState(name=['a', 'b'], position=[1.0, 2.0], velocity=[3.0, 4.0],
                       effort=[5.0, 6.0])
    reference = messages.ReferenceWriter(2, '/somebody')
    reference.write(np.zeros((5, 2)), 'motion', 0)
    serialized = Serialized(state), Serialized(reference.message)
    for stamp, rows, quantity in ((0, 5, 'motion'), (1_700_000_000_123_456_789, 5, 'motion'),
                                  (12_000_000_007, 1, messages.EFFORT)):
        messages.set_stamp(state.header.stamp, stamp)
        state.position = messages.array('d', [stamp / 3.0, -0.0])
        state.effort = messages.array('d', [float('inf'), float(rows)])
        reference.write(np.arange(2.0 * rows).reshape(rows, 2) - stamp, quantity, stamp)
        for one, message in zip(serialized, (state, reference.message), strict=True):
            assert deserialize_message(one.data(), type(message)) == message


def test_joint_states_are_read_as_they_are_whatever_came_before():
    read = Deserialized().message
    for names, position, velocity, effort in (
            ('ab', [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]),
            ('ab', [-0.0, 1e300], [3.0, 4.5], [7.0, 6.0]),
            ('xb', [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]), ('ab', [1.0, 2.0], [3.0, 4.0], []),
            ('ab', [1.0, 2.0], [3.0], [5.0, 6.0, 7.0]), ('ab', [], [], []), ('', [], [], []),
            ('ab', [1.0, 2.0], [3.0, 4.0], [5.0, 6.0])):
        message = JointState(name=list(names), position=position, velocity=velocity, effort=effort)
        for stamp in (0, 1_700_000_000_123_456_789):
            messages.set_stamp(message.header.stamp, stamp)
            assert read(serialize_message(message)) == message


def test_messages_of_the_other_byte_order_are_read_beside_ours():
    """Zeros look the same in both orders; what comes behind them must not be taken as they are."""
    arrays, states = Deserialized(Float64MultiArray).message, Deserialized().message
    for values, both in (([0.0, 0.0], False), ([1.0, 0.1], False), ([0.0, 0.0], True),
                         ([1.0, 0.1], True)):
        numbers = struct.pack('>2d', *values)
        array = Float64MultiArray(data=values)
        state = JointState(position=values, velocity=values, effort=values)
        assert arrays(struct.pack('>4x3I4x', 0, 0, 2) + numbers) == array
        assert states(struct.pack('>4x3I4x2I', 0, 0, 1, 0, 2) + numbers
                      + 2 * (struct.pack('>I4x', 2) + numbers)) == state
        if both:
            assert arrays(serialize_message(array)) == array
            assert states(serialize_message(state)) == state


def test_arrays_are_read_as_they_are_whatever_came_before():
    read = Deserialized(Float64MultiArray).message
    for labels, data in (
            (('joint', 'stamp:1000', 'source:/a#1'), [1.0, 2.0]),
            (('joint', 'stamp:2345', 'source:/a#1'), [-0.0, float('inf')]),
            (('joint', 'stamp:23x5', 'source:/a#1'), [1.0, 2.0]),
            (('joint', 'stamp:-234', 'source:/a#1'), [1.0, 2.0]),
            (('joint', 'stamp:2345', 'source:/b#1'), [1.0, 2.0]),
            (('joint', 'stamp:2346', 'source:/b#1'), [1.0, 2.0, 3.0]),
            (('source:stamp:2346', 'stamp:2346'), [1.0, 2.0]),
            (('source:stamp:2347', 'stamp:2346'), [1.0, 2.0]),
            (('stamp:2346', 'stamp:2346'), [1.0]), (('stamp:2347', 'stamp:2346'), [1.0]),
            ((), [1.0]), ((), [2.0]), ((), []), (('stamp:1',), []),
            (('joint', 'stamp:1000', 'source:/a#1'), [1.0, 2.0])):
        for size in (1, 2):
            message = Float64MultiArray(data=data)
            message.layout.dim = [MultiArrayDimension(label=label, size=size, stride=1)
                                  for label in labels]
            assert read(serialize_message(message)) == message


def test_endpoints_of_others_are_compared_where_their_number_changes_and_now_and_then(
        monkeypatch):
    """A comparison takes most of a sample at 1 kHz: not each second of a loop that runs."""
    others, compared = [1], []
    node = SimpleNamespace(
        direct=Direct(), namesakes=SimpleNamespace(), publishers=(),
        create_publisher=lambda *_: None, create_timer=lambda *_, **__: None,
        subscriptions=[SimpleNamespace(topic_name='/joint_states')],
        count_publishers=lambda _: others[0])
    monkeypatch.setattr(health, 'mismatches', lambda _: compared.append(others[0]) or ())
    monkeypatch.setattr(Health, 'publish', lambda self: setattr(self, '_said', self.status))
    own = Health(node)

    def reports(count):
        for _ in range(10 * count):
            own._look()
        return compared
    assert reports(3) == [1]
    others[0] = 2
    assert reports(3) == [1, 2]
    assert reports(10) == [1, 2, 2]
