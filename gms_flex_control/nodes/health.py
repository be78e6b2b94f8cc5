# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How a node is: what it says on /diagnostics, its faults, and endpoints that do not fit."""

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import wraps
import time
import traceback

from diagnostic_msgs.msg import DiagnosticStatus
from gms_flex_control.hardware.supervision import FAULT
from gms_flex_control.nodes.namesakes import DIAGNOSTICS
from rclpy.clock import Clock, ClockType
from rclpy.logging import LoggingSeverity
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_LOOK_PERIOD = 0.1   # a change is published within this [s]
_LOOKS_PER_REPORT = 10
_REPORTS_PER_COMPARISON = 10  # where as many endpoints are there as before
_WARN_PERIOD = 5.0   # of warnings of one kind [s]
_COMMON = ('rosout', 'parameter_events')
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
        """
        Return ``callback`` such that an exception ends in a fault, not in a dead executor.

        The handler of a service then answers with ``success`` false, if its response has it.
        """
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
            counted, self._reports = _endpoints_of_others(self._node), self._reports + 1
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


def _endpoints_of_others(node):
    """Return how many are at the other end of each endpoint of a node."""
    return (*(node.count_publishers(own.topic_name) for own in node.subscriptions),
            *(node.count_subscribers(own.topic_name) for own in node.publishers))


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
