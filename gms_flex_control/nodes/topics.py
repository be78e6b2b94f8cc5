# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
How nodes hear and speak the topics that their loop hangs on.

A message is published for everybody else, and given in the same call to those who hear its topic
in the same process. They do not hear it once more from DDS, see process.py.

Between a message of Python and its bytes lies several times more work than sending them takes: of
messages that come and go again and again only the bytes that change are touched. What is heard is
taken as bytes, many at a time, into a queue so deep that a storm does not displace the good ones
before they are looked at; bytes that do not look like a message that was accepted are made an
object only so many times a second. An executor hands out messages in the order of their coming, a
storm's before all others; so whatever comes, all topics of the node are looked at.
"""

from collections import defaultdict
from collections.abc import Iterator
import struct
import sys
import threading
import time

from gms_flex_control.data.cdr import STAMP_LABEL
from gms_flex_control.nodes import process
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_UNSEEN = 2000     # messages in lockstep that those who acknowledge may be behind by
_PATIENCE = Duration(seconds=4.0)  # with them: they may be frozen, or have been killed
DEPTH = 1000       # messages; a storm brings some 100 in a millisecond
_AT_ONCE = 100     # messages of a topic that are taken before others have their turn
_KEPT = 10         # the newest of those waiting, after a stall
_ODD_RATE = 200.0  # messages unlike all accepted ones that are looked into [1/s]
_ODD_AT_ONCE = 50
_MOST_LOOKS = 16   # of accepted messages that are remembered
_LONGEST = 65536   # bytes of a message; a thousand joints need no more
# what does not change from message to message: frame and first names; first label
_FIXED = {JointState: slice(12, 48), Float64MultiArray: slice(4, 18)}
_TIME, _TIME_AT = struct.Struct('=iI'), 4  # of a header, behind the encapsulation
_NATIVE = b'\0\1' if sys.byteorder == 'little' else b'\0\0'  # first bytes: the byte order
_GAP = 8  # bytes between two sequences of doubles: length and padding


class Direct:
    """What one process hears and serves itself."""

    def __init__(self):
        # taken by whoever runs a callback of these nodes or a sample of their loop
        self.lock = threading.RLock()
        self.known = False  # whether other processes have discovered this one
        self.hearers = defaultdict(list)  # topic -> who take its messages, in order of the calls
        self.services = {}  # name -> handler, which takes request and response


class Outlet:
    """
    Publisher of one reused message of ``kind``, which nodes of the same process may hear.

    They hear it after it was published, so that nobody gets an answer before what it answers;
    ``ahead``, they hear it first: an effort of a real robot waits for no recorder. In lockstep it
    waits: nobody falls so far behind that a message is lost.
    """

    def __init__(self, node, kind, topic, mode='realtime', ahead=False):
        self._ahead, self._lockstep, self._sent = ahead, mode == 'lockstep', 0
        self._publisher = node.create_publisher(kind, topic, process.publisher_qos(mode))
        self._hearers = node.direct.hearers[self._publisher.topic_name]
        self._serialized = None
        # of rclpy's handle: what Publisher does around it takes longer than the call. It keeps a
        # node that ends in another thread from freeing the handle meanwhile, which cannot be:
        # the call holds the interpreter's lock throughout, and a later one raises RCLError
        self._publish, self.count_others = (self._publisher.handle.publish_raw,
                                            self._publisher.handle.get_subscription_count)

    def publish(self, message) -> None:
        """Publish the message, and give it to those who hear it here; they keep nothing of it."""
        if not self._ahead:
            self._send(message)
        for hear in self._hearers:
            hear(message)
        if self._ahead:
            self._send(message)

    def _send(self, message):
        if self.count_others():
            if self._serialized is None:
                self._serialized = Serialized(message)
            self._publish(self._serialized.data())
            if self._lockstep:
                self._sent += 1
                if self._sent % _UNSEEN == 0:
                    self.wait_for_all_acked()

    def count_hearers(self) -> int:
        """Return how many take the message, here and elsewhere."""
        return self.count_others() + len(self._hearers)

    def wait_for_all_acked(self) -> None:
        """Wait a while until those who acknowledge have what was published."""
        self._publisher.wait_for_all_acked(_PATIENCE if self._lockstep else process.GOODBYE)


def all_waiting(subscription, most) -> Iterator:
    """Yield what waits, raw messages (bytes) and what is known of each, ``most`` at most."""
    take, kind = subscription.handle.take_message, subscription.msg_type
    for _ in range(most):
        taken = take(kind, True)
        if taken is None:  # the events of those taken find nothing
            return
        yield taken


class Inbox:
    """
    Subscription of a node whose handler is given the messages worth a look.

    ``handler`` takes a message of ``kind``, JointState or Float64MultiArray, and returns whether
    it read and accepted it. In lockstep it is given each message. Those of ``node``, a
    ConfiguredNode, are looked at together.
    """

    def __init__(self, node, kind, topic, handler, mode='realtime'):
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
        self._message_of = Deserialized(kind).message
        self._boxes = node.inboxes
        self._boxes.append(self)
        self._subscription = node.create_subscription(
            kind, topic, node.health.shield(self._empty), process.subscriber_qos(mode, DEPTH),
            raw=True, event_callbacks=process.NO_EVENTS)

    def _empty(self, first):
        """Take ``first`` (bytes) without delay, then what waits here and elsewhere."""
        self._take([(first, None)])
        self._take(self._waiting())
        for box in self._boxes:
            if box is not self:
                box._take(box._waiting())

    def _waiting(self):
        return all_waiting(self._subscription, _AT_ONCE)

    def _take(self, messages):
        fixed, looks, good = _FIXED[self._kind], self._looks, []
        for data, _ in messages:
            if (len(data), data[fixed]) in looks:
                good.append(data)
            else:
                self._look_into(data)
        for data in good[-_KEPT:]:
            self._give(data)

    def _give(self, data):
        """Return what the handler returns for a message; None if its bytes are broken."""
        try:
            message = self._message_of(data)
        except RuntimeError:  # of the middleware: it ends too early, or its lengths are wrong
            self._health.warn(f'bytes of {self._topic}', f'{self._topic}: {len(data)} bytes are '
                              f'refused, they make no {self._kind.__name__}; who sends them?')
            return None
        return self._handle(message)

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
        if self._give(data):
            self._looks.append((len(data), data[_FIXED[self._kind]]))
            del self._looks[:-_MOST_LOOKS]


class Serialized:
    """One reused JointState, with sequences of one length, or Float64MultiArray, and its bytes."""

    def __init__(self, message):
        self._message, self._has_header = message, isinstance(message, JointState)
        self._fields = ('position', 'velocity', 'effort') if self._has_header else ('data',)
        self._labels = [] if self._has_header else _stamp_dimensions(message)
        self._lengths = None

    def data(self) -> bytes:
        """Return the message as it is now."""
        message = self._message
        numbers = [getattr(message, field) for field in self._fields]
        label = self._labels[0].label.encode() if self._labels else b''
        lengths = [len(numbers[0]), len(label)]
        if lengths != self._lengths:
            self._learn(label, len(numbers[0]))
            self._lengths = lengths
        data = self._data
        if self._has_header:
            _TIME.pack_into(data, _TIME_AT, message.header.stamp.sec, message.header.stamp.nanosec)
        data[self._label] = label
        for place, values in zip(self._places, numbers, strict=True):
            data[place] = values.tobytes()
        return bytes(data)

    def _learn(self, label, count):
        """Find out where in the bytes everything stands."""
        self._data = data = bytearray(serialize_message(self._message))
        self._label = _place_of(label, data)
        self._places = _places(len(data), count, len(self._fields))


class Deserialized:
    """Messages of a kind from bytes, one reused for all that differ in stamp and numbers only."""

    def __init__(self, kind=JointState):
        self._kind, self._message, self._size = kind, None, None

    def message(self, data) -> JointState | Float64MultiArray:
        """Return the message of ``data`` (bytes)."""
        if len(data) != self._size or [data[place] for place in self._same] != self._known:
            return self._learn(data)
        if self._kind is JointState:
            stamp = self._message.header.stamp
            stamp.sec, stamp.nanosec = _TIME.unpack_from(data, _TIME_AT)
        for place, dimension in self._labels:
            dimension.label = data[place].decode('ascii', 'replace')
        for place, values in self._numbers:
            values[:] = data[place]
        return self._message

    def _learn(self, data):
        message = deserialize_message(data, self._kind)
        self._message, self._size = message, None
        if self._kind is JointState:
            labels, fields = [], ('position', 'velocity', 'effort')
            same, begin = [slice(_TIME_AT)], _TIME_AT + _TIME.size
        else:
            labels, fields = _stamp_dimensions(message), ('data',)
            same, begin = [], 0
        numbers = [memoryview(getattr(message, field)).cast('B') for field in fields]
        places = _places(len(data), len(numbers[0]) // 8, len(numbers))
        # of other lengths they do not stand there, of another byte order zeros do
        fit = data[:2] == _NATIVE and all(values and data[place] == values for place, values in
                                          zip(places, numbers, strict=True))
        if not fit or data.count(STAMP_LABEL.encode()) > 1:
            return message
        self._labels = []
        self._same = [*same, slice(begin, places[0].start),
                      *(slice(place.start - _GAP, place.start - 4) for place in places[1:])]
        if labels:
            place = _place_of(labels[0].label.encode(), data)
            self._labels = [(place, labels[0])]
            self._same = [slice(begin, place.start), slice(place.stop, places[0].start)]
        self._numbers = list(zip(places, numbers, strict=True))
        self._known, self._size = [data[place] for place in self._same], len(data)
        return message


def _stamp_dimensions(message):
    return [one for one in message.layout.dim if one.label.startswith(STAMP_LABEL)]


def _place_of(label, data):
    begin = data.find(label)
    return slice(begin, begin + len(label))


def stamp_in(data, kind) -> int | None:
    """
    Return the stamp [ns] in the bytes of a JointState or Float64MultiArray, None without one.

    It is read without the rest; only bytes of the other byte order make a wrong one.
    """
    if kind is JointState:
        sec, nanosec = _TIME.unpack_from(data, _TIME_AT)
        return sec * 1_000_000_000 + nanosec
    begin = data.find(STAMP_LABEL.encode())
    digits = data[begin + len(STAMP_LABEL):data.find(b'\0', begin)] if begin >= 0 else b''
    return int(digits) if digits.isdigit() else None


def _places(end, count, sequences):
    """Return where (slices) the last sequences of ``count`` doubles stand that end at ``end``."""
    size = 8 * count
    ends = [end - k * (size + _GAP) for k in reversed(range(sequences))]
    return [slice(end - size, end) for end in ends]
