# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""How the bridge reaches a robot: topics of ros2_control, or a device."""

import threading
import time

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware import device as devices
from gms_flex_control.hardware.device import DeviceError
from gms_flex_control.nodes import messages
from gms_flex_control.nodes.guardian import Guardian
from gms_flex_control.nodes.inbox import Inbox
from gms_flex_control.nodes.serialized import Serialized
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_LONGEST_GOODBYE = Duration(seconds=0.5)  # a subscriber may be frozen
_NEWEST = QoSProfile(depth=1)             # reliable; an older torque is of no use to anybody
_REOPEN_PERIOD, _READ_TIMEOUT = 0.5, 0.05  # [s]


class TopicLink:
    """
    A robot that publishes JointState and takes efforts, as ros2_control has it.

    Parameters
    ----------
    node : rclpy.node.Node
        The plant.
    robot : BridgedRobot
        Takes the joint states.
    values : dict of str to object
        Checked parameters.
    names : tuple of str
        Of the actuators, in the order of the efforts.
    boxes : list of Inbox
        Those of the node.

    """

    errors = ()

    def __init__(self, node, robot, values, names, boxes):
        self._node, self._robot = node, robot
        self._refuse_own_topics(values)
        for source, topic in enumerate(values['bridge.state_topics']):
            Inbox(node, JointState, topic, self._taker(source), boxes=boxes)
        kind = values['bridge.command_type']
        self._array_pub = self._joint_pub = None
        if kind != 'joint_state':
            self._array_pub = node.create_publisher(
                Float64MultiArray, values['bridge.command_topic'], _NEWEST)
        if kind != 'array':
            self._joint_pub = node.create_publisher(
                JointState, values['bridge.joint_command_topic'], _NEWEST)
        self._publishers = list(filter(None, (self._array_pub, self._joint_pub)))
        self._array = Float64MultiArray(data=[0.0] * len(names))
        self._joint, self._serialized = JointState(name=list(names)), Serialized(self._array)
        self._guardian, self._known_rivals = None, 0
        if values['bridge.guardian']:
            self._guardian = Guardian(
                f'_{node.get_name()}_guardian',
                *(publisher.topic_name if publisher else ''
                  for publisher in (self._array_pub, self._joint_pub)),
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

    def write(self, efforts):
        """Publish efforts (list of float) in the robot's units and order."""
        data = messages.array('d', efforts)
        if self._array_pub is not None:
            self._array.data = data
            self._array_pub.publish(self._serialized.data())
        if self._joint_pub is not None:
            self._joint.effort = data
            messages.set_stamp(self._joint.header.stamp, time.time_ns())
            self._joint_pub.publish(self._joint)

    def beat(self):
        """Tell the guardian that the bridge lives."""
        if self._guardian is not None:
            self._guardian.beat()

    @property
    def broken(self):
        """Return a sentence if the way to the robot is broken; else ''."""
        if self._guardian is not None and self._guardian.ended:
            return 'the guardian process has ended; start the bridge anew'
        return ''

    def obstacle(self):
        """Return what stands against torque here (str); '' if nothing does."""
        listeners = self._listeners()
        if not listeners:
            return 'nobody takes the efforts'
        if self._guardian is not None and self._guardian.heard_by < listeners:
            return (self.broken or f'the guardian reaches {self._guardian.heard_by} of the '
                                   f'{listeners} subscribers of the efforts')
        return ''

    def _listeners(self):
        return sum(publisher.get_subscription_count() for publisher in self._publishers)

    def _rivals(self):
        """Return how many more publish efforts; say so when they become more."""
        ours = 1 + (self._guardian is not None)
        topics = [publisher.topic_name for publisher in self._publishers]
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

    def finish(self):
        """Wait until those who acknowledge have the last efforts."""
        for publisher in self._publishers:
            publisher.wait_for_all_acked(_LONGEST_GOODBYE)
        if self._guardian is not None:
            self._guardian.end()

    def figures(self):
        """Return what to report."""
        figures = {'listeners of the efforts': self._listeners(),
                   'publishers of the efforts beside the bridge': self._rivals()}
        if self._guardian is not None:
            figures['listeners of the guardian'] = self._guardian.heard_by
        return figures


class DeviceLink:
    """
    A robot behind a Device, read in a thread of its own; see TopicLink.

    It is connected again, with zero torque, whenever the link broke.
    """

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

    def write(self, efforts):
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

    def beat(self):
        """Do nothing: a device ends its torque by itself."""

    @property
    def broken(self):
        """Return a sentence if the way to the robot is broken; else ''."""
        return '' if self._connected else f'device {self._name} is not connected'

    def obstacle(self):
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

    def finish(self):
        """Disconnect."""
        self._close()

    def figures(self):
        """Return what to report."""
        return {'device connected': self._connected, 'device failures': self._failures,
                **self._device.figures()}
