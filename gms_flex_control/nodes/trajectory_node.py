# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The reference as a ROS 2 node: one message per joint state, a sample ahead."""

from contextlib import suppress
import os
import sys

from gms_flex_control.errors import GmsFlexError, TrajectoryError
from gms_flex_control.nodes import messages, process, refusal, scheduling
from gms_flex_control.nodes.direct import Direct, Outlet
from gms_flex_control.nodes.health import Health, OK
from gms_flex_control.nodes.inbox import Inbox
from gms_flex_control.nodes.joint_trajectory import read_joint_trajectory
from gms_flex_control.nodes.messages import NANOSECONDS
from gms_flex_control.nodes.parameters import NodeParameters
from gms_flex_control.schema.keys import robot_keys
from gms_flex_control.schema.motion import trajectory_from_values
from gms_flex_control.schema.node_keys import trajectory_keys
from gms_flex_control.trajectory import builders, levels
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

_WARN_PERIOD = 5.0
_STANDING = 1e-3    # slower than this counts as rest [rad/s]
_CREEP = 0.1        # a single encoder count looks as fast as that to a reset [rad/s]
_SAME_STAMP = 0.2  # a stamp within this part of the period was foreseen
_LONGEST_DELAY = round(0.1 * NANOSECONDS)  # a state older than the last by less was overtaken
_LONGEST_MOTION = 86400 * NANOSECONDS  # of a joint trajectory
_LONGEST_PAUSE = 2 * NANOSECONDS  # of the joint states; the motion waits for longer ones


def reference_names_keys(joints):
    """Return the keys of joint names and of the trajectory."""
    return (robot_keys(())[0], *trajectory_keys(joints))


