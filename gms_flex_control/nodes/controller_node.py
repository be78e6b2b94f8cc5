# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The cascade controller with friction observer as a ROS 2 node: one command per joint state."""

import os
import time

from gms_flex_control.control.feedforward import as_parameters, compensated
from gms_flex_control.control.gain_conditions import violations
from gms_flex_control.nodes import messages, scheduling
from gms_flex_control.nodes.following import Follower, Reference
from gms_flex_control.nodes.health import Health, WARN
from gms_flex_control.nodes.parameters import ConfiguredNode, NodeParameters
from gms_flex_control.nodes.topics import Inbox, Outlet
from gms_flex_control.schema.build import controller_from_values, robot_from_values
from gms_flex_control.schema.keys import controller_keys, CONTROLLER_NODE, robot_keys
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_LONGEST_SILENCE = 0.03  # of the joint states; then zero torque, real time only [s]
_ZEROS = 10          # sent one silence apart while it lasts: one may be lost
_WARN_PERIOD = 5.0   # [s]


class _Silence:
    """Since when no joint state was answered, and how many zeros were sent since."""

    def __init__(self, watched):
        self._watched, self._answered = watched, None  # when, None before the first [s]
        self.zeros, self._longest = 0, 0.0

    def end(self) -> bool:
        """Note that a state is answered; return whether zeros were sent before it."""
        now = time.monotonic()
        if self._answered is not None:
            self._longest = max(self._longest, now - self._answered)
        self._answered, zeros, self.zeros = now, self.zeros, 0
        return zeros > 0

    def _left(self):
        """Return how long it is to the next zero [s]; None where none is to be sent."""
        if self._answered is None or not self._watched or self.zeros >= _ZEROS:
            return None
        return self._answered + (self.zeros + 1) * _LONGEST_SILENCE - time.monotonic()

    def patience(self) -> float:
        """Return how long to wait for the next message [s]."""
        left = self._left()
        return _LONGEST_SILENCE if left is None else min(max(left, 1e-4), _LONGEST_SILENCE)

    def is_due(self) -> bool:
        """Return whether zero is to be sent now."""
        left = self._left()
        return left is not None and left <= 0.0

    def longest(self) -> float:
        """Return the longest time between two answers since the last call [s]."""
        longest, self._longest = self._longest, 0.0
        return longest


class _Outputs:
    """What the node publishes: each command, and how the law does to whoever listens."""

    def __init__(self, node, robot, mode, every):
        n, blocks = robot.friction.stiffness.shape
        self._command = messages.ArrayWriter(
            ('joint', n), source=f'{node.get_fully_qualified_name()}#{os.getpid()}')
        self._blocks = messages.ArrayWriter(('joint', n), ('block', blocks))
        self._state = JointState(name=list(robot.joints))
        self._every, self._ticks = every, 0
        self.sent, self._zero = np.zeros((2, n))  # the last command
        self._command_pub = Outlet(node, Float64MultiArray, 'effort_controller/commands', mode,
                                   ahead=True)
        self._state_pub = Outlet(node, JointState, '~/state', mode)
        self._blocks_pub = Outlet(node, Float64MultiArray, '~/blocks', mode)
        self._sticking_pub = Outlet(node, Float64MultiArray, '~/sticking', mode)

    def command(self, torque, stamp) -> None:
        self.sent[:] = torque
        self._command_pub.publish(self._command.write(torque, stamp))

    def zero(self, stamp) -> None:
        self.command(self._zero, stamp)

    def state(self, state, left, stamp) -> None:
        """Publish errors, estimates and blocks; ``left`` as of Handover."""
        self._ticks += 1
        if self._ticks % self._every or not any(publisher.count_hearers() for publisher in (
                self._state_pub, self._blocks_pub, self._sticking_pub)):
            return  # four messages a tick cost more than one
        message, error, rate = self._state, state.error, state.error_rate
        messages.set_stamp(message.header.stamp, stamp)
        if left is not None:  # the error is that from the reference as received
            error, rate = error + left[0], rate + left[1]
        message.position = messages.array('d', error.tolist())
        message.velocity = messages.array('d', rate.tolist())
        message.effort = messages.array('d', state.friction_hat.tolist())
        self._state_pub.publish(message)
        blocks = state.observer.blocks
        self._blocks_pub.publish(self._blocks.write(blocks.torque, stamp))
        if self._sticking_pub.count_hearers():
            self._sticking_pub.publish(self._blocks.write(blocks.sticking.astype(float), stamp))

    def finish(self, stamp) -> None:
        """Leave zero on the wire, and stay until those who acknowledge have it."""
        self.zero(stamp)
        for publisher in (self._command_pub, self._state_pub):
            publisher.wait_for_all_acked()

    def are_heard(self, recorders) -> bool:
        """Return whether the plant hears the commands, and so many recorders these and states."""
        return (self._command_pub.count_hearers() > recorders
                and self._state_pub.count_hearers() >= recorders)


