# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Two processes that run a node of one name: the one that was started later ends."""

from contextlib import suppress
import os
from socket import gethostname
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from gms_flex_control.errors import ConfigError
from gms_flex_control.nodes.messages import now
from gms_flex_control.nodes.process import NO_EVENTS
from rclpy.serialization import deserialize_message

DIAGNOSTICS = '/diagnostics'
_PROCESS, _RUNNING, _STARTING = 'process', 'running since [ns]', 'starting since [ns]'
_DIGITS = 20      # of such a time, at most
# until others are discovered and have answered, as a rule: at least so long, and so many times
# what it took to make the node, which takes the longer the busier the machine is
_DISCOVERY, _BUSY = 0.4, 3.0
_ANSWER = 0.1     # where this process has been discovered before [s]
_LOOK = 0.02      # between looks for it [s]


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
        take, end = self._subscription.handle.take_message, time.monotonic() + patience
        while time.monotonic() < end:
            self.say()
            time.sleep(_LOOK)
            while (taken := take(DiagnosticArray, True)) is not None:
                self._hear(taken[0])

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
