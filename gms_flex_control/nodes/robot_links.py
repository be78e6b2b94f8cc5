# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The ways from the bridge to a robot: topics, or a Device; and a guardian process beside it.

ros2_control's effort controllers hold the last effort for ever; nobody else would take it back
when the bridge dies or freezes. The bridge writes to a pipe while it lives. The guardian publishes
nothing until that ends, and then zero.
"""

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware import device as devices
from gms_flex_control.hardware.device import DeviceError
from gms_flex_control.hardware.supervision import STOOD_STILL
from gms_flex_control.nodes import messages, process, scheduling
from gms_flex_control.nodes.topics import Inbox, Serialized
import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_NEWEST = QoSProfile(depth=1)             # reliable; an older torque is of no use to anybody
_REOPEN_PERIOD, _READ_TIMEOUT = 0.5, 0.05  # [s]
_BEAT, _END = b'.', b'q'
_PERIOD = 0.005            # between zeros [s]
_AFTERWARDS = 0.5          # zeros for a dead bridge last so long; a new one may come [s]


def _efforts(node, array, joint, names):
    """Return (publisher, message of zeros) for the topics of efforts that are not ''."""
    found = []
    for topic, message in ((array, Float64MultiArray(data=[0.0] * len(names))),
                           (joint, JointState(name=list(names), effort=[0.0] * len(names)))):
        if topic:
            found.append((node.create_publisher(type(message), topic, _NEWEST), message))
    return found


class TopicLink:
    """
    A robot that publishes JointState and takes efforts, as ros2_control has it.

    ``robot``, a BridgedRobot, takes the joint states; ``names`` are those of the actuators in the
    order of the efforts; ``boxes`` the Inboxes of the node.
    """

    errors = ()

    def __init__(self, node, robot, values, names, boxes):
        self._node, self._robot = node, robot
        self._refuse_own_topics(values)
        for source, topic in enumerate(values['bridge.state_topics']):
            Inbox(node, JointState, topic, self._taker(source), boxes=boxes)
        kind = values['bridge.command_type']
        array_topic = '' if kind == 'joint_state' else values['bridge.command_topic']
        joint_topic = '' if kind == 'array' else values['bridge.joint_command_topic']
        self._efforts = _efforts(node, array_topic, joint_topic, names)
        self._array = [Serialized(message) for _, message in self._efforts[:bool(array_topic)]]
        self._guardian, self._known_rivals = None, 0
        if values['bridge.guardian']:
            self._guardian = Guardian(
                f'_{node.get_name()}_guardian', *(topic and node.resolve_topic_name(topic)
                                                  for topic in (array_topic, joint_topic)),
                names, values['realtime_priority'])

    def _refuse_own_topics(self, values):
        taken = {self._node.resolve_topic_name(name): name
                 for name in ('joint_states', 'effort_controller/commands')}
        topics = dict.fromkeys(values['bridge.state_topics'], 'bridge.state_topics')
        topics |= {values[key]: key for key in ('bridge.command_topic',
                                                'bridge.joint_command_topic')}
        for topic, key in topics.items():
            if self._node.resolve_topic_name(topic) in taken:
                raise ConfigError(
                    f'{key}: {self._node.resolve_topic_name(topic)} is the topic between bridge '
                    'and controller; start our nodes or the robot in another namespace '
                    '(--ros-args -r __ns:=/gms)')

    def _taker(self, source):
        def on_robot_states(message):
            return self._robot.take_state(
                source, message.name, message.position, message.velocity, message.effort,
                messages.to_nanoseconds(message.header.stamp))
        return on_robot_states

    def write(self, efforts) -> None:
        """Publish efforts (list of float) in the robot's units and order."""
        data = messages.array('d', efforts)
        for publisher, message in self._efforts:
            if isinstance(message, JointState):
                message.effort = data
                messages.set_stamp(message.header.stamp, time.time_ns())
                publisher.publish(message)
            else:
                message.data = data
                publisher.handle.publish_raw(self._array[0].data())  # as an Outlet does

    def beat(self) -> None:
        """Signal to the guardian that the bridge lives."""
        if self._guardian is not None:
            self._guardian.beat()

    @property
    def broken(self) -> str:
        """Return a sentence if the way to the robot is broken; else ''."""
        if self._guardian is not None and self._guardian.ended:
            return 'the guardian process has ended; start the bridge anew'
        return ''

    def obstacle(self) -> str:
        """Return what stands against torque here (str); '' if nothing does."""
        listeners = self._listeners()
        if not listeners:
            return 'nobody takes the efforts'
        if self._guardian is not None and self._guardian.heard_by < listeners:
            return (self.broken or f'the guardian reaches {self._guardian.heard_by} of the '
                                   f'{listeners} subscribers of the efforts')
        return ''

    def _listeners(self):
        return sum(publisher.get_subscription_count() for publisher, _ in self._efforts)

    def _rivals(self):
        """Return how many more publish efforts; say so when they become more."""
        ours = 1 + (self._guardian is not None)
        topics = [publisher.topic_name for publisher, _ in self._efforts]
        rivals = sum(max(self._node.count_publishers(topic) - ours, 0) for topic in topics)
        if rivals > self._known_rivals:
            self._node.get_logger().warning(
                f"{rivals} more publish on {' and '.join(topics)}: the robot obeys all of them; "
                'end them, if they are not gone already (one that was killed is counted for 20 s)')
        self._known_rivals = rivals
        return rivals

    def __enter__(self):
        """Return the link; it listens since it was made."""
        return self

    def __exit__(self, *_):
        """Leave the topics to the node."""

    def finish(self) -> None:
        """Wait until those who acknowledge have the last efforts."""
        for publisher, _ in self._efforts:
            publisher.wait_for_all_acked(process.GOODBYE)
        if self._guardian is not None:
            self._guardian.end()

    def figures(self) -> dict:
        """Return what to report."""
        figures = {'listeners of the efforts': self._listeners(),
                   'publishers of the efforts beside the bridge': self._rivals()}
        if self._guardian is not None:
            figures['listeners of the guardian'] = self._guardian.heard_by
        return figures


