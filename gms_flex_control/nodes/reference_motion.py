# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The motion of the reference in the time of the joint states, smooth whatever it goes over to."""

from gms_flex_control.errors import TrajectoryError
from gms_flex_control.nodes.messages import EFFORT, JointNumbers, NANOSECONDS, RefusedError
from gms_flex_control.trajectory import builders
import numpy as np

_STANDING = 1e-3    # slower than this counts as rest [rad/s]
_CREEP = 0.1        # a single encoder count looks as fast as that to a reset [rad/s]
_SAME_STAMP = 0.2   # a stamp within this part of the period was foreseen
LONGEST_PAUSE = 2 * NANOSECONDS     # of the joint states; the motion waits for longer ones
_LONGEST_MOTION = 86400 * NANOSECONDS  # through points
_HEAD = 5           # segments through points that depend on the state they begin at


class PastError(RefusedError):
    """All of a motion lies in the past."""


class LinkStates:
    """Where the links are and how fast, as the joint states say."""

    def __init__(self, joints):
        self._numbers = JointNumbers(joints)
        self.q, self.dq = np.zeros((2, len(joints)))

    def read(self, message) -> None:
        """Take a JointState; raises RefusedError. Velocities that make no sense are zero."""
        self.q[:] = self._numbers.read(message, 'position')
        try:
            self.dq[:] = self._numbers.read(message, 'velocity')
        except RefusedError:
            self.dq[:] = 0.0


