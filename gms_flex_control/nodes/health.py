# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How a node is, on /diagnostics: its faults, endpoints that do not fit, others of its name."""

from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from functools import wraps
import os
from socket import gethostname
import time
import traceback

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.supervision import FAULT
from gms_flex_control.nodes.messages import now
from gms_flex_control.nodes.process import NO_EVENTS
from rclpy.clock import Clock, ClockType
from rclpy.logging import LoggingSeverity
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.serialization import deserialize_message

DIAGNOSTICS = '/diagnostics'
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_LOOK_PERIOD = 0.1   # a change is published within this [s]
_LOOKS_PER_REPORT = 10
_REPORTS_PER_COMPARISON = 10  # where as many endpoints are there as before
_WARN_PERIOD = 5.0   # of warnings of one kind [s]
_COMMON = ('rosout', 'parameter_events')
# of namesakes
_PROCESS, _RUNNING, _STARTING = 'process', 'running since [ns]', 'starting since [ns]'
_DIGITS = 20      # of such a time, at most
# until others are discovered and have answered, as a rule: at least so long, and so many times
# what it took to make the node, which takes the longer the busier the machine is
_DISCOVERY, _BUSY = 0.4, 3.0
_ANSWER = 0.1     # where this process has been discovered before [s]
# of others that are just being discovered: so long after the last step of it, at most in all
_STEP, _STEPS = 0.2, 2.0  # [s]
_ASK_PERIOD = 0.02  # between questions for it [s]
_ENDLESS = 2**62  # the graph reports a duration that was never set as about this or more [ns]


def trigger(name, act) -> Callable:
    """Return the handler ``name`` of a Trigger service; ``act()`` returns success and message."""
    def handler(_request, response):
        response.success, response.message = act()
        return response

    handler.__name__ = name
    return handler