class DeviceLink:
    """A robot behind a Device, read in a thread; connected again whenever the link broke."""

    errors = (DeviceError,)

    def __init__(self, node, robot, values, names, _boxes):
        self._node, self._robot = node, robot
        self._name = values['bridge.device']
        self._device = devices.find(self._name, values['bridge.device_options'], names)
        self._names = list(self._device.names)
        self._connected, self._failures = False, 0
        self._unwritten = None     # error of a write, upon which the link is opened again
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._read, name='device', daemon=True)

    def _read(self):
        while not self._over.is_set():
            try:
                if not self._connected:
                    self._device.connect()
                    self._connected, self._unwritten = True, None
                    self._node.get_logger().info(f'device {self._name} is connected')
                sample = self._device.read(_READ_TIMEOUT)
                if sample is not None:
                    self._robot.take_state(0, self._names, sample.position, sample.velocity,
                                           sample.effort, sample.stamp)
                if self._unwritten is not None:
                    raise self._unwritten
            except DeviceError as error:
                self._break(error)
                self._over.wait(_REOPEN_PERIOD)
            except Exception as error:  # noqa: B902  of a library we do not know
                self._node.health.failed(error, f'device {self._name}')
                self._break(error)
                self._over.wait(_REOPEN_PERIOD)

    def _break(self, error):
        if self._connected or self._failures == 0:
            self._node.get_logger().warning(f'device {self._name}: {error}')
        self._failures += 1
        self._robot.fail(f'device {self._name}: {error}')  # zero, if it can still be written
        self._connected = False
        self._close()

    def _close(self):
        try:
            self._device.close()
        except Exception as error:  # noqa: B902  of a library we do not know
            self._node.get_logger().warning(f'device {self._name} failed to close: {error!r}')

    def write(self, efforts) -> None:
        """Send efforts (list of float); nothing happens without a connection."""
        if not self._connected:
            return
        try:
            self._device.write(efforts)
        except DeviceError as error:
            self._unwritten = error
            raise DeviceError(f'device {self._name}: {error}') from error
        except Exception as error:  # noqa: B902  of a library we do not know
            self._unwritten = DeviceError(f'it failed to write: {error!r}')
            raise DeviceError(f'device {self._name} failed to write: {error!r}') from error

    def beat(self) -> None:
        """Do nothing: a device ends its torque by itself."""

    @property
    def broken(self) -> str:
        """Return a sentence if the way to the robot is broken; else ''."""
        return '' if self._connected else f'device {self._name} is not connected'

    def obstacle(self) -> str:
        """Return what stands against torque here (str); '' if nothing does."""
        return self.broken

    def __enter__(self):
        """Begin to read the device, in a thread of its own."""
        self._thread.start()
        return self

    def __exit__(self, *_):
        """Stop reading, and wait a second at most for the thread."""
        self._over.set()
        self._thread.join(timeout=1.0)

    def finish(self) -> None:
        """Disconnect."""
        self._close()

    def figures(self) -> dict:
        """Return what to report."""
        return {'device connected': self._connected, 'device failures': self._failures,
                **self._device.figures()}


# the guardian ------------------------------------------------------------------------------


class Guardian:
    """
    The bridge's side: start the process, and signal to it that the bridge lives.

    ``name`` is that of its node; ``array`` and ``joint`` the topics of the efforts as
    Float64MultiArray and as JointState, '' for none; ``names`` those of the actuators.
    """

    def __init__(self, name, array, joint, names, priority):
        given = json.dumps([name, array, joint, list(names), priority])
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'gms_flex_control.nodes.robot_links', given,
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
        try:
            self._process.stdin.write(data)
        except OSError:
            pass  # it is dead, which `ended` reports, or frozen with a full pipe

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


def _heard_by(zeros, before, pipe):
    """Return how many listen to the zeros; say so to a pipe if it is not as ``before``."""
    count = min(255, sum(publisher.get_subscription_count() for publisher, _ in zeros))
    if count != before:
        os.write(pipe, bytes([count]))
    return count


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
    zeros, count = _efforts(node, array, joint, names), 0
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
            count = _heard_by(zeros, count, pipe)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    _guard()