class ReferenceMotion:
    """
    The reference at each time: a chosen trajectory, points, rest, or zero torque.

    ``chosen`` is the trajectory of ``values``, checked parameters; `choose` changes both. Stamps
    are those of joint states [ns]. ``current`` is another object whenever the motion is another.
    ``require`` raises TrajectoryError for one that the robot is not to follow; with ``segments``
    it looks at the first ones only.
    """

    def __init__(self, joints, links, chosen, values, require):
        self.joints, self.links = joints, links
        self.chosen, self.values, self._require = chosen, values, require
        self.current = None      # Trajectory in the node's time, None before the first state
        self.running = self.has_points = False  # the latter: of a joint trajectory
        self._origin = self.last = self.published = None  # stamps [ns]
        self._origin_of_torque = np.zeros(len(joints))

    @property
    def quantity(self) -> str:
        """Return what the reference is: 'motion' or 'effort'."""
        return self.current.quantity

    def sample(self, stamp) -> np.ndarray:
        """Return the reference (5, n) or (1, n) for the state of ``stamp``."""
        return self.current.sample((stamp - self._origin) / NANOSECONDS)

    def begin(self, stamp) -> None:
        """Take the first state, or one after the clock was set back, as time zero, at rest."""
        self._origin = self.last = stamp
        self.published = None
        self.current = builders.hold(self.links.q)
        self.running = False
        if self.values['trajectory.autostart'] and self.values['trajectory.type'] != 'hold':
            self._enter(self.chosen, 0.0)

    def wait_out(self, period) -> None:
        """Let the motion go on where it was: the clock has jumped, or there were no states."""
        self._origin += period
        self.published = None

    def is_foreseen(self, stamp) -> bool:
        """Return whether the reference for a state has been published already."""
        return (self.published is not None and abs(self.published - stamp)
                <= _SAME_STAMP * (stamp - self.last))

    def travelled(self) -> str:
        """End an open-loop torque under which a joint has moved far enough; say so ('': none)."""
        if not self.running or self.quantity != EFFORT:
            return ''
        for joint, moved in zip(self.joints, np.abs(self.links.q - self._origin_of_torque),
                                strict=True):
            if moved > self.values[f'trajectory.{joint}.travel'] > 0.0:
                self.brake()
                return f'{joint} has moved by {moved:.3g} rad: the torque ends'
        return ''

    def _now(self):
        """Return the time from which on nothing has been published yet [s]."""
        return (self.published - self._origin) / NANOSECONDS

    def _enter(self, trajectory, time):
        """Go over to ``trajectory`` smoothly from the reference at ``time``."""
        state = self._state(time)
        if trajectory.quantity == EFFORT and np.abs(state[1]).max() > _STANDING:
            raise TrajectoryError('a torque ramp begins at rest: call ~/stop first')
        entered = builders.approach(state, trajectory, time,
                                    duration=self.values['trajectory.approach_time'])
        self._require(entered)
        self._origin_of_torque[:] = self.links.q
        self.current = entered
        self.running, self.has_points = True, False

    def _state(self, time):
        """Return the reference at ``time``, or the robot's motion without one to follow."""
        return self._robot_state() if self.quantity == EFFORT else self.current.sample(time)

    def _robot_state(self):
        state = builders.at_rest(self.links.q)
        state[1] = self.links.dq
        return state

    def brake(self) -> None:
        """Come to rest from wherever the reference is."""
        self._brake_from(self._state(self._now()))

    def _brake_from(self, state):
        time, duration = self._now(), self.values['trajectory.approach_time']
        self.current = builders.braked(state, time, duration=duration)
        self.running = self.has_points = False

    def go(self) -> None:
        """Begin the chosen motion."""
        if self.values['trajectory.type'] == 'hold':
            self.brake()
        else:
            self._enter(self.chosen, self._now())

    def choose(self, chosen, values) -> str:
        """Take other parameters, and go over to them if it moves; return a warning or ''."""
        self.chosen, self.values = chosen, values
        if (not self.running or self.has_points or self.published is None
                or self._now() > self.current.end):
            return ''
        try:
            self.go()
        except TrajectoryError as error:
            self.brake()
            return f'{error}; the reference comes to rest'
        return ''

    def rest_at_robot(self) -> None:
        """Take the robot's own motion for the reference and bring that to rest."""
        state = self._robot_state()
        state[1, np.abs(state[1]) < _CREEP] = 0.0
        self._brake_from(state)

    def let_go(self) -> None:
        """Ask for zero torque from the next state on, until another motion begins."""
        self.current = builders.torque_levels(np.zeros((1, len(self.joints))), 1.0)
        self.running = self.has_points = False

    def here(self) -> tuple:
        """Return the last stamp of which all is settled [ns], and the reference (5, n) there."""
        return self.published, self._state(self._now())

    def through(self, here, times, states, stamp) -> tuple:
        """
        Return how many points are yet to come, the stamp of the last one [ns], and the way there.

        ``here`` is that of `here`, ``times`` (m,) and ``states`` (m, 5, n) are those of
        `read_joint_trajectory`, ``stamp`` is when they begin, 0 for now. Nothing changes yet, and
        no lock is needed. Raises PastError if no point comes, RefusedError if the last one comes
        too late.
        """
        begin, now = here
        times = times + (stamp or begin)
        ahead = times > begin
        if not stamp and not ahead.any():
            raise RefusedError('all its points are at time_from_start 0, which leaves no time to '
                               'go there')
        if not ahead.any():
            raise PastError(
                f'it was over {(begin - int(times[-1])) / NANOSECONDS:.3g} s ago by the stamps '
                'of the joint states')
        if times[-1] - begin > _LONGEST_MOTION:
            raise RefusedError(
                f'it ends in {(int(times[-1]) - begin) / NANOSECONDS:.3g} s by the stamps of the '
                'joint states; is its stamp of another clock? Zero begins at once')
        end, times = int(times[-1]), np.array([begin, *times[ahead]])
        return int(ahead.sum()), end, builders.through(
            (times - self._origin) / NANOSECONDS, np.stack([now, *states[ahead]]))

    def follow_points(self, *points) -> tuple:
        """Go through points that `through` found a way through a moment ago; return as that."""
        count, end, way = self.through(self.here(), *points)
        self._require(way, segments=_HEAD)
        self.current = way
        self.running = self.has_points = True
        return count, end
