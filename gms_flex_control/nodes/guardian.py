# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A process beside the bridge that sends zero efforts once the bridge is dead or frozen.

ros2_control's effort controllers hold the last effort for ever; nobody else would take it back.
The bridge writes to a pipe while it lives. The guardian publishes nothing until that ends, and
then zero.
"""

from contextlib import suppress
import json
import os
import select
import signal
import subprocess
import sys
import time

from gms_flex_control.hardware.supervision import STOOD_STILL
from gms_flex_control.nodes import process, scheduling
import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_NEWEST = QoSProfile(depth=1)             # reliable; an older torque is of no use to anybody
_BEAT, _END = b'.', b'q'
_PERIOD = 0.005            # between zeros [s]
_AFTERWARDS = 0.5          # zeros for a dead bridge last so long; a new one may come [s]


def efforts(node, array, joint, names) -> list:
    """Return (publisher, message of zeros) for the topics of efforts that are not ''."""
    found = []
    for topic, message in ((array, Float64MultiArray(data=[0.0] * len(names))),
                           (joint, JointState(name=list(names), effort=[0.0] * len(names)))):
        if topic:
            found.append((node.create_publisher(type(message), topic, _NEWEST), message))
    return found


class Guardian:
    """The bridge's side: start the process, and signal to it that the bridge lives."""

    def __init__(self, name, array, joint, names, priority):
        given = json.dumps([name, array, joint, list(names), priority])
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'gms_flex_control.nodes.guardian', given,
             *_enclave_of(sys.argv)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True)
        for pipe in (self._process.stdin, self._process.stdout):
            os.set_blocking(pipe.fileno(), False)
        self._heard_by = 0

    @property
    def ended(self) -> bool:
        """Return whether the process has ended, which it never should by itself."""
        return self._process.poll() is not None

    @property
    def heard_by(self) -> int:
        """Return how many take its efforts."""
        answer = self._process.stdout.read()
        if answer:
            self._heard_by = answer[-1]
        return self._heard_by

    def beat(self) -> None:
        """Say that the bridge lives; to be called at least every 20 ms."""
        self._write(_BEAT)

    def _write(self, data):
        with suppress(OSError):  # it is dead, which `ended` reports, or frozen with a full pipe
            self._process.stdin.write(data)

    def end(self) -> None:
        """Let it go without a word, the bridge having said the last one."""
        self._write(_END)
        self._process.stdin.close()
        try:
            self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _enclave_of(words):
    """Return the words of a command line that say which keys of SROS2 it uses; [] if none do."""
    if '--enclave' not in words[:-1]:
        return []
    return ['--ros-args', '--enclave', words[words.index('--enclave') + 1]]


def _guard():
    """Watch the standard input until it says that the bridge has ended in order."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the bridge ends first
    name, array, joint, names, priority = json.loads(sys.argv[1])
    pipe = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # where DDS prints, too
    process.avoid_shared_memory()
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=False)
    scheduling.take_priority(node, priority)
    zeros, said = efforts(node, array, joint, names), 0
    heard, dead = time.monotonic(), None
    while dead is None or time.monotonic() < dead + _AFTERWARDS:
        if dead is None and select.select([sys.stdin], [], [], _PERIOD)[0]:
            data = os.read(sys.stdin.fileno(), 65536)
            if _END in data:
                break
            heard, dead = time.monotonic(), None if data else time.monotonic()
        elif dead is not None:
            time.sleep(_PERIOD)
        if dead is not None or time.monotonic() - heard > STOOD_STILL:
            for publisher, message in zeros:
                publisher.publish(message)
        if dead is None:
            count = min(255, sum(publisher.get_subscription_count() for publisher, _ in zeros))
            if count != said:
                os.write(pipe, bytes([count]))
                said = count
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    _guard()
