# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How a node hears a topic that its loop hangs on: through storms of messages of no use to it.

Each message is taken as bytes, many at a time, into a queue so deep that a storm does not displace
the good ones before they are looked at. To make an object of it and to refuse that costs several
times more than to take it; so bytes that do not look like a message that was accepted are made one
only so many times a second. An executor hands out messages in the order of their coming, a storm's
before all others; so whatever comes, all topics of the node are looked at.
"""

from functools import partial
from itertools import chain
import time

from gms_flex_control.nodes import process
from gms_flex_control.nodes.serialized import Deserialized
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

DEPTH = 1000       # messages; a storm brings some 100 in a millisecond
_AT_ONCE = 100     # messages of a topic that are taken before others have their turn
_KEPT = 10         # the newest of those waiting, after a stall
_ODD_RATE = 200.0  # messages unlike all accepted ones that are looked into [1/s]
_ODD_AT_ONCE = 50
_MOST_LOOKS = 16   # of accepted messages that are remembered
_LONGEST = 65536   # bytes of a message; a thousand joints need no more
# what does not change from message to message: frame and first names; first label
_FIXED = {JointState: slice(12, 48), Float64MultiArray: slice(4, 18)}


def all_waiting(subscription, most):
    """
    Yield the raw messages (bytes) that wait, ``most`` of them at most.

    The executor still counts an event for each of them and finds nothing then, which is cheap.
    """
    take, kind = subscription.handle.take_message, subscription.msg_type
    for _ in range(most):
        taken = take(kind, True)
        if taken is None:
            return
        yield taken[0]


class Inbox:
    """
    Subscription of a node whose handler is given the messages worth a look.

    Those that nodes of the same process publish reach the handler directly.

    Parameters
    ----------
    node : rclpy.node.Node
        Who subscribes; its ``health`` guards the handler, its ``direct`` is a Direct.
    kind : type
        JointState or Float64MultiArray.
    topic : str
        Its name.
    handler : callable
        Takes a message; returns whether it read and accepted it.
    mode : {'realtime', 'lockstep'}
        In lockstep each message is waited for, and each is given to the handler.
    boxes : list of Inbox, optional
        Those of the node, which are looked at together; this one is added.

    """

    def __init__(self, node, kind, topic, handler, mode='realtime', boxes=None):
        self._kind, self._handle = kind, node.health.guard(handler)
        self._health, self._topic = node.health, node.resolve_topic_name(topic)
        node.direct.hearers[self._topic].append(self._handle)
        self._looks = []           # of accepted messages
        self._odd = _ODD_AT_ONCE   # that may still be looked into
        self._filled = time.monotonic()
        if mode == 'lockstep':
            node.create_subscription(kind, topic, self._handle, process.subscriber_qos(mode),
                                     event_callbacks=process.NO_EVENTS)
            return
        self._message_of = (Deserialized().message if kind is JointState else
                            partial(deserialize_message, message_type=kind))
        self._boxes = [] if boxes is None else boxes
        self._boxes.append(self)
        self._subscription = node.create_subscription(
            kind, topic, node.health.shield(self._empty), process.subscriber_qos(mode, DEPTH),
            raw=True, event_callbacks=process.NO_EVENTS)

    def _empty(self, first):
        """Take what there is here, of which ``first`` (bytes) was taken already, and elsewhere."""
        self._take(chain([first], self._waiting()))
        for box in self._boxes:
            if box is not self:
                box._take(box._waiting())

    def _waiting(self):
        return all_waiting(self._subscription, _AT_ONCE)

    def _take(self, messages):
        fixed, looks, good = _FIXED[self._kind], self._looks, []
        for data in messages:
            if (len(data), data[fixed]) in looks:
                good.append(data)
            else:
                self._look_into(data)
        for data in good[-_KEPT:]:
            self._handle(self._message_of(data))

    def _look_into(self, data):
        """Give a message of a look not known to the handler, if there are not too many."""
        if len(data) > _LONGEST:
            self._health.warn(f'size of {self._topic}', f'{self._topic}: a message of {len(data)} '
                              f'bytes is refused, {_LONGEST} at most; who sends it?')
            return
        if self._odd < 1.0:
            now = time.monotonic()
            self._odd = min(self._odd + (now - self._filled) * _ODD_RATE, _ODD_AT_ONCE)
            self._filled = now
            if self._odd < 1.0:
                return
        self._odd -= 1.0
        if self._handle(self._message_of(data)):
            self._looks.append((len(data), data[_FIXED[self._kind]]))
            del self._looks[:-_MOST_LOOKS]
