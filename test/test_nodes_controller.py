# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A controller alone on states and references the test makes; bench/test/test_faults has more."""

import time

from gms_flex_control.nodes.messages import EFFORT, ReferenceWriter
from node_harness import array_message, joint_state, Lab, NAMES, stamp_of, Trigger
import numpy as np
import pytest
from rclpy.serialization import serialize_message

DiagnosticArray = pytest.importorskip('diagnostic_msgs.msg').DiagnosticArray
PERIOD = 5_000_000   # [ns]
BURST, ROUNDS = 120, 20  # messages; a socket holds more than those
TORQUE = np.array([[0.01, -0.02]])
TURNS = {'velocity': (0.5, 0.0, 0.0, 0.0), 'frozen': (0,)}  # joint1 says so, not its encoder
STANDS = {'frozen': (0,)}


class Said(list):
    """What the controller says of itself."""

    def append(self, message):
        super().extend(one.message for one in message.status if one.name == 'cascade_controller')


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run a controller in real time on states and references that the test makes."""
    with Lab(tmp_path_factory.mktemp('controller')) as running:
        running.controller = running.start('controller_node')
        running.states = running.say('states')
        running.references = running.say('references')
        running.said, running.writer = Said(), ReferenceWriter(2, '/test')
        running.listen(DiagnosticArray, '/diagnostics', running.said)
        running.commands = running.hear('commands')
        running.until(lambda: running.states.get_subscription_count()
                      and running.references.get_subscription_count())
        running.stamp = 10**9
        running.until(lambda: send_state(running) or running.commands)
        yield running
        assert running.controller.runs and 'FAULT' not in running.controller.printed()


def send_state(lab, *, velocity=None, frozen=()):
    """Publish the next state, at zero; angles shiver by a microradian but those ``frozen``."""
    lab.stamp += PERIOD
    shiver = 1e-6 * (lab.stamp // PERIOD % 2)
    angles = [shiver * (k not in frozen) for k in range(4)]
    lab.states.publish(joint_state(lab.stamp, angles, names=NAMES, velocity=velocity))


def answer(lab):
    """Wait for the command that answers the last state."""
    return lab.until(lambda: [command for command in lab.commands
                              if stamp_of(command) == lab.stamp])[0]


def push(lab, *, source=(), **state):
    """Send states, with references 0.2 rad ahead, until one is answered; return the answer."""
    first, seen = lab.stamp + PERIOD, len(lab.commands)

    def answers():
        if source is not None:
            message = array_message([0.2, 0.2, *[0.0] * 8], 'derivative', 'joint',
                                    f'stamp:{lab.stamp + PERIOD}', *source)
            message.layout.dim[0].size, message.layout.dim[1].size = 5, 2
            lab.references.publish(message)
        send_state(lab, **state)
        return [one for one in lab.commands[seen:] if first <= stamp_of(one)]
    return lab.until(answers)[-1]


def moving(lab, **options):
    """Return whether the controller pushes."""
    return any(abs(torque) > 0.01 for torque in push(lab, **options).data)


def test_a_frozen_encoder_ends_torque_until_it_is_reset_or_the_angle_changes(lab):
    """At 20 mrad beyond its velocity, 40 ms; afterwards torque rises from zero."""
    for leads_on in ('reset', 'angle'):
        lab.until(lambda: moving(lab))
        lab.until(lambda: moving(lab, **STANDS))
        begin = lab.stamp
        lab.until(lambda: not any(push(lab, **TURNS).data))
        assert next(stamp_of(one) for one in lab.commands
                    if stamp_of(one) > begin and not any(one.data)) - begin <= 50_000_000
        lab.until(lambda: 'joint1 has been at exactly 0 rad for' in lab.controller.printed())
        assert 'call /cascade_controller/reset' in lab.controller.printed()
        assert not any(any(push(lab, **STANDS).data) for _ in range(50))
        if leads_on == 'reset':
            assert lab.call(Trigger, '/cascade_controller/reset').success
            lab.until(lambda: moving(lab, **STANDS))
    torques = [max(map(abs, push(lab).data)) for _ in range(20)]
    assert torques[0] < 0.02 < 0.1 < torques[-1]


def test_another_source_that_is_alone_is_followed_at_once(lab):
    """As after a restart of the trajectory node: its source is new, the old one silent."""
    lab.until(lambda: moving(lab, source=['source:/a#1']))
    later = time.monotonic() + 0.3  # 50 ms of silence at least, and all of that is reported
    lab.until(lambda: time.monotonic() > later)
    known = len(lab.said)
    lab.until(lambda: moving(lab, source=['source:/a#2']) and 'following' in lab.said[known:])
    assert not any('at once' in said for said in lab.said[known:])


def test_a_source_of_another_time_is_nobody(lab):
    lab.until(lambda: moving(lab))
    known = len(lab.said)
    for _ in range(20):
        lab.references.publish(array_message(np.zeros(10), f'stamp:{lab.stamp - 10**9}',
                                             'source:/old#1'))
        push(lab)
    lab.until(lambda: moving(lab))
    assert not any('at once' in said for said in lab.said[known:])


@pytest.mark.parametrize('labels', [(), ('source:/mine',)])
def test_references_need_no_layout(lab, labels):
    """As from the command line; without a stamp they are for the state there is."""
    def pushes():
        lab.references.publish(array_message([0.2, 0.2, *[0.0] * 8], *labels))
        return moving(lab, source=None)
    lab.until(pushes)


def test_a_state_before_a_burst_of_others_on_its_topic_is_answered(lab):
    odd = joint_state(0, names=['other'] * 4)
    for _ in range(ROUNDS):
        send_state(lab)
        for _ in range(BURST):
            lab.states.publish(odd)
        answer(lab)
    assert 'joint state refused' in lab.controller.printed()


def test_a_reference_before_a_burst_of_others_is_followed(lab):
    followed, odd = 0, array_message([float('nan')] * 10)
    for _ in range(ROUNDS):
        lab.references.publish(lab.writer.write(TORQUE, EFFORT, lab.stamp + PERIOD))
        for _ in range(BURST):
            lab.references.publish(odd)
        send_state(lab)
        followed += list(answer(lab).data) == TORQUE[0].tolist()
    assert followed >= ROUNDS // 2  # topics may overtake each other


LONG = joint_state(0, [0.1] * 10**5, names=[f'joint{k}' for k in range(10**5)])


@pytest.mark.parametrize(('messages', 'said'), [
    ([LONG], '/joint_states: a message of '),
    ([b'', b'\0\1\0\0', serialize_message(joint_state(0))[:-1]],
     '/joint_states: 4 bytes are refused')])
def test_what_no_robot_sends_is_refused_unread(lab, messages, said):
    def is_refused():
        for message in messages:
            lab.states.publish(message)
        return said in lab.controller.printed()
    lab.until(is_refused)
    send_state(lab)
    answer(lab)
