# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Motions through points: joint trajectories as messages, and as goals of an action."""

from math import isnan
from typing import NamedTuple

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.nodes.messages import (
    first_bad,
    JointsError,
    NANOSECONDS,
    order_of,
    RefusedError,
    set_stamp,
    to_nanoseconds,
)
from gms_flex_control.nodes.reference_motion import PastError
from gms_flex_control.params.key import LARGEST_STATE
import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.task import Future

try:  # of the ROS installation; there is no wheel of it
    from control_msgs.action import FollowJointTrajectory
except ImportError:
    FollowJointTrajectory = None

_ROWS = ('positions', 'velocities', 'accelerations')
_MOST_POINTS = 1000  # a loop in the same process waits while they are read
_AT_REST = 1e-6  # the last velocity [rad/s]
_STOPPED = 0.01  # as stopped_velocity_tolerance of joint_trajectory_controller [rad/s]
_FEEDBACK_PERIOD = NANOSECONDS // 20
# of control_msgs/action/FollowJointTrajectory
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, OLD_HEADER_TIMESTAMP = 0, -1, -2, -3
PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = -4, -5
_CODES = {JointsError: INVALID_JOINTS, PastError: OLD_HEADER_TIMESTAMP}


def read_joint_trajectory(message, joints) -> tuple:
    """
    Return times (m,) [ns] and states (m, 5, n_joints) of the points of a JointTrajectory.

    It names all ``joints`` in any order. What it leaves open of value and derivatives 1 to 4 is
    NaN, of the last point zero. Raises JointsError if joints are missing or unknown, RefusedError
    if lengths or numbers do not fit, times do not rise, or the last point moves.
    """
    order = order_of(joints, message.joint_names, 'the names of a joint trajectory')
    if len(message.joint_names) != len(joints):
        raise JointsError(f'a joint trajectory names {list(message.joint_names)}, of which only '
                          f'{list(joints)} are known')
    if len(message.points) > _MOST_POINTS:
        raise RefusedError(f'a joint trajectory has {len(message.points)} points, '
                           f'{_MOST_POINTS} at most')
    times = np.array([to_nanoseconds(point.time_from_start) for point in message.points])
    if times.size and (times[0] < 0 or (np.diff(times) <= 0).any()):
        raise RefusedError('time_from_start of a joint trajectory must not be negative and must '
                           f'rise from point to point, got {(times / 1e9).tolist()[:8]} s')
    states = np.full((len(times), 5, len(joints)), np.nan)
    for i, point in enumerate(message.points):
        for row, name in enumerate(_ROWS):
            values = getattr(point, name)
            if len(values) or name == 'positions':
                states[i, row] = _checked(values, f'{name} of point {i}', order, joints)
    if len(states):
        last = states[-1]
        if np.abs(np.nan_to_num(last[1])).max() > _AT_REST:
            raise RefusedError(f'the last point of a joint trajectory must be at rest, got '
                               f'velocities {last[1].tolist()}')
        last[1:] = 0.0
    return times, states


def _checked(values, what, order, joints):
    if len(values) != len(joints):
        raise RefusedError(f'{what} of a joint trajectory are {len(values)} for {len(joints)} '
                           'joints')
    bad = first_bad(values, LARGEST_STATE)
    if bad is not None:
        raise RefusedError(f'{what} of a joint trajectory hold {values[bad]}')
    return [values[index] for index in order]


class Goal(NamedTuple):
    """What a goal demands beside its points; absent bounds are infinite."""

    path: np.ndarray      # (2, n_joints) errors of angle and velocity on the way [rad, rad/s]
    at_end: np.ndarray    # and once it is over; a goal that bounds nothing ends at rest
    allowance: int        # how much later than the last point it may be reached [ns]; 0: any time

    def verdict(self, joints, error, late) -> tuple | None:
        """Return code and sentence once the goal is over, by ``error`` (2, n), ``late`` [ns]."""
        if late < 0:
            broken = _broken(self.path, joints, error)
            return (PATH_TOLERANCE_VIOLATED, f'path tolerance: {broken}') if broken else None
        broken = _broken(self.at_end, joints, error)
        if not broken:
            return SUCCESSFUL, 'the last point is reached'
        if 0 < self.allowance < late:
            return GOAL_TOLERANCE_VIOLATED, f'goal tolerance: {broken}'
        return None


def read_goal(request, joints) -> Goal:
    """Return the Goal of a request of the action; raises RefusedError if it makes no sense."""
    if not request.trajectory.points:
        raise RefusedError('it has no points')
    if request.multi_dof_trajectory.points:
        raise RefusedError('joints of several degrees of freedom are not known here')
    return Goal(_bounds(request.path_tolerance, joints, np.inf),
                _bounds(request.goal_tolerance, joints, _STOPPED),
                to_nanoseconds(request.goal_time_tolerance))


