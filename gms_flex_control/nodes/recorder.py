# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Record any topics into a bag that survives the recorder's own sudden end."""

from collections import deque
from importlib import import_module
import signal
import threading
import time

from gms_flex_control.data.metadata import qos_profile
from gms_flex_control.data.writer import BagWriter
from gms_flex_control.errors import BagError
from gms_flex_control.nodes.process import end_with_launch, hidden_node, MOST_KEPT, NO_EVENTS
from gms_flex_control.nodes.topics import all_waiting
import rclpy
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.task import Future
from rclpy.validate_full_topic_name import validate_full_topic_name

_DRAIN_PERIOD = 0.02    # [s]; with the writer's flush period this is what kill -9 can take
_LOOK_PERIOD = 0.05     # between looks whether recording is over [s]
_SEARCH_PERIOD = 0.1    # between looks at the graph while a topic is missing [s]
_IDLE_PERIOD = 1.0      # and once all are there [s]
_PATIENCE = 5.0         # before a topic without messages is named [s]
_GRACE_PERIOD = 0.05    # for what has been sent before the end but not yet handed over [s]
STATES = 'joint_states'
_WHO = {STATES: 'joint states', 'effort_controller/commands': 'commands of the controller',
        'reference': 'references of the trajectory node'}  # of an experiment


class Recorder:
    """Hands raw messages of ``topics`` (None: all not hidden) to a bag; ``say`` hears of it."""

    def __init__(self, node, writer, topics=None, say=print):
        self._node, self._writer, self._say = node, writer, say
        self._wanted = None if topics is None else [_absolute(name) for name in topics]
        self._subscriptions, self._refused = {}, set()
        self._silent = {}  # topics without a message yet, and when to say so
        self._due = time.monotonic() + _PATIENCE  # to say which are missing
        self._queue = deque()
        self._next_search = 0.0
        self._stop = threading.Event()
        self._error = None
        self._thread = threading.Thread(target=self._write, name='bag_writer', daemon=True)
        self._thread.start()

    @property
    def missing(self) -> list:
        """Return the wanted topics that are not recorded yet."""
        return [name for name in self._wanted or () if name not in self._subscriptions]

    @property
    def unheard(self) -> list:
        """Return the wanted topics without a message yet: their publishers may not know of us."""
        return [name for name in self._wanted or () if not self._writer.counts.get(name)]

    def poll(self) -> None:
        """Subscribe to what has appeared, cheaply; raises BagError if the bag takes no more."""
        if self._error is not None:
            raise self._error
        now = time.monotonic()
        if now < self._next_search:
            return
        known = len(self._subscriptions)
        # joint states last: a robot begins once they are heard, and all answers are heard by then
        for name, types in sorted(self._node.get_topic_names_and_types(),
                                  key=lambda topic: topic[0].endswith(f'/{STATES}')):
            if name not in self._subscriptions and name not in self._refused \
                    and self._is_wanted(name):
                self._subscribe(name, types)
        if self._wanted is not None and len(self._subscriptions) > known and not self.missing:
            self._say(f'recording {", ".join(self._wanted)}')
        self._name_silent(now)
        busy = self._wanted is None or self.missing
        self._next_search = now + (_SEARCH_PERIOD if busy else _IDLE_PERIOD)

    def _name_silent(self, now):
        if now > self._due:
            self._due = float('inf')
            if self.missing:
                self._say(f'nobody publishes {", ".join(self.missing)} yet (ros2 topic list)')
        for name, due in list(self._silent.items()):
            if self._writer.counts[name]:
                del self._silent[name]
            elif now > due:
                del self._silent[name]
                self._say(f'no message on {name} in {_PATIENCE:.0f} s, though it has a publisher')

    def _is_wanted(self, name):
        if self._wanted is not None:
            return name in self._wanted
        return not any(part.startswith('_') for part in name.split('/'))

    def _subscribe(self, name, types):
        publishers = self._node.get_publishers_info_by_topic(name)
        if not publishers:
            return  # only subscribed to so far: nothing shows the quality of service
        try:
            if len(types) > 1:
                raise BagError(f'topic {name!r} has the types {" and ".join(types)}; '
                               'stop one publisher')
            message_class = _message_class(types[0])
            reliability, durability = _offered_qos(publishers)
            self._writer.add_topic(name, types[0], qos=qos_profile(
                reliability.name.lower(), durability.name.lower()))
        except BagError as error:
            self._refused.add(name)
            self._say(f'not recorded: {error}')
            return
        profile = QoSProfile(depth=MOST_KEPT, reliability=reliability, durability=durability)
        queue = self._queue

        def on_message(data):
            queue.append((name, time.time_ns(), data))

        self._subscriptions[name] = self._node.create_subscription(
            message_class, name, on_message, profile, raw=True, event_callbacks=NO_EVENTS)
        self._silent[name] = time.monotonic() + _PATIENCE
        self._say(f'subscribed to {name} ({types[0]}, {reliability.name.lower()})')

    def put(self, name, message) -> None:
        """Write a message of this process's own, on a topic the bag has."""
        self._queue.append((name, time.time_ns(), serialize_message(message)))

    def _write(self):
        try:
            while not self._stop.wait(_DRAIN_PERIOD):
                self._drain()
                self._writer.flush_if_due()
            self._drain()
        except BagError as error:
            self._error = error

    def _drain(self):
        for _ in range(len(self._queue)):
            self._writer.write(*self._queue.popleft())

    def close(self) -> None:
        """Write all that has come and stop; raises BagError if the bag could not be written."""
        for name, subscription in self._subscriptions.items():
            for data, _ in all_waiting(subscription, MOST_KEPT):
                self._queue.append((name, time.time_ns(), data))
        self._stop.set()
        self._thread.join()
        if self._error is not None:
            raise self._error


