# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The reference as a ROS 2 node: one message per joint state, a sample ahead."""

from contextlib import suppress
import os
import time

from diagnostic_msgs.msg import DiagnosticArray
from gms_flex_control.errors import GmsFlexError, TrajectoryError
from gms_flex_control.hardware.supervision import ACTIVE, FAULT
from gms_flex_control.nodes import joint_trajectory, messages, process, scheduling
from gms_flex_control.nodes.health import DIAGNOSTICS, Health, OK
from gms_flex_control.nodes.messages import NANOSECONDS, RefusedError
from gms_flex_control.nodes.parameters import ConfiguredNode, NodeParameters
from gms_flex_control.nodes.reference_motion import LinkStates, LONGEST_PAUSE, ReferenceMotion
from gms_flex_control.nodes.topics import Inbox, Outlet
from gms_flex_control.schema.build import frames_from_values, trajectory_from_values
from gms_flex_control.schema.keys import robot_keys, trajectory_keys
from gms_flex_control.trajectory.polynomials import require_within
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

# Elsewhere the state is answered meanwhile; what is published here is for the next one.
_SHARE, _LONGEST_WAIT = 0.3, 1e-3  # of the period; [s]
_NO_STATE = 'no joint state has come yet'


def reference_names_keys(joints) -> tuple:
    """Return the keys of joint names, of what a URDF says of them, and of the trajectory."""
    names = ('joints', 'arm.kind', 'arm.urdf', 'arm.base', 'arm.tip',
             *(f'arm.{joint}.offset' for joint in joints))
    return (*(key for key in robot_keys(joints) if key.name in names), *trajectory_keys(joints))


