# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The cascade controller with friction observer as a ROS 2 node: one command per joint state."""

import os
import sys
import time
from typing import NamedTuple

from gms_flex_control.control.gain_conditions import violations
from gms_flex_control.nodes import messages, process
from gms_flex_control.nodes.messages import NANOSECONDS
from gms_flex_control.nodes.parameters import NodeParameters
from gms_flex_control.schema.build import controller_from_values, robot_from_values
from gms_flex_control.schema.keys import controller_keys, controller_node_keys, robot_keys
from gms_flex_control.simulation.stepped import SteppedController
from gms_flex_control.trajectory.segments import extrapolate
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

_LONGEST_TICK = 0.5  # a longer gap between states starts the observer anew [s]
_LONGEST_SILENCE = 0.03  # of the joint states; then zero torque, real time only [s]
_LONGEST_GOODBYE = Duration(seconds=0.5)  # a subscriber may be frozen
_WARN_PERIOD = 5.0   # [s]
_KEPT_REFERENCES = 4


class Reference(NamedTuple):
    """One reference as received."""

    quantity: str        # 'motion' or 'effort'
    value: np.ndarray    # (5, n) or (1, n)


class ControllerNode(Node):
    """Run the cascade controller on every joint state received."""

    def __init__(self, **kwargs):
        super().__init__('cascade_controller',
                         automatically_declare_parameters_from_overrides=True, **kwargs)
        parameters = NodeParameters(self, lambda joints: (
            *robot_keys(joints), *controller_keys(joints), *controller_node_keys()))
        values, joints = parameters.values, parameters.joints
        robot = robot_from_values(values)
        gains = controller_from_values(values, joints)
        self._lockstep = values['mode'] == 'lockstep'
        self._timeout = round(NANOSECONDS * values['reference_timeout'])
        self._every = values['state_every']
        self._robot = robot
        self._controller = SteppedController(gains, robot)
        self._limit = gains.torque_limit
        self._reader = messages.JointStateReader(robot.joints, robot.motors)
        self._command = messages.CommandWriter(
            robot.n_joints, f'{self.get_fully_qualified_name()}#{os.getpid()}')
        self._zero = np.zeros(robot.n_joints)
        self._references = {}
        self._last = None        # stamp of the state answered last
        self._answered = None    # when the last state was answered [s]; None after a silence
        self._waiting = None     # stamp of a state that waits for its reference, lockstep only
        self._ticks = 0
        self._warned = []        # sentences on the gains as they are
        self._warm_up()
        self._create_topics(values['mode'])
        parameters.watch(lambda new: controller_from_values(new, joints), self._use)
        self._warn_of_conditions(gains)
        self.get_logger().info(f"compensation {gains.compensation}, {values['mode']}")

    def _create_topics(self, mode):
        n, blocks = self._robot.friction.stiffness.shape
        self._state = JointState(name=list(self._robot.joints))
        self._blocks = Float64MultiArray(layout=MultiArrayLayout(dim=[
            MultiArrayDimension(label='joint', size=n, stride=n * blocks),
            MultiArrayDimension(label='block', size=blocks, stride=blocks)]))
        qos, depth = process.subscriber_qos(mode), process.publisher_qos(mode)
        self._command_pub = self.create_publisher(
            Float64MultiArray, 'effort_controller/commands', depth)
        self._state_pub = self.create_publisher(JointState, '~/state', depth)
        self._blocks_pub = self.create_publisher(Float64MultiArray, '~/blocks', depth)
        self.create_subscription(Float64MultiArray, 'reference', self._on_reference, qos,
                                 event_callbacks=process.NO_EVENTS)
        self.create_subscription(JointState, 'joint_states', self._on_joint_states, qos,
                                 event_callbacks=process.NO_EVENTS)

    def run(self, spinner):
        """Answer joint states until a signal comes."""
        while spinner.goes_on():
            spinner.spin_once(0.5 * _LONGEST_SILENCE)
            self._watch()

    def _warm_up(self):
        """Compile before the first state comes."""
        self._controller.tick(np.zeros((5, self._robot.n_joints)), 0.0)
        self._controller.reset()

    def _use(self, gains):
        self._controller.use(gains)
        self._limit = gains.torque_limit
        self._warn_of_conditions(gains)

    def _warn_of_conditions(self, gains):
        broken = violations(gains, self._robot)
        for sentence in broken:
            if sentence not in self._warned:
                self.get_logger().warning(sentence)
        self._warned = broken

    def _on_reference(self, message):
        try:
            reference = Reference(*messages.read_reference(message, self._robot.n_joints))
        except messages.RefusedError as error:
            self.get_logger().warning(f'reference refused: {error}',
                                      throttle_duration_sec=_WARN_PERIOD)
            return
        stamp = messages.read_stamp(message)
        if stamp is None:
            stamp = self._last if self._last is not None else 0
        self._references[stamp] = reference
        if len(self._references) > _KEPT_REFERENCES:
            del self._references[next(iter(self._references))]
        if self._waiting is not None and stamp == self._waiting:
            self._answer(self._waiting)

    def _on_joint_states(self, message):
        stamp = messages.to_nanoseconds(message.header.stamp)
        if self._last is not None and stamp == self._last:
            if self._lockstep:  # sent again: the answer was lost or came before the plant
                self._publish_command(self._controller.state.command, stamp)
            return
        if self._lockstep and stamp == self._waiting:  # sent again while we wait
            self.get_logger().info('waiting for a reference; is trajectory_node running?',
                                   throttle_duration_sec=_WARN_PERIOD, skip_first=True)
            return
        try:
            self._reader.read(message, self._controller.measured)
        except messages.RefusedError as error:
            self.get_logger().warning(f'joint state refused: {error}',
                                      throttle_duration_sec=_WARN_PERIOD)
            return
        if self._lockstep and stamp not in self._references:
            self._waiting = stamp
            return
        self._answer(stamp)

    def _elapsed(self, stamp):
        """Return the time since the state before [s]; 0 where the observer begins anew."""
        if self._last is None:
            return 0.0
        elapsed = (stamp - self._last) / NANOSECONDS
        if 0.0 < elapsed <= _LONGEST_TICK:
            return elapsed
        self.get_logger().warning(f'joint states jumped by {elapsed:.3f} s: observer begins anew',
                                  throttle_duration_sec=_WARN_PERIOD)
        self._controller.reset()
        return 0.0

    def _reference_at(self, stamp):
        """Return the Reference for a state, moved to its time; None if all are too old."""
        reference = self._references.get(stamp)
        if reference is not None or not self._references:
            return reference
        nearest = min(self._references, key=lambda known: abs(known - stamp))
        if abs(stamp - nearest) > self._timeout:
            return None
        reference = self._references[nearest]
        if reference.quantity == messages.EFFORT:
            return reference
        return Reference(reference.quantity,
                         extrapolate(reference.value, (stamp - nearest) / NANOSECONDS))

    def _answer(self, stamp):
        self._waiting = None
        elapsed = self._elapsed(stamp)
        reference = self._reference_at(stamp)
        self._last, self._answered = stamp, time.monotonic()
        if reference is None:
            self._give_zero(stamp)
            self.get_logger().warning('no reference: zero torque; is trajectory_node running?',
                                      throttle_duration_sec=_WARN_PERIOD, skip_first=True)
            return
        if reference.quantity == messages.EFFORT:
            self._controller.reset()
            self._controller.state.command[:] = np.clip(reference.value[0], -self._limit,
                                                        self._limit)
        else:
            self._controller.tick(reference.value, elapsed)
        if not messages.all_finite(self._controller.state.command.tolist()):
            self._give_zero(stamp)
            self.get_logger().error('the law gave no finite torque: zero torque; are state or '
                                    'reference plausible?', throttle_duration_sec=_WARN_PERIOD)
            return
        self._publish_command(self._controller.state.command, stamp)
        self._ticks += 1
        if self._ticks % self._every == 0:
            self._publish_state(stamp)

    def _give_zero(self, stamp):
        """Command nothing and forget the motion so far."""
        self._controller.reset()
        self._publish_command(self._zero, stamp)

    def _watch(self):
        """Command nothing once states have stopped or have all been refused."""
        if (self._answered is None or self._lockstep
                or time.monotonic() - self._answered <= _LONGEST_SILENCE):
            return
        self._answered = None
        self._give_zero(self._last)
        self.get_logger().warning(f'no usable joint state for {_LONGEST_SILENCE * 1e3:g} ms: '
                                  'zero torque', throttle_duration_sec=_WARN_PERIOD)

    def _publish_command(self, torque, stamp):
        self._command_pub.publish(self._command.write(torque, stamp))

    def _publish_state(self, stamp):
        state, message = self._controller.state, self._state
        if not self._state_pub.get_subscription_count() and \
                not self._blocks_pub.get_subscription_count():
            return  # three messages a tick cost more than one
        messages.set_stamp(message.header.stamp, stamp)
        message.position = messages.array('d', state.error.tolist())
        message.velocity = messages.array('d', state.error_rate.tolist())
        message.effort = messages.array('d', state.friction_hat.tolist())
        self._state_pub.publish(message)
        self._blocks.data = messages.array('d', state.observer.blocks.torque.ravel().tolist())
        self._blocks_pub.publish(self._blocks)

    def finish(self):
        """Leave zero torque on the wire, and stay until those who acknowledge have it."""
        stamp = self._last if self._last is not None else 0
        self._publish_command(self._zero, stamp)
        self._command_pub.wait_for_all_acked(_LONGEST_GOODBYE)


def main(args=None):
    """Run the controller node until a signal; return its exit code."""
    return process.run_node(ControllerNode, args)


if __name__ == '__main__':
    sys.exit(main())
