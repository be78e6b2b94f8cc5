# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The cascade controller with friction observer as a ROS 2 node: one command per joint state."""

import os
import sys
import time

from gms_flex_control.control.gain_conditions import violations
from gms_flex_control.effect_compensation.feedforward import (
    as_parameters,
    compensated,
    CompensatingController,
)
from gms_flex_control.hardware.command_watch import SourceWatch
from gms_flex_control.nodes import messages, process, references, scheduling
from gms_flex_control.nodes.direct import Direct, Outlet
from gms_flex_control.nodes.encoder_watch import EncoderWatch
from gms_flex_control.nodes.health import Health, OK, WARN
from gms_flex_control.nodes.inbox import Inbox
from gms_flex_control.nodes.messages import NANOSECONDS
from gms_flex_control.nodes.parameters import NodeParameters
from gms_flex_control.nodes.references import Handover, Reference, References
from gms_flex_control.nodes.refusal import all_finite
from gms_flex_control.schema.build import controller_from_values, robot_from_values
from gms_flex_control.schema.keys import controller_keys, robot_keys
from gms_flex_control.schema.node_keys import controller_node_keys
from gms_flex_control.trajectory.segments import extrapolate
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

_LONGEST_TICK = 0.5  # a longer gap between states starts the observer anew [s]
_LONGEST_DELAY = round(0.1 * NANOSECONDS)  # a state older than the last by less was overtaken
_LONGEST_SILENCE = 0.03  # of the joint states; then zero torque, real time only [s]
_ZEROS = 10          # sent one silence apart while it lasts: one may be lost
_LONGEST_GOODBYE = Duration(seconds=0.5)  # a subscriber may be frozen
_WARN_PERIOD = 5.0   # [s]
_PHASES = {
    references.FOLLOWING: (OK, 'following'),
    references.HOLDING: (WARN, 'reference lost: holding'),
    references.RELAXING: (WARN, 'reference lost: letting the torque down to zero')}