class Health:
    """
    State of one node, on /diagnostics once a second and when it changes.

    ``figures()`` returns what to report (dict), once per report; ``on_fault()`` is called when a
    fault begins. ``node.direct``, a Direct, has the lock of `guard`.
    """

    def __init__(self, node, figures=dict, on_fault=lambda: None):
        self._node, self._figures, self._on_fault = node, figures, on_fault
        self.fault = ''      # the sentence of the first fault
        self._state = (OK, 'starting')
        self._warned = {}    # kind of warning: when it was logged last [s]
        self._said, self._looks, self._mismatches = None, 0, ()
        self._counted, self._reports = None, 0  # endpoints of others, when last compared
        self._hearers = node.direct.hearers[DIAGNOSTICS]
        node.namesakes.answer = self.publish
        # steady: the timers of ROS time stand still with /clock
        self._timer = node.create_timer(_LOOK_PERIOD, self.shield(self._look),
                                        clock=Clock(clock_type=ClockType.STEADY_TIME))

    def report(self, level, sentence) -> None:
        """Say how the node is; cheap enough for every tick."""
        self._state = (level, sentence)

    def report_state(self, supervisor, severity=LoggingSeverity.ERROR) -> None:
        """Say, log and publish the state of a Supervisor, a fault in the log by ``severity``."""
        fault = supervisor.state == FAULT
        sentence = f'{supervisor.state}: {supervisor.reason}'
        self.report(ERROR if fault else OK, sentence)
        if fault:  # two lines of code: rclpy refuses two severities from one
            self._node.get_logger().log(sentence, severity)
        else:
            self._node.get_logger().info(sentence)
        self.publish()

    def warn(self, kind, sentence, skip_first=False) -> None:
        """
        Log a warning, at most one of a ``kind`` every few seconds; ``skip_first`` after some.

        The throttle of rclpy looks for its caller each time, which takes longer than all the
        rest of refusing a message: in a storm of those the loop would stand.
        """
        now, due = time.monotonic(), self._warned.get(kind, 0.0)
        if now >= due:
            self._warned[kind] = now + _WARN_PERIOD
            if due or not skip_first:
                self._node.get_logger().warning(sentence)

    @property
    def name(self) -> str:
        """Return the full name of the node."""
        return self._node.get_fully_qualified_name()

    @property
    def status(self) -> tuple:
        """Return level and sentence; a fault and mismatched endpoints outweigh the rest."""
        if self.fault:
            return ERROR, f'FAULT: {self.fault}'
        level, sentence = self._state
        if self._mismatches:
            return max(level, ERROR), '; '.join((*self._mismatches, sentence))
        return level, sentence

    def fail(self, sentence) -> None:
        """Enter the fault, which lasts until `recover`; later faults change nothing."""
        if not self.fault:
            self.fault = sentence
            self._node.get_logger().error(f'FAULT: {sentence}')
            self._on_fault()
            self.publish()

    def failed(self, error, where) -> None:
        """Enter the fault that an exception makes; its traceback is logged, but only once."""
        if not self.fault:
            lines = ''.join(traceback.format_exception(error)).rstrip()
            self._node.get_logger().error(f'exception in {where}\n{lines}')
        self.fail(f'{where} raised {type(error).__name__}: {error}')

    def recover(self) -> None:
        """End the fault."""
        self.fault = ''

    def guard(self, callback) -> Callable:
        """Return ``callback`` such that it holds the lock, and as `shield` has it."""
        return self._wrapped(callback, self._node.direct.lock)

    def shield(self, callback) -> Callable:
        """Return ``callback`` so that an exception is a fault, and its service answers false."""
        return self._wrapped(callback, nullcontext())

    def _wrapped(self, callback, lock):
        name = callback.__name__.strip('_')

        @wraps(callback)
        def shielded(*arguments):
            with lock:
                try:
                    return callback(*arguments)
                except Exception as error:  # noqa: B902  whatever it is, torque must end
                    self.failed(error, name)
            response = arguments[-1] if arguments else None
            if hasattr(response, 'success'):
                response.success, response.message = False, f'FAULT: {self.fault}'
            return response
        return shielded

    def _look(self):
        self._looks += 1
        if self._looks % _LOOKS_PER_REPORT == 0:
            node, self._reports = self._node, self._reports + 1
            counted = [*(node.count_publishers(own.topic_name) for own in node.subscriptions),
                       *(node.count_subscribers(own.topic_name) for own in node.publishers)]
            # to compare takes most of a sample at 1 kHz
            if counted != self._counted or self._reports % _REPORTS_PER_COMPARISON == 0:
                self._counted = counted
                self._compare_endpoints()
            self.publish()
        elif self.status != self._said:
            self.publish()

    def _compare_endpoints(self):
        found = tuple(mismatches(self._node))
        for sentence in found:
            if sentence not in self._mismatches:
                self._node.get_logger().error(sentence)
        self._mismatches = found

    def publish(self) -> None:
        """Publish the state now."""
        self._said = self.status
        message = self._node.namesakes.say(*self._said, self._figures())
        for hear in self._hearers:
            hear(message)


def mismatches(node) -> Iterator:
    """
    Yield a sentence for every endpoint of others that does not fit one of ``node``.

    It names topic, node and policy, from the graph: QoS events would be sooner, but with the
    EventsExecutor they can deadlock.
    """
    for own in node.subscriptions:
        for other in node.get_publishers_info_by_topic(own.topic_name):
            yield from _complaint(own.topic_name, other, other.qos_profile, own.qos_profile,
                                  'publishes what cannot be received here')
    for own in node.publishers:
        if own.topic_name.rsplit('/', 1)[-1] in _COMMON:
            continue
        for other in node.get_subscriptions_info_by_topic(own.topic_name):
            yield from _complaint(own.topic_name, other, own.qos_profile, other.qos_profile,
                                  'requests more than is offered here')


def _complaint(topic, other, offered, requested, what):
    compatible, reason = qos_check_compatible(_plain(offered), _plain(requested))
    if compatible == QoSCompatibility.ERROR:
        reason = ' '.join(str(reason).removeprefix('ERROR: ').split()).rstrip(';')
        yield (f'QoS mismatch on {topic}: {other.node_namespace.rstrip("/")}/{other.node_name} '
               f'{what} ({reason})')


