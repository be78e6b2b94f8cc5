# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The ways from the bridge to a robot: topics, or a Device."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
import threading
import time

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware import device as devices
from gms_flex_control.hardware.device import DeviceError
from gms_flex_control.nodes import messages, process
from gms_flex_control.nodes.guardian import efforts, Guardian
from gms_flex_control.nodes.topics import Inbox, Serialized
from sensor_msgs.msg import JointState

_REOPEN_PERIOD, _READ_TIMEOUT = 0.5, 0.05  # [s]


class TopicLink:
    """A robot of JointState and effort topics, as ros2_control's; ``names`` of its actuators."""

    errors = ()
    reading = staticmethod(nullcontext)  # the node reads its topics

    def __init__(self, node, robot, values, names):
        self._node, self._robot = node, robot
        self._refuse_own_topics(values)
        for source, topic in enumerate(values['bridge.state_topics']):
            Inbox(node, JointState, topic, self._taker(source))
        kind = values['bridge.command_type']
        array_topic = '' if kind == 'joint_state' else values['bridge.command_topic']
        joint_topic = '' if kind == 'array' else values['bridge.joint_command_topic']
        self._efforts = efforts(node, array_topic, joint_topic, names)
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

    def __init__(self, node, robot, values, names):
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
            except Exception as error:  # noqa: B902  of a library we do not know
                if not isinstance(error, DeviceError):
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

    @contextmanager
    def reading(self) -> Iterator:
        """Read the device in a thread of its own; wait a second at most for its end."""
        self._thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._thread.join(timeout=1.0)

    def finish(self) -> None:
        """Disconnect."""
        self._close()

    def figures(self) -> dict:
        """Return what to report."""
        return {'device connected': self._connected, 'device failures': self._failures,
                **self._device.figures()}