class ExperimentBag:
    """A bag of the loop's topics and of ``own``, the node's publisher; enter it to record."""

    def __init__(self, node, path, own, say):
        self._writer = BagWriter(path)
        self._node, self._own, self._say = node, own, say
        self._who = {node.resolve_topic_name(topic): words for topic, words in _WHO.items()}
        self._growth = {}

    def __enter__(self):
        """Make the bag and begin to record."""
        self._writer.__enter__()
        self._writer.add_topic(self._own.topic_name, 'std_msgs/msg/Float64MultiArray',
                               qos=qos_profile('reliable', 'transient_local'))
        self.recorder = Recorder(self._node, self._writer, list(self._who), self._say)
        return self

    def say(self, message) -> None:
        """Publish a message of the node's own, and record it."""
        self._own.publish(message)
        self.recorder.put(self._own.topic_name, message)

    def silent(self, bound) -> list:
        """Return what has not grown for ``bound`` seconds (list of str)."""
        now, found = time.monotonic(), []
        for topic, words in self._who.items():
            count = self._writer.counts.get(topic, 0)
            known, since = self._growth.get(topic, (None, now))
            if count != known:
                self._growth[topic] = (count, now)
            elif now - since > bound:
                found.append(words)
        return found

    def __exit__(self, *failure):
        """End the recording and the bag."""
        try:
            self.recorder.close()
        finally:
            self._writer.__exit__(*failure)


def _offered_qos(publishers):
    """Return the strictest (reliability, durability) that every publisher of a topic offers."""
    reliable = all(info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                   for info in publishers)
    latched = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                  for info in publishers)
    return (ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def record(out, topics=None, *, duration=None, say=print) -> dict:
    """Record until a signal or for ``duration`` [s]; return messages per topic (dict)."""
    for name in topics or ():
        try:
            validate_full_topic_name(_absolute(name))
        except InvalidTopicNameException as error:
            reason = str(error).split(':')[1].strip()
            raise BagError(f'{name!r}: {reason}') from error
    end = float('inf') if duration is None else time.monotonic() + duration
    stopped = threading.Event()
    # no exception: it would hit the callback of a message and lose it, or the closing of the bag
    # at the second signal that ros2 launch sends; nor SIG_IGN before that is over: of signals
    # that come together Python would complain with a traceback
    previous = {number: signal.signal(number, lambda *_: stopped.set())
                for number in (signal.SIGINT, signal.SIGTERM)}
    end_with_launch()
    try:
        with BagWriter(out) as writer, hidden_node('recorder') as (node, executor):
            recorder = Recorder(node, writer, topics, say)
            try:
                _spin(recorder, executor, lambda: stopped.is_set() or time.monotonic() > end)
            finally:
                recorder.close()
                for name in recorder.missing:
                    say(f'not recorded: topic {name!r} never had a publisher')
    finally:
        for number, handler in previous.items():
            signal.signal(number, signal.SIG_IGN if stopped.is_set() else handler)
    return dict(writer.counts)


def _spin(recorder, executor, is_over):
    while rclpy.ok() and not is_over():
        recorder.poll()
        if recorder.missing:  # subscribe as soon as it is there
            executor.spin_once(timeout_sec=_LOOK_PERIOD)
        else:  # back in Python after each message it takes twice as long, see Spinner.spin_for
            executor.spin_until_future_complete(Future(), timeout_sec=_LOOK_PERIOD)
    if rclpy.ok():
        executor.spin_until_future_complete(Future(), timeout_sec=_GRACE_PERIOD)


def _absolute(name):
    return '/' + '/'.join(filter(None, name.split('/')))


def _message_class(type_name):
    package, kind, name = type_name.split('/')
    try:
        return getattr(import_module(f'{package}.{kind}'), name)
    except (ImportError, AttributeError) as error:
        raise BagError(f'message type {type_name!r} is not installed for Python ({error}); '
                       'source the workspace that defines it') from error