def _plain(profile):
    """Return the policies that matter, endless durations as if they had never been set."""
    given = {name: value for name in ('deadline', 'liveliness_lease_duration')
             if 0 < (value := getattr(profile, name)).nanoseconds < _ENDLESS}
    return QoSProfile(depth=1, reliability=profile.reliability, durability=profile.durability,
                      **given)


class Namesakes:
    """
    The other processes that run a node of the name of ``node``, a ConfiguredNode.

    To make it took ``effort`` [s].

    Two plants would show the controller two arms by turns, and the zero torque of a bridge that
    waits would chop that of another. So a node asks for its like on /diagnostics before it does
    anything else; ConfigError if one answers. Where both start at once, or are late to discover
    each other, the reports of Health tell: ``on_elder`` is called with a sentence in the process
    that was started later, ``answer`` in the other. A process that was killed answers nothing,
    though the graph has it for another 20 s.
    """

    def __init__(self, node, effort=0.0):
        self._node, self.on_elder, self.answer = node, self._refuse, self.say
        self._name, self._met = node.get_fully_qualified_name(), set()
        self._since, self._process = time.time_ns(), f'{os.getpid()} on {gethostname()}'
        self._starting = True
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._subscription = node.create_subscription(  # raw: a robot has hundreds of others
            DiagnosticArray, DIAGNOSTICS, self._hear, 10, raw=True, event_callbacks=NO_EVENTS)
        self._ask(_ANSWER if node.direct.known else max(_DISCOVERY, _BUSY * effort))
        self._starting, node.direct.known = False, True

    def _ask(self, patience):
        take, begin = self._subscription.handle.take_message, time.monotonic()
        end, known = begin + patience, self._known_of_others()
        while (moment := time.monotonic()) < end:
            self.say()
            if (more := self._known_of_others()) != known:
                known, end = more, max(end, min(moment + _STEP, begin + _STEPS))
            time.sleep(_ASK_PERIOD)
            while (taken := take(DiagnosticArray, True)) is not None:
                self._hear(taken[0])

    def _known_of_others(self):
        """Return what changes step by step as others are discovered, before they answer."""
        return (self._node.count_publishers(DIAGNOSTICS),
                self._publisher.get_subscription_count(), len(self._node.get_node_names()))

    def say(self, level=DiagnosticStatus.OK, sentence='starting', figures=None) -> DiagnosticArray:
        """Publish how the node is, and since when its process runs it; return the message."""
        marks = {_PROCESS: self._process, _STARTING if self._starting else _RUNNING: self._since}
        message = DiagnosticArray(status=[DiagnosticStatus(
            level=level, name=self._name.strip('/'), message=sentence, hardware_id=self._name,
            values=[KeyValue(key=key, value=str(value))
                    for key, value in {**(figures or {}), **marks}.items()])])
        message.header.stamp = now(self._node).to_msg()
        self._publisher.publish(message)
        return message

    def _hear(self, data):
        if self._name.encode() not in data:
            return
        with suppress(RuntimeError, ValueError):  # bytes that make no message or no text
            for status in deserialize_message(data, DiagnosticArray).status:
                if status.hardware_id == self._name:
                    self._meet({pair.key: pair.value for pair in status.values})

    def _meet(self, said):
        """Compare processes by what one ``said``: who runs comes before who starts."""
        starting = _STARTING in said
        since = said.get(_STARTING if starting else _RUNNING, '')
        if not since.isdecimal() or len(since) > _DIGITS:
            return
        other = starting, int(since), said.get(_PROCESS, '')
        own = self._starting, self._since, self._process
        if other < own:
            self.on_elder(
                f'{self._name} runs already, as process {other[-1]}: end it, or start this one '
                'in another namespace (--ros-args -r __ns:=/left) or with another ROS_DOMAIN_ID')
        elif other > own:
            self.answer()
            if other[1:] not in self._met:
                self._met.add(other[1:])
                self._node.get_logger().warning(
                    f'a second {self._name} was started, as process {other[-1]}: it ends by '
                    'itself')

    @staticmethod
    def _refuse(sentence):
        raise ConfigError(sentence)