class TrajectoryNode(ConfiguredNode):
    """Publish the reference for each joint state before that state comes."""

    def __init__(self, direct=None, **kwargs):
        super().__init__('trajectory', direct, **kwargs)
        parameters = NodeParameters(self, reference_names_keys)
        values, joints = parameters.values, parameters.joints
        self._gives_way = direct is None and values['mode'] != 'lockstep'
        self._lockstep, self._links = values['mode'] == 'lockstep', LinkStates(joints)
        self._recorders = values['recorders']
        frames = frames_from_values(values, joints)
        offset = np.array([values[f'arm.{joint}.offset'] for joint in joints])

        def require(trajectory, segments=None):
            require_within(trajectory, joints, frames, offset, segments=segments)

        chosen = trajectory_from_values(values, joints)
        require(chosen)
        chosen.sample(0.0)  # compile before the first state comes
        self._require = require
        self._motion = ReferenceMotion(joints, self._links, chosen, values, require)
        self._writer = messages.ReferenceWriter(
            len(joints), f'{self.get_fully_qualified_name()}#{os.getpid()}')
        self._plant, self._no_torque = self.resolve_service_name('plant'), ''  # '': it flows
        self._counts = dict.fromkeys(('states followed', 'states refused', 'jumps of time'), 0)
        self.health = Health(self, lambda: self._counts)
        self._reference_pub = Outlet(self, Float64MultiArray, 'reference', values['mode'])
        Inbox(self, JointState, 'joint_states', self._on_joint_states, values['mode'])
        hear = self.health.shield(self._on_diagnostics)
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, hear,
                                 process.subscriber_qos('lockstep'),
                                 event_callbacks=process.NO_EVENTS)
        self.direct.hearers[DIAGNOSTICS].append(hear)
        self.create_subscription(
            JointTrajectory, '~/joint_trajectory', self.health.shield(self._on_joint_trajectory),
            process.subscriber_qos('lockstep'), event_callbacks=process.NO_EVENTS)
        self._serve_triggers()

        def judge(new):
            trajectory = trajectory_from_values(new, joints)
            require(trajectory)
            return trajectory, new

        parameters.watch(judge, self._choose, self.health.guard)
        self._action = self._serve_action()
        self.get_logger().info(f"{values['trajectory.type']}, call ~/start to begin"
                               if not values['trajectory.autostart'] else
                               f"{values['trajectory.type']} begins at the first joint state")
        scheduling.take_priority(self, values['realtime_priority'])

    def _serve_triggers(self):
        for name, act in (
                ('start', lambda: self._answer(
                    self._motion.go, f"{self._motion.values['trajectory.type']} begins")),
                ('stop', lambda: self._answer(self._motion.brake, 'comes to rest')),
                ('reset', self._reset),
                ('release', lambda: self._answer(self._motion.let_go, 'zero torque'))):
            self.serve(name, act)

    def _serve_action(self):
        if joint_trajectory.FollowJointTrajectory is None:
            self.get_logger().info('no action ~/follow_joint_trajectory: control_msgs is not '
                                   'installed (sudo apt install ros-jazzy-control-msgs)')
            return None
        return joint_trajectory.TrajectoryAction(self, self._motion, self._prepare, self._obstacle)

    def _on_diagnostics(self, message):
        """Hear whether the plant, or bridge, of this namespace lets torque flow."""
        for status in message.status:
            said = {item.key: item.value for item in status.values}
            if status.hardware_id == self._plant and {'state', 'reason'} <= set(said):
                state, reset = said['state'], f'{self._plant}/reset and '
                self._no_torque = '' if state == ACTIVE else (
                    f"no torque flows ({state}: {said['reason']}): call "
                    f"{reset if state == FAULT else ''}{self._plant}/enable first")

    def _obstacle(self):
        """Return why no points are followed (str), '' if they are."""
        return self.health.fault or self._no_torque

    def run(self, spinner) -> None:
        """Publish until a signal comes."""
        self.wait_for_recorders(spinner, self._recorders, lambda recorders: (
            self._reference_pub.count_hearers() > recorders))
        spinner.spin()

    def finish(self) -> None:
        """Stay until those who acknowledge have the last reference."""
        self._reference_pub.wait_for_all_acked()

    def _on_joint_states(self, message):
        """Return whether the message was read and accepted."""
        motion, stamp = self._motion, messages.to_nanoseconds(message.header.stamp)
        if self.health.fault:
            self._ask_for_zero(stamp)
            if self._action is not None:
                self._action.end(f'FAULT: {self.health.fault}')
            with suppress(RefusedError):  # ~/reset begins where the robot is by then
                self._links.read(message)
            return False
        try:
            self._links.read(message)
        except RefusedError as error:
            self._counts['states refused'] += 1
            self.health.warn('joint state', f'joint state refused: {error}')
            return False
        if not self._lockstep and messages.is_overtaken(stamp, motion.last):
            return True
        if motion.current is None or stamp < motion.last:
            self._begin(stamp)
        period = stamp - motion.last
        if period > LONGEST_PAUSE:
            self._wait_out(period)
            period = 0
        if not motion.is_foreseen(stamp) or period == 0:
            self._publish(stamp)
        if period > 0:
            ended = motion.travelled()
            if ended:
                self.get_logger().info(ended)
            if self._action is not None:
                self._action.look(stamp)
            if self._gives_way:
                time.sleep(min(_SHARE * period / NANOSECONDS, _LONGEST_WAIT))
            self._publish(stamp + period)
        motion.last = stamp
        self._counts['states followed'] += 1
        self.health.report(OK, 'moving' if motion.running else 'at rest')
        return True

    def _wait_out(self, period):
        self._counts['jumps of time'] += 1
        self._motion.wait_out(period)
        self.health.warn('jump', f'joint states jumped by {period / NANOSECONDS:.3f} s: the '
                                 'motion goes on where it was')

    def _ask_for_zero(self, stamp):
        """Ask for zero torque with as little as possible of what may be broken."""
        zero = np.zeros((1, len(self._motion.joints)))
        self._reference_pub.publish(self._writer.write(zero, messages.EFFORT, stamp))

    def _begin(self, stamp):
        if self._motion.current is not None:
            self._counts['jumps of time'] += 1
            self.health.warn('set back', 'joint states were set back in time: begins anew at rest')
        self._motion.begin(stamp)

    def _publish(self, stamp):
        self._reference_pub.publish(self._writer.write(
            self._motion.sample(stamp), self._motion.quantity, stamp))
        self._motion.published = stamp

    def _choose(self, judged):
        warning = self._motion.choose(*judged)
        if warning:
            self.get_logger().warning(warning)

    def _on_joint_trajectory(self, message):
        """Follow the points of a message from its stamp on, or at once; without any, stop."""
        lock = self.direct.lock
        try:
            if message.points or self._motion.published is None or self.health.fault:
                follow = self._prepare(message)
                with lock:
                    follow()
            else:
                with lock:
                    self._motion.brake()
        except (RefusedError, TrajectoryError) as error:
            self.health.warn('joint trajectory', f'joint trajectory refused: {error}')

    def _prepare(self, message):
        """
        Check the points of a JointTrajectory without the lock: a long motion takes its time.

        Return what lets the motion follow them, to be called with the lock; it returns the stamp
        of the last one [ns].
        """
        motion = self._motion
        obstacle = self._obstacle() or ('' if motion.published is not None else _NO_STATE)
        if obstacle:
            raise RefusedError(obstacle)
        stamp = messages.to_nanoseconds(message.header.stamp)
        points = *joint_trajectory.read_joint_trajectory(message, motion.joints), stamp
        with self.direct.lock:
            here = motion.here()
        self._require(motion.through(here, *points)[-1])

        def follow():
            count, end = motion.follow_points(*points)
            self.get_logger().info(f'follows {count} points of a joint trajectory')
            return end
        return follow

    def _answer(self, action, done):
        """Return success and message of a service after an action."""
        if self._motion.published is None:
            return False, _NO_STATE
        try:
            action()
        except GmsFlexError as error:
            return False, str(error)
        return True, done

    def _reset(self):
        self.health.recover()
        if self._motion.published is None:  # the next state is the first again
            self._motion.current = None
        return self._answer(self._rest_at_robot, 'reference comes to rest from where the robot is')

    def _rest_at_robot(self):
        self._motion.rest_at_robot()
        self._publish(self._motion.published)  # nobody follows what was foreseen before
