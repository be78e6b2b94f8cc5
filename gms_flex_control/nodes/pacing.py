# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How a simulated robot keeps time: paced by the clock or stepped by its commands."""

import sys
import time

from gms_flex_control.hardware.supervision import LATE, Lateness, NOTABLE
from gms_flex_control.nodes import process, scheduling
from gms_flex_control.nodes.messages import NANOSECONDS, now, set_stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

_SWITCH = 3e-5           # for so long a callback may delay a state that is due [s]
_UNDISTURBED = 5e-3      # and for so long a state that is due may delay a callback [s]
# where each state of lockstep is answered at once, in this process:
_CALLBACKS_PERIOD = 1e-2  # between looks at callbacks where nobody else listens [s]
_SHORTEST_SAMPLE = 4e-4   # where somebody does: a recorder keeps up with that [s]
_REPEAT_PERIOD = 1.0     # an unanswered state is sent again in lockstep [s]
_READY = 100_000         # before its deadline a state waits for it awake [ns]
_LATEST_START = 5        # samples the stamps may be off the clock before some are left out
_RISE = round(0.1 * NANOSECONDS)  # in which torque rises after a silence


class Paced:
    """Real time: each state leaves at its deadline, whether it was answered or not."""

    def __init__(self, robot, arm, node, values):
        self._robot, self._arm, self._node, self._health = robot, arm, node, node.health
        self._lock = node.direct.lock
        self._timeout = round(NANOSECONDS * values['command_timeout'])
        self._lateness = Lateness()
        self.resumed = -_RISE    # stamp at which torque began to rise
        self.missed = self.left_out = 0

    def run(self, spinner) -> None:
        """Simulate until the duration is over or a signal comes."""
        with process.BackgroundSpin(spinner) as background:
            self._run(spinner, background)

    def _run(self, spinner, background):
        scheduling.tighten_timers()
        sys.setswitchinterval(_SWITCH)
        arm = self._arm
        first, deadline = now(self._node).nanoseconds, time.monotonic_ns()
        with self._lock:
            arm.begin(first)
            arm.publish()
        while spinner.goes_on() and not arm.is_last():
            if background.error is not None:
                raise background.error
            deadline += arm.period
            # answered at once, in this process, or while half of the sample passed
            ahead = self._simulate_ahead()
            if not ahead:
                scheduling.sleep_until(deadline - arm.period // 2)
                ahead = self._simulate_ahead()
            if not ahead:
                scheduling.sleep_until(deadline)
                self._simulate()
            with self._lock:
                left_out = self._follow_clock(max(deadline - time.monotonic_ns(), 0))
                arm.end_sample()
            if left_out > 0:  # no more than it is late: the clock may have been set
                late = max(time.monotonic_ns() - deadline, 0)  # looked at before it, as a rule
                deadline += min(left_out, late // arm.period) * arm.period
            # all is ready: what follows a sleep finds cold caches
            scheduling.sleep_until(deadline - _READY)
            # who asks for the interpreter now gets it once the state has left
            sys.setswitchinterval(_UNDISTURBED)
            with self._lock:
                arm.publish(deadline)
            sys.setswitchinterval(_SWITCH)
        if self.missed:
            self._node.get_logger().info(
                f'{self.missed} of {arm.ticks} samples had no fresh command')

    def _simulate_ahead(self):
        """Simulate the sample that follows the last state if that was answered; return so."""
        answered = self._robot.command[1] == self._arm.stamp
        if answered:
            self._simulate()
        return answered

    def _simulate(self):
        """Simulate the sample that follows the last state."""
        with self._lock:
            self._robot.watch()
            self._robot.simulate(self._acting() * min(
                (self._arm.stamp - self.resumed) / _RISE, 1.0))

    def _acting(self):
        """Return the torque for the sample that ends now; zero if the last command is stale."""
        (torque, answered, arrived), stamp = self._robot.command, self._arm.stamp
        self._report_late(answered)
        if answered == stamp:
            return torque
        self.missed += 1
        if answered is None:  # a plain command acts from its arrival until the timeout
            fresh = time.monotonic_ns() - arrived <= self._timeout
        else:
            fresh = 0 < stamp - answered <= self._timeout
        return torque if fresh else self._arm.zero

    def _report_late(self, answered):
        """Warn where too many samples end before the command that answers them has come."""
        if answered is None or not self._robot.active:  # plain commands answer no state
            self._lateness.restart()
            return
        self._lateness.note(answered != self._arm.stamp, self._arm.period / NANOSECONDS)
        if self._lateness.share > NOTABLE:
            self._health.warn('late', f'{self._lateness}: {LATE}, or simulate with mode:=lockstep')

    def _follow_clock(self, early):
        """Keep the stamp that is due in ``early`` ns near the clock; return samples left out."""
        arm = self._arm
        behind = now(self._node).nanoseconds + early - arm.stamp - arm.period
        if abs(behind) <= _LATEST_START * arm.period:
            return 0
        count = int(behind / arm.period)
        self.left_out += max(count, 0)
        if count < 0:
            self._robot.command = (arm.zero, None, 0)  # the next ones are older than it
        arm.stamp += count * arm.period
        self.resumed += count * arm.period
        self._health.warn('clock', (
            f'{behind / 1e6:.1f} ms late, {count} samples are left out: the machine is too busy '
            'for this rate or stood still, or the clock was set' if behind > 0 else
            f'the clock was set back by {-behind / 1e6:.1f} ms'))
        return count


class Lockstep:
    """Each state waits for its command; simulated time is published on /clock."""

    missed = left_out = resumed = 0  # none ever is

    def __init__(self, robot, arm, node, values):
        self._robot, self._arm = robot, arm
        self._paused = False     # whether the robot waits, whatever comes
        self._clock_pub = node.create_publisher(Clock, '/clock', process.publisher_qos('lockstep'))
        self._hearers = node.direct.hearers[self._clock_pub.topic_name]
        self._clock_period = round(NANOSECONDS / values['clock_rate'])
        self._next_clock = 0
        node.create_service(SetBool, '~/pause', node.health.guard(self._on_pause))

    def _on_pause(self, request, response):
        self._paused = request.data
        response.success, response.message = True, 'paused' if request.data else 'goes on'
        return response

    def run(self, spinner) -> None:
        """Simulate until the duration is over or a signal comes."""
        arm, robot = self._arm, self._robot
        self._publish_clock()
        arm.begin(0)
        arm.publish()
        repeat, due = time.monotonic() + _REPEAT_PERIOD, 0.0
        while spinner.goes_on():
            if self._paused or not self._is_answered():
                spinner.spin_once()
            elif arm.outlet.count_others():  # answered at once, in this process
                spinner.spin_once(max(due - time.monotonic(), 0.0))
                due = time.monotonic() + _SHORTEST_SAMPLE
            elif time.monotonic() > due:
                spinner.spin_once(0.0)
                due = time.monotonic() + _CALLBACKS_PERIOD
            if self._paused:
                continue
            if self._is_answered():
                torque = robot.command[0]
                if arm.is_last():  # answered too: a recording lacks nothing
                    break
                robot.command = (torque, None, 0)
                robot.simulate(torque)
                arm.end_sample()
                arm.publish()
                self._publish_clock()
                repeat = time.monotonic() + _REPEAT_PERIOD
            elif time.monotonic() > repeat:
                arm.publish()  # a node that has just come needs the state it is to answer
                repeat = time.monotonic() + _REPEAT_PERIOD

    def _is_answered(self):
        _, stamp, arrived = self._robot.command
        return arrived and (stamp is None or stamp == self._arm.stamp)

    def _publish_clock(self):
        if self._arm.stamp >= self._next_clock:
            message = Clock()
            set_stamp(message.clock, self._arm.stamp)
            self._clock_pub.publish(message)
            for hear in self._hearers:
                hear(message)
            self._next_clock = self._arm.stamp + self._clock_period