class TrajectoryNode(Node):
    """Publish the reference for each joint state before that state comes."""

    def __init__(self, direct=None, **kwargs):
        super().__init__('trajectory', automatically_declare_parameters_from_overrides=True,
                         **kwargs)
        self.direct = direct or Direct()
        parameters = NodeParameters(self, reference_names_keys)
        values, self._joints = parameters.values, parameters.joints
        self._chosen = trajectory_from_values(values, self._joints)
        self._values, self._lockstep = values, values['mode'] == 'lockstep'
        self._current = None      # Trajectory in the node's time, None before the first state
        self._running = self._has_points = False  # has_points: of a JointTrajectory
        self._origin = self._last = self._published = None  # stamps [ns]
        self._names = self._order = None
        self._q_link, self._dq_link, self._origin_of_torque = np.zeros((3, len(self._joints)))
        self._writer = messages.ReferenceWriter(
            len(self._joints), f'{self.get_fully_qualified_name()}#{os.getpid()}')
        self._counts = dict.fromkeys(('states followed', 'states refused', 'jumps of time'), 0)
        self.health = Health(self, lambda: self._counts, lock=self.direct.lock)
        guard = self.health.guard
        self._reference_pub = Outlet(self, Float64MultiArray, 'reference', values['mode'])
        self._chosen.sample(0.0)  # compile before the first state comes
        Inbox(self, JointState, 'joint_states', self._on_joint_states, values['mode'])
        self.create_subscription(
            JointTrajectory, '~/joint_trajectory', guard(self._on_joint_trajectory),
            process.subscriber_qos('lockstep'), event_callbacks=process.NO_EVENTS)
        for name, handler in (('start', self._start), ('stop', self._stop),
                              ('reset', self._reset), ('release', self._release)):
            self.create_service(Trigger, f'~/{name}', guard(handler))
            self.direct.services[self.resolve_service_name(f'~/{name}')] = guard(handler)
        parameters.watch(lambda new: (trajectory_from_values(new, self._joints), new),
                         self._choose, guard)
        self.get_logger().info(f"{values['trajectory.type']}, call ~/start to begin"
                               if not values['trajectory.autostart'] else
                               f"{values['trajectory.type']} begins at the first joint state")
        scheduling.take_priority(self, values['realtime_priority'])

    def run(self, spinner):
        """Publish until a signal comes."""
        spinner.spin()

    def _time(self, stamp):
        return (stamp - self._origin) / NANOSECONDS

    def _read(self, message):
        if message.name != self._names:
            self._order = refusal.order_of(self._joints, message.name)
            self._names = list(message.name)
        if len(message.position) != len(message.name):
            raise messages.RefusedError(f'joint states have {len(message.name)} names and '
                                        f'{len(message.position)} positions')
        q_link = [message.position[index] for index in self._order]
        bad = refusal.first_bad(q_link, refusal.LARGEST_STATE)
        if bad is not None:
            raise messages.RefusedError(f'joint states have position {q_link[bad]} for '
                                        f'{self._joints[bad]!r} (position[{self._order[bad]}])')
        self._q_link[:] = q_link
        self._dq_link[:] = 0.0
        if len(message.velocity) == len(message.name):
            dq_link = [message.velocity[index] for index in self._order]
            if refusal.first_bad(dq_link, refusal.LARGEST_STATE) is None:
                self._dq_link[:] = dq_link

    def _on_joint_states(self, message):
        """Return whether the message was read and accepted."""
        stamp = messages.to_nanoseconds(message.header.stamp)
        if self.health.fault:
            self._ask_for_zero(stamp)
            with suppress(messages.RefusedError):  # ~/reset begins where the robot is by then
                self._read(message)
            return False
        try:
            self._read(message)
        except messages.RefusedError as error:
            self._counts['states refused'] += 1
            self.health.warn('joint state', f'joint state refused: {error}')
            return False
        if self._was_overtaken(stamp):
            return True
        if self._current is None or stamp < self._last:
            self._begin(stamp)
        period = stamp - self._last
        if period > _LONGEST_PAUSE:
            self._wait_out(period)
            period = 0
        foreseen = (self._published is not None
                    and abs(self._published - stamp) <= _SAME_STAMP * period)
        if not foreseen or period == 0:
            self._publish(stamp)
        if period > 0:
            self._end_travelled()
            self._publish(stamp + period)
        self._last = stamp
        self._counts['states followed'] += 1
        self.health.tell(OK, 'moving' if self._running else 'at rest')
        return True

    def _was_overtaken(self, stamp):
        """Return whether the state is an old one that came late, not one of another clock."""
        return (not self._lockstep and self._last is not None
                and 0 < self._last - stamp <= _LONGEST_DELAY)

    def _wait_out(self, period):
        """Let the motion go on where it was: the clock has jumped, or there were no states."""
        self._counts['jumps of time'] += 1
        self._origin += period
        self._published = None
        self.get_logger().warning(
            f'joint states jumped by {period / NANOSECONDS:.3f} s: the motion goes on where it '
            'was', throttle_duration_sec=_WARN_PERIOD)

    def _ask_for_zero(self, stamp):
        """Ask for zero torque with as little as possible of what may be broken."""
        zero = np.zeros((1, len(self._joints)))
        self._reference_pub.publish(self._writer.write(zero, messages.EFFORT, stamp))

    def _end_travelled(self):
        """End an open-loop torque under which a joint has moved far enough."""
        if not self._running or self._current.quantity != messages.EFFORT:
            return
        for joint, moved in zip(self._joints, np.abs(self._q_link - self._origin_of_torque),
                                strict=True):
            if moved > self._values[f'trajectory.{joint}.travel'] > 0.0:
                self.get_logger().info(f'{joint} has moved by {moved:.3g} rad: the torque ends')
                self._brake()
                return

    def _begin(self, stamp):
        """Take the first state, or one after the clock was set back, as time zero."""
        if self._current is not None:
            self._counts['jumps of time'] += 1
            self.get_logger().warning('joint states were set back in time: begins anew at rest',
                                      throttle_duration_sec=_WARN_PERIOD)
        self._origin = self._last = stamp
        self._published = None
        self._current = builders.hold(self._q_link)
        self._running = False
        if self._values['trajectory.autostart'] and self._values['trajectory.type'] != 'hold':
            self._enter(self._chosen, 0.0)

    def _publish(self, stamp):
        reference = self._current.sample(self._time(stamp))
        self._reference_pub.publish(
            self._writer.write(reference, self._current.quantity, stamp))
        self._published = stamp

    def _now(self):
        """Return the time from which on nothing has been published yet [s]."""
        return self._time(self._published)

    def _enter(self, trajectory, time):
        """Go over to ``trajectory`` smoothly from the reference at ``time``."""
        state = self._state(time)
        if (trajectory.quantity == messages.EFFORT
                and np.abs(state[1]).max() > _STANDING):
            raise TrajectoryError('a torque ramp begins at rest: call ~/stop first')
        self._origin_of_torque[:] = self._q_link
        self._current = builders.approach(state, trajectory, time,
                                          duration=self._values['trajectory.approach_time'])
        self._running, self._has_points = True, False

    def _state(self, time):
        """Return the reference at ``time``, or the robot's motion if there is none to follow."""
        if self._current.quantity == messages.EFFORT:
            return self._robot_state()
        return self._current.sample(time)

    def _robot_state(self):
        state = builders.at_rest(self._q_link)
        state[1] = self._dq_link
        return state

    def _brake(self):
        """Come to rest from wherever the reference is."""
        self._brake_from(self._state(self._now()))

    def _brake_from(self, state):
        time, duration = self._now(), self._values['trajectory.approach_time']
        goal = state[0] + 0.5 * duration * state[1]
        self._current = builders.approach(state, builders.hold(goal), time, duration=duration)
        self._running = False

    def _go(self):
        """Begin the chosen motion."""
        if self._values['trajectory.type'] == 'hold':
            self._brake()
        else:
            self._enter(self._chosen, self._now())

    def _choose(self, judged):
        self._chosen, self._values = judged
        if (not self._running or self._has_points or self._published is None
                or self._now() > self._current.end):
            return
        try:
            self._go()
        except TrajectoryError as error:
            self.get_logger().warning(f'{error}; the reference comes to rest')
            self._brake()

    def _on_joint_trajectory(self, message):
        """Follow the points of a message from its stamp on, or at once; without any, stop."""
        try:
            if self._published is None or self.health.fault:
                raise messages.RefusedError(self.health.fault or 'no joint state has come yet')
            if not message.points:
                self._brake()
                return
            self._follow_points(*read_joint_trajectory(message, self._joints),
                                messages.to_nanoseconds(message.header.stamp))
        except (messages.RefusedError, TrajectoryError) as error:
            self.health.warn('joint trajectory', f'joint trajectory refused: {error}')

    def _follow_points(self, times, states, stamp):
        """Go from the reference of now through those points that are yet to come."""
        begin = self._published
        times = times + (stamp or begin)
        ahead = times > begin
        if not ahead.any():
            raise messages.RefusedError(
                f'it was over {(begin - int(times[-1])) / NANOSECONDS:.3g} s ago by the stamps '
                'of the joint states')
        if times[-1] - begin > _LONGEST_MOTION:
            raise messages.RefusedError(
                f'it ends in {(int(times[-1]) - begin) / NANOSECONDS:.3g} s by the stamps of the '
                'joint states; is its stamp of another clock? Zero begins at once')
        now = self._state(self._now())
        times = np.array([begin, *times[ahead]])
        self._current = builders.through((times - self._origin) / NANOSECONDS,
                                         np.stack([now, *states[ahead]]))
        self._running = self._has_points = True
        self.get_logger().info(f'follows {ahead.sum()} points of a joint trajectory')

    def _reply(self, response, action, done):
        if self._published is None:
            response.success, response.message = False, 'no joint state has come yet'
            return response
        try:
            action()
            response.success, response.message = True, done
        except GmsFlexError as error:
            response.success, response.message = False, str(error)
        return response

    def _start(self, _request, response):
        return self._reply(response, self._go, f"{self._values['trajectory.type']} begins")

    def _stop(self, _request, response):
        return self._reply(response, self._brake, 'comes to rest')

    def _reset(self, _request, response):
        def forget():
            """Take the robot's own motion for the reference and bring that to rest."""
            state = self._robot_state()
            state[1, np.abs(state[1]) < _CREEP] = 0.0
            self._brake_from(state)
        self.health.recover()
        if self._published is None:  # the next state is the first again
            self._current = None
        return self._reply(response, forget, 'reference comes to rest from where the robot is')

    def _release(self, _request, response):
        def let_go():
            """Ask for zero torque from the next state on, until ~/start, ~/stop or ~/reset."""
            self._current = levels.torque_levels(np.zeros((1, len(self._joints))), 1.0)
            self._running = False
        return self._reply(response, let_go, 'zero torque')

    def finish(self):
        """End: a controller whose reference stops sends zero torque by itself."""


def main(args=None):
    """Run the trajectory node until a signal; return its exit code."""
    return process.run_node(TrajectoryNode, args)


if __name__ == '__main__':
    sys.exit(main())