class ControllerNode(ConfiguredNode):
    """Run the cascade controller on every joint state received."""

    def __init__(self, direct=None, **kwargs):
        super().__init__('cascade_controller', direct, **kwargs)
        parameters = NodeParameters(self, lambda joints: (
            *robot_keys(joints), *controller_keys(joints), *CONTROLLER_NODE))
        values, joints = parameters.values, parameters.joints
        self._robot = robot = robot_from_values(values)
        gains = controller_from_values(values, joints)
        self._lockstep, self._recorders = values['mode'] == 'lockstep', values['recorders']
        self._waiting = None     # stamp of a state that waits for its reference, lockstep only
        self._warned = []        # sentences on the gains as they are
        self._counts = dict.fromkeys(('states answered', 'states refused', 'references refused',
                                      'silences'), 0)
        self.health = Health(self, self._figures, self._on_fault)
        self.follower = Follower(robot, gains, values, self.health)
        self._reader = messages.JointStateReader(robot.joints, robot.motors)
        self._silence = _Silence(watched=not self._lockstep)
        self._watched = self.health.guard(self._watch)
        self._outputs = _Outputs(self, robot, values['mode'], values['state_every'])
        Inbox(self, Float64MultiArray, 'reference', self._on_reference, values['mode'])
        Inbox(self, JointState, 'joint_states', self._on_joint_states, values['mode'])
        self.serve('reset', self._reset)
        parameters.watch(lambda new: controller_from_values(new, joints), self._use,
                         self.health.guard)
        self._warn_of_conditions(gains)
        self.get_logger().info(f"compensation {gains.compensation}, {values['mode']}")
        beyond = [f'{spec.name} of {spec.joint}' for spec in robot.effects
                  if not compensated(spec.name)]
        if beyond:
            self.get_logger().info(f'the model has, not compensated: {", ".join(beyond)}')
        scheduling.take_priority(self, values['realtime_priority'])

    @property
    def sent(self) -> np.ndarray:
        """Return the last command (n_joints,) [N m], in an array that is used again."""
        return self._outputs.sent

    def run(self, spinner) -> None:
        """Answer joint states until a signal comes."""
        self.wait_for_recorders(spinner, self._recorders, self._outputs.are_heard)
        while spinner.goes_on():
            self.attend(spinner)

    def attend(self, spinner) -> None:
        """Run callbacks until the joint states may have stopped, and look whether they have."""
        spinner.spin_for(self._silence.patience())
        self._watched()

    def _use(self, gains):
        self.follower.use(gains)
        self._warn_of_conditions(gains)

    def _warn_of_conditions(self, gains):
        broken = violations(gains, as_parameters(self._robot))
        for sentence in broken:
            if sentence not in self._warned:
                self.get_logger().warning(sentence)
        self._warned = broken

    def _on_reference(self, message):
        """Return whether the message was accepted, and is of this time."""
        follower = self.follower
        try:
            reference = Reference(*messages.read_reference(message, self._robot.n_joints))
        except messages.RefusedError as error:
            self._counts['references refused'] += 1
            self.health.warn('reference', f'reference refused: {error}')
            return False
        stamp, source = messages.read_marks(message)
        if stamp is None:
            stamp = follower.last or 0
        follower.keep(stamp, reference, source)
        if self._waiting is not None and stamp == self._waiting:
            self._answer(self._waiting)
        return follower.is_fresh(stamp)

    def _on_joint_states(self, message):
        """Return whether the message was read and accepted."""
        stamp, last = messages.to_nanoseconds(message.header.stamp), self.follower.last
        if self.health.fault:
            self._outputs.zero(stamp)
            return False
        if stamp == last:
            if self._lockstep:  # sent again: the answer was lost or came before the plant
                self._outputs.command(self._outputs.sent, stamp)
            return False
        if self._lockstep and stamp == self._waiting:  # sent again while we wait
            self.health.report(WARN, 'waiting for a reference')
            self.get_logger().info('waiting for a reference; is trajectory_node running?',
                                   throttle_duration_sec=_WARN_PERIOD, skip_first=True)
            return False
        if not self._lockstep and not self._silence.zeros and messages.is_overtaken(stamp, last):
            return False
        try:
            self._reader.read(message, self.follower.controller.measured)
        except messages.RefusedError as error:
            self._counts['states refused'] += 1
            self.health.warn('joint state', f'joint state refused: {error}')
            return False
        self.follower.encoders.act(self._outputs.sent, self._reader.motor_efforts(message))
        if self._lockstep and not self.follower.references.has(stamp):
            self._waiting = stamp
        else:
            self._answer(stamp)
        return True

    def _answer(self, stamp):
        self._waiting = None
        self._counts['states answered'] += 1
        follower = self.follower
        self._outputs.command(follower.answer(stamp, self._silence.end()), stamp)
        if follower.follows:
            self._outputs.state(follower.controller.state, follower.handover.left, stamp)

    def _watch(self):
        """Command nothing once states have stopped or have all been refused."""
        if self.health.fault or not self._silence.is_due():  # a fault answers every state so
            return
        # the observer is left as it is: what it knows still holds after a short silence
        self._outputs.zero(self.follower.last)
        self._silence.zeros += 1
        if self._silence.zeros == 1:
            self._counts['silences'] += 1
            sentence = f'no usable joint state for {_LONGEST_SILENCE * 1e3:g} ms: zero torque'
            self.health.report(WARN, sentence)
            self.health.warn('silence', sentence)

    def _on_fault(self):
        self._waiting = None
        self._outputs.zero(self.follower.last or 0)

    def _reset(self):
        """End a fault: begin anew from the measured state."""
        self.follower.reset()
        self.health.recover()
        return True, 'begins anew from the measured state'

    def _figures(self):
        return {**self._counts, **self.follower.counts,
                'frozen encoders': self.follower.encoders.count,
                'longest time between answers [ms]': f'{self._silence.longest() * 1e3:.1f}'}

    def finish(self) -> None:
        """Leave zero torque on the wire."""
        self._outputs.finish(self.follower.last or 0)