class ControllerNode(Node):
    """Run the cascade controller on every joint state received."""

    def __init__(self, direct=None, **kwargs):
        super().__init__('cascade_controller',
                         automatically_declare_parameters_from_overrides=True, **kwargs)
        self.direct = direct or Direct()
        parameters = NodeParameters(self, lambda joints: (
            *robot_keys(joints), *controller_keys(joints), *controller_node_keys()))
        values, joints = parameters.values, parameters.joints
        robot = robot_from_values(values)
        gains = controller_from_values(values, joints)
        self._lockstep = values['mode'] == 'lockstep'
        self._references = References(*(values[f'reference_{what}']
                                        for what in ('timeout', 'hold', 'relax')))
        self._sources = SourceWatch('nodes send references')
        self._handover = Handover(values['resume_time'])
        self._every = values['state_every']
        self._robot = robot
        self._controller = CompensatingController(gains, robot)
        self._limit = gains.torque_limit
        self._encoders = EncoderWatch(robot, gains.torque_limit, self._controller.measured)
        self._reader = messages.JointStateReader(robot.joints, robot.motors)
        self._command = messages.CommandWriter(
            robot.n_joints, f'{self.get_fully_qualified_name()}#{os.getpid()}')
        self._zero = np.zeros(robot.n_joints)
        self._sent = self._zero.copy()  # the last command
        self._last = None        # stamp of the state answered last
        self._answered = None    # when the last state was answered [s]; None before the first
        self._zeros = 0          # sent since then
        self._obstacle = ''      # why the last state was answered with zero, though it was sound
        self._begins = True      # the next state with a motion reference begins a motion
        self._waiting = None     # stamp of a state that waits for its reference, lockstep only
        self._ticks = 0
        self._warned = []        # sentences on the gains as they are
        self._counts = dict.fromkeys(('states answered', 'states refused', 'references refused',
                                      'observer begun anew', 'silences', 'two trajectories'), 0)
        self._longest = 0.0      # between two answers since the last report [s]
        self.health = Health(self, self._figures, self._on_fault, self.direct.lock)
        self._watched = self.health.guard(self._watch)
        self._warm_up()
        self._create_topics(values['mode'])
        parameters.watch(lambda new: controller_from_values(new, joints), self._use,
                         self.health.guard)
        self._warn_of_conditions(gains)
        self.get_logger().info(f"compensation {gains.compensation}, {values['mode']}")
        beyond = [f'{spec.name} of {spec.joint}' for spec in robot.effects
                  if not compensated(spec.name)]
        if beyond:
            self.get_logger().info(f'the model has, not compensated: {", ".join(beyond)}')
        scheduling.take_priority(self, values['realtime_priority'])

    def _create_topics(self, mode):
        n, blocks = self._robot.friction.stiffness.shape
        self._state = JointState(name=list(self._robot.joints))
        self._blocks = messages.BlockWriter(n, blocks)
        self._command_pub = Outlet(self, Float64MultiArray, 'effort_controller/commands', mode)
        self._state_pub = Outlet(self, JointState, '~/state', mode)
        self._blocks_pub = Outlet(self, Float64MultiArray, '~/blocks', mode)
        self._sticking_pub = Outlet(self, Float64MultiArray, '~/sticking', mode)
        boxes = []
        Inbox(self, Float64MultiArray, 'reference', self._on_reference, mode, boxes)
        Inbox(self, JointState, 'joint_states', self._on_joint_states, mode, boxes)
        self.create_service(Trigger, '~/reset', self.health.guard(self._on_reset))

    def run(self, spinner):
        """Answer joint states until a signal comes."""
        while spinner.goes_on():
            self.attend(spinner)

    def attend(self, spinner):
        """Run callbacks until the joint states may have stopped, and look whether they have."""
        spinner.spin_for(self._patience())
        self._watched()

    def _warm_up(self):
        """Compile before the first state comes, with a motion from the robot to elsewhere."""
        away = np.ones((5, self._robot.n_joints))
        handover = Handover(1.0)
        handover.begin(0, self._controller.measured, away)
        self._controller.tick(handover.applied(0, extrapolate(away, 0.0)), 0.0)
        self._controller.reset()

    def _use(self, gains):
        self._controller.use(gains)
        self._limit = gains.torque_limit
        self._encoders.use(gains.torque_limit)
        self._warn_of_conditions(gains)

    def _warn_of_conditions(self, gains):
        broken = violations(gains, as_parameters(self._robot))
        for sentence in broken:
            if sentence not in self._warned:
                self.get_logger().warning(sentence)
        self._warned = broken

    def _on_reference(self, message):
        """Return whether the message was accepted, and is of this time."""
        try:
            reference = Reference(*messages.read_reference(message, self._robot.n_joints))
        except messages.RefusedError as error:
            self._counts['references refused'] += 1
            self.health.warn('reference', f'reference refused: {error}')
            return False
        stamp = messages.read_stamp(message)
        if stamp is None:
            stamp = self._last if self._last is not None else 0
        if self._hears_rivals(messages.read_source(message) or '', stamp):
            return True
        self._references.keep(stamp, reference, self._last)
        if self._waiting is not None and stamp == self._waiting:
            self._answer(self._waiting)
        return self._last is None or self._references.is_fresh(stamp, self._last)

    def _hears_rivals(self, source, stamp):
        """Return whether another one's references come as well; then nobody's are kept."""
        if self._lockstep or not (self._last is None
                                  or self._references.is_fresh(stamp, self._last)):
            return False
        now = time.monotonic_ns()
        before, rivals = self._sources.conflict(now), self._sources.hear(source, now)
        if rivals:
            self._references.forget()
            if not before:
                self._counts['two trajectories'] += 1
                self.health.warn('rivals', f'{rivals}: zero torque; end one of them')
        return bool(rivals)

    def _on_joint_states(self, message):
        """Return whether the message was read and accepted."""
        stamp = messages.to_nanoseconds(message.header.stamp)
        if self.health.fault:
            self._publish_command(self._zero, stamp)
            return False
        if self._last is not None and stamp == self._last:
            if self._lockstep:  # sent again: the answer was lost or came before the plant
                self._publish_command(self._sent, stamp)
            return False
        if self._lockstep and stamp == self._waiting:  # sent again while we wait
            self.health.tell(WARN, 'waiting for a reference')
            self.get_logger().info('waiting for a reference; is trajectory_node running?',
                                   throttle_duration_sec=_WARN_PERIOD, skip_first=True)
            return False
        if self._was_overtaken(stamp):
            return False
        try:
            self._reader.read(message, self._controller.measured)
        except messages.RefusedError as error:
            self._counts['states refused'] += 1
            self.health.warn('joint state', f'joint state refused: {error}')
            return False
        self._encoders.act(self._sent, self._reader.motor_efforts(message))
        if self._lockstep and not self._references.has(stamp):
            self._waiting = stamp
            return True
        self._answer(stamp)
        return True

    def _was_overtaken(self, stamp):
        """Return whether the state is an old one that came late, not one of another clock."""
        return (not self._lockstep and self._last is not None and not self._zeros
                and 0 < self._last - stamp <= _LONGEST_DELAY)

    def _answer(self, stamp):
        self._waiting = None
        elapsed = 0.0 if self._last is None else (stamp - self._last) / NANOSECONDS
        jumped = self._last is not None and not 0.0 < elapsed <= _LONGEST_TICK
        silent, self._zeros = self._zeros > 0, 0
        self._last = stamp
        self._note_answer()
        idle, self._obstacle = bool(self._obstacle), self._find_obstacle(elapsed)
        if jumped:
            self._begin_anew(elapsed)
            elapsed = 0.0
        elif silent or idle:
            self._begins = True
            self._controller.state.started[0] = 0.0  # nobody knows the way since
            elapsed = 0.0
        if self._obstacle:  # the observer stays as it is, as in a silence
            self._references.forget_motion()
            self._publish_command(self._zero, stamp)
            self.health.tell(WARN, self._obstacle)
        elif jumped and not self._lockstep:  # the next state tells whether this clock goes on
            self._publish_command(self._zero, stamp)
        else:
            self._obey(stamp, elapsed)

    def _obey(self, stamp, elapsed):
        """Answer a state as its reference asks."""
        reference = self._references.at(stamp)
        if reference is None:
            self._give_zero(stamp)
            self._say_no_reference(stamp)
            return
        self._follow(stamp, reference, elapsed)

    def _note_answer(self):
        now = time.monotonic()
        if self._answered is not None:
            self._longest = max(self._longest, now - self._answered)
        self._answered = now
        self._counts['states answered'] += 1

    def _begin_anew(self, elapsed):
        self._counts['observer begun anew'] += 1
        self.health.tell(WARN, f'joint states jumped by {elapsed:.3f} s: zero torque')
        self.health.warn('jump', f'joint states jumped by {elapsed:.3f} s: observer begins anew')
        self._controller.reset()
        self._references.forget_motion()
        self._begins = True

    def _find_obstacle(self, elapsed):
        """Return why no reference may be followed (str); '' if any may."""
        frozen = self._encoders.look(elapsed)
        if not frozen:
            rivals = self._sources.conflict(time.monotonic_ns())
            return rivals and f'{rivals}: zero torque'
        sentence = f'{frozen}: zero torque until it changes, or ~/reset'
        if self._encoders.began:
            self.health.warn(  # of its own kind: another encoder is another warning
                f'encoder {frozen.split()[0]}', f'{sentence}; turn the joint by hand, or once the '
                f'cause is found call {self.get_fully_qualified_name()}/reset')
        return sentence

    def _follow(self, stamp, reference, elapsed):
        """Answer a state with the torque that follows a reference."""
        state = self._controller.state
        if reference.quantity == messages.EFFORT:
            self._controller.reset()
            state = self._controller.state
            state.command[:] = np.clip(reference.value[0], -self._limit, self._limit)
            self._begins = True
        else:
            if self._begins:
                self._begins = False
                self._handover.begin(stamp, self._controller.measured, reference.value)
            self._controller.tick(self._handover.applied(stamp, reference.value), elapsed)
            if not self._lockstep:
                self._handover.fade(stamp, state.command)
            self._references.answered(state.command, elapsed)
        if not all_finite(state.command.tolist()):
            self._give_zero(stamp)
            self.health.tell(WARN, 'the law gave no finite torque: zero torque')
            self.get_logger().error('the law gave no finite torque: zero torque; are state or '
                                    'reference plausible?', throttle_duration_sec=_WARN_PERIOD)
            return
        self._publish_command(state.command, stamp)
        self.health.tell(*_PHASES[self._references.phase])
        self._ticks += 1
        if self._ticks % self._every == 0:
            self._publish_state(stamp)

    def _give_zero(self, stamp):
        """Command nothing and forget the motion so far."""
        self._controller.reset()
        self._begins = True
        self._publish_command(self._zero, stamp)

    def _say_no_reference(self, stamp):
        away = self._references.nearest(stamp)
        why = ('is trajectory_node running?' if away is None else
               f'the nearest is {away / NANOSECONDS:.3g} s away from the joint states; '
               'has trajectory_node ended, or is its clock another one?')
        self.health.tell(WARN, 'no reference: zero torque')
        self.get_logger().warning(f'no reference: zero torque; {why}',
                                  throttle_duration_sec=_WARN_PERIOD, skip_first=True)

    def _patience(self):
        """Return how long to wait for the next message [s]."""
        if self._answered is None or self._lockstep or self._zeros >= _ZEROS:
            return _LONGEST_SILENCE
        due = self._answered + (self._zeros + 1) * _LONGEST_SILENCE
        return min(max(due - time.monotonic(), 1e-4), _LONGEST_SILENCE)

    def _watch(self):
        """Command nothing once states have stopped or have all been refused."""
        if (self._answered is None or self._lockstep or self._zeros >= _ZEROS
                or self.health.fault):  # which answers every state with zero
            return
        if time.monotonic() - self._answered < (self._zeros + 1) * _LONGEST_SILENCE:
            return
        # the observer is left as it is: what it knows still holds after a short silence
        self._publish_command(self._zero, self._last)
        self._zeros += 1
        if self._zeros > 1:
            return
        self._counts['silences'] += 1
        sentence = f'no usable joint state for {_LONGEST_SILENCE * 1e3:g} ms: zero torque'
        self.health.tell(WARN, sentence)
        self.health.warn('silence', sentence)

    def _on_fault(self):
        self._waiting = None
        self._publish_command(self._zero, self._last or 0)

    def _on_reset(self, _request, response):
        """End a fault: begin anew from the measured state."""
        self._controller.reset()
        self._references.forget_motion()
        self._encoders.reset()
        self._begins = True
        self.health.recover()
        response.success, response.message = True, 'begins anew from the measured state'
        return response

    def _figures(self):
        longest, self._longest = self._longest, 0.0
        return {**self._counts, 'frozen encoders': self._encoders.count,
                'longest time between answers [ms]': f'{longest * 1e3:.1f}'}

    def _publish_command(self, torque, stamp):
        self._sent[:] = torque
        self._command_pub.publish(self._command.write(torque, stamp))

    def _publish_state(self, stamp):
        state, message = self._controller.state, self._state
        if not any(publisher.count_hearers() for publisher in (
                self._state_pub, self._blocks_pub, self._sticking_pub)):
            return  # four messages a tick cost more than one
        messages.set_stamp(message.header.stamp, stamp)
        error, rate = state.error, state.error_rate
        if self._handover.left is not None:  # the error is that from the reference as received
            error, rate = error + self._handover.left[0], rate + self._handover.left[1]
        message.position = messages.array('d', error.tolist())
        message.velocity = messages.array('d', rate.tolist())
        message.effort = messages.array('d', state.friction_hat.tolist())
        self._state_pub.publish(message)
        blocks = state.observer.blocks
        self._blocks_pub.publish(self._blocks.write(blocks.torque, stamp))
        if self._sticking_pub.count_hearers():
            self._sticking_pub.publish(self._blocks.write(blocks.sticking.astype(float), stamp))

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
