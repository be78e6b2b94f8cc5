# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What a page shows of the running loop: its topics, heard at little cost to the loop beside it.

Messages wait in DDS until they are taken, many at a time; those between two rows are never made
objects of Python. No executor wakes up for each of them.
"""

from functools import partial
import math
from operator import itemgetter
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gms_flex_control.bags.names import link_names, MOTOR_SUFFIX
from gms_flex_control.nodes import messages, process
from gms_flex_control.nodes.serialized import stamp_in
from gms_flex_control.view.live import Rows, SPACING, Status
from gms_flex_control.view.scene import scene_of, unknown_scene
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_SILENCE = 1.0   # of the joint states, before it is said [s]
_DEPTH = 1000    # messages that may wait


class LoopListener:
    """
    Rows of the loop's messages for a Feed, and how its robot is.

    Parameters
    ----------
    node : rclpy.node.Node
        Which subscribes; it is never spun.
    space : str
        Namespace of the loop's topics, '' for none.
    controller : str
        Full name of the controller node.
    feed : Feed
        Takes the rows.

    Attributes
    ----------
    scene : Scene or None
        How to draw the robot; None while nothing is known of it.
    blocks : int
        Friction blocks of each joint.

    """

    def __init__(self, node, space, controller, feed):
        self._node, self._space, self._controller, self._feed = node, space, controller, feed
        self.scene, self.blocks = None, 0
        self._rows = self._names = self._heard = None
        self._links, self._motors = (), ()
        self._robot, self._complaint = Status(), ''
        arrays = {f'{space}/effort_controller/commands': 'command', f'{space}/reference':
                  'reference', f'{controller}/blocks': 'block', f'{controller}/sticking': 'stick'}
        self._heard_topics = [
            self._subscribe(JointState, f'{space}/joint_states', self._on_joint_states),
            self._subscribe(JointState, f'{controller}/state', self._on_state),
            self._subscribe(DiagnosticArray, '/diagnostics', self._on_diagnostics),
            *(self._subscribe(Float64MultiArray, topic, partial(self._on_array, signal))
              for topic, signal in arrays.items())]

    def _subscribe(self, kind, topic, handler):
        """Return a subscription whose messages wait until they are taken, and who handles them."""
        return self._node.create_subscription(
            kind, topic, handler, process.subscriber_qos('realtime', _DEPTH), raw=True,
            event_callbacks=process.NO_EVENTS), handler

    def take_all(self):
        """Take all messages that wait, in the order in which they came."""
        waiting = []
        for subscription, handler in self._heard_topics:
            take, kind = subscription.handle.take_message, subscription.msg_type
            for _ in range(_DEPTH):
                taken = take(kind, True)
                if taken is None:
                    break
                waiting.append((taken[1]['received_timestamp'], handler, taken[0]))
        waiting.sort(key=itemgetter(0))
        for _, handler, data in waiting:
            handler(data)

    def pass_on(self, there):
        """Give the feed what is complete; ``there`` is whether the controller answers."""
        now = time.monotonic()
        if self._rows is not None and self._rows.restarted:
            self._rows.restarted = False
            self._feed.begin_anew()
        rows = () if self._rows is None else self._rows.take(now)
        self._feed.add(rows, {
            'state': self._missing(now, there), 'robot': self._robot.as_dict(now),
            'controller': self._complaint if there else ''})

    def _missing(self, now, there):
        """Return what is missing in a sentence, '' if nothing is."""
        if self._heard is None:
            return f'no joint states on {self._space}/joint_states yet: is plant_node running?'
        if now - self._heard > _SILENCE:
            return f'no joint states for {int(now - self._heard)} s'
        return '' if there else f'{self._controller} is not there'

    def meet(self, robot):
        """Show the robot (RobotParams) that the controller believes in."""
        self._links, self._motors, self._names = robot.joints, robot.motors, None
        scene, blocks = scene_of(robot), robot.friction.stiffness.shape[1]
        if (scene, blocks) != (self.scene, self.blocks):
            self._begin(scene, blocks)

    @property
    def columns(self):
        """Return the names of the columns of a row."""
        return self._rows.names if self._rows else []

    def _begin(self, scene, blocks):
        self.scene, self.blocks = scene, blocks
        self._rows, self._names = Rows(scene.n_joints, blocks, SPACING), None
        self._feed.begin_anew()

    def _on_joint_states(self, data):
        self._heard = time.monotonic()
        if self._rows is not None and not self._rows.wants(stamp_in(data, JointState)):
            return
        message = deserialize_message(data, JointState)
        names = list(message.name)
        if self._rows is None:
            links = link_names(names)
            self._links = tuple(links)
            self._motors = tuple(name + MOTOR_SUFFIX if name + MOTOR_SUFFIX in names else ''
                                 for name in links)
            self._begin(unknown_scene(links, self._motors), 0)
        if names != self._names:
            self._names = names
            self._order = [[names.index(name) if name in names else None for name in side]
                           for side in (self._links, self._motors)]
        link, motor = ([message.position[k] if k is not None and k < len(message.position)
                        else math.nan for k in side] for side in self._order)
        self._rows.put_state(messages.to_nanoseconds(message.header.stamp), self._heard,
                             link, motor)

    def _on_array(self, signal, data):
        if self._rows is None or not self._rows.wants_more(signal, stamp_in(
                data, Float64MultiArray)):
            return
        message = deserialize_message(data, Float64MultiArray)
        dims = message.layout.dim
        if signal != 'reference' or not dims or dims[0].label != messages.EFFORT:
            self._rows.put(signal, messages.read_stamp(message), message.data)

    def _on_state(self, data):
        stamp = stamp_in(data, JointState)
        if self._rows is None or not self._rows.wants_more('error', stamp):
            return
        message = deserialize_message(data, JointState)
        if tuple(message.name) == tuple(self._links):
            self._rows.put('error', stamp, message.position)
            self._rows.put('friction', stamp, message.effort)

    def _on_diagnostics(self, data):
        message = deserialize_message(data, DiagnosticArray)
        for status in message.status:
            if status.hardware_id == f'{self._space}/plant':
                self._robot.report({item.key: item.value for item in status.values},
                                   messages.to_nanoseconds(message.header.stamp) * 1e-9,
                                   time.monotonic())
            elif status.hardware_id == self._controller:
                self._complaint = '' if status.level == DiagnosticStatus.OK else status.message