def _bounds(tolerances, joints, velocity):
    """Return bounds (2, n) of JointTolerances: 0 is the default, of ``velocity``; less is none."""
    bounds = np.full((2, len(joints)), np.inf)
    bounds[1] = velocity
    for one in tolerances:
        if one.name not in joints:
            raise JointsError(f'a tolerance is for {one.name[:80]!r}, known are {list(joints)}')
        for row, bound in enumerate((one.position, one.velocity)):
            if isnan(bound):
                raise RefusedError(f'a tolerance of {one.name} is nan')
            if bound:
                bounds[row, joints.index(one.name)] = bound if bound > 0.0 else np.inf
    return bounds


def _broken(bounds, joints, error):
    """Return which bound an error exceeds most (str), '' if none."""
    excess = np.abs(error) - bounds
    if not (excess > 0.0).any():
        return ''
    row, j = np.unravel_index(np.argmax(excess), excess.shape)
    what, unit = (('angle', 'rad'), ('velocity', 'rad/s'))[row]
    return (f'the {what} of {joints[j]} is {error[row, j]:.4g} {unit} off, the bound is '
            f'{bounds[row, j]:.4g} {unit}')


class TrajectoryAction:
    """
    The action ``~/follow_joint_trajectory``: one goal at a time, a new one replaces the old.

    ``prepare`` takes a JointTrajectory and returns what lets the Motion follow it, which is called
    with the node's lock and returns the stamp of its end; both raise RefusedError. ``obstacle()``
    returns why nothing is followed, '' if all is well. ``look`` is to be called for every joint
    state, with the lock.
    """

    def __init__(self, node, motion, prepare, obstacle):
        self._node, self._motion, self._prepare = node, motion, prepare
        self._obstacle = obstacle
        self._active = None      # (handle, Goal, end, Trajectory, Future of the result)
        self._reported = 0       # stamp of the last feedback
        ActionServer(node, FollowJointTrajectory, '~/follow_joint_trajectory', self._execute,
                     cancel_callback=lambda _: CancelResponse.ACCEPT)

    async def _execute(self, handle):
        """Follow a goal; return its result once it is over."""
        future = Future()
        try:
            goal = read_goal(handle.request, self._motion.joints)
            follow = self._prepare(handle.request.trajectory)
            with self._node.direct.lock:
                end = follow()
                self.end('a new goal replaces it')
                self._active = handle, goal, end, self._motion.current, future
        except (RefusedError, TrajectoryError) as error:
            self._node.health.warn('goal', f'goal refused: {error}')
            handle.abort()
            return self._result(_CODES.get(type(error), INVALID_GOAL), str(error))
        return await future

    def _result(self, code, sentence):
        return FollowJointTrajectory.Result(error_code=code, error_string=sentence)

    def look(self, stamp) -> None:
        """Judge the goal, if there is one, by the state of ``stamp`` [ns]; answer its client."""
        if self._active is None:
            return
        handle, goal, end, trajectory, _ = self._active
        motion, links = self._motion, self._motion.links
        if motion.current is not trajectory:
            self.end('another motion has begun')
            return
        if handle.is_cancel_requested:
            motion.brake()
            self._finish(handle.canceled, SUCCESSFUL, 'canceled: the reference comes to rest')
            return
        if self._obstacle():
            motion.brake()
            self.end(self._obstacle())
            return
        desired = motion.sample(stamp)[:2]
        actual = np.array([links.q, links.dq])
        verdict = goal.verdict(motion.joints, actual - desired, stamp - end)
        if verdict is not None:
            reached = verdict[0] == SUCCESSFUL
            if verdict[0] == PATH_TOLERANCE_VIOLATED:
                motion.brake()
            self._finish(handle.succeed if reached else handle.abort, *verdict)
        elif not 0 <= stamp - self._reported < _FEEDBACK_PERIOD:
            self._reported = stamp
            feedback = FollowJointTrajectory.Feedback(joint_names=list(motion.joints))
            set_stamp(feedback.header.stamp, stamp)
            for point, rows in ((feedback.desired, desired), (feedback.actual, actual),
                                (feedback.error, desired - actual)):
                point.positions, point.velocities = rows[0].tolist(), rows[1].tolist()
            handle.publish_feedback(feedback)

    def end(self, sentence) -> None:
        """Abort the goal, if there is one."""
        if self._active is not None:
            self._finish(self._active[0].abort, INVALID_GOAL, sentence)

    def _finish(self, conclude, code, sentence):
        future, self._active = self._active[-1], None
        conclude()
        if code != SUCCESSFUL:
            self._node.get_logger().warning(f'goal ends: {sentence}')
        future.set_result(self._result(code, sentence))
