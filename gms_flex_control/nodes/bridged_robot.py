# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A real robot behind topics of ros2_control or behind a device: threads, clocks and messages."""

import sys
import time

from gms_flex_control.hardware import supervision
from gms_flex_control.hardware.bridge import Bridge
from gms_flex_control.hardware.foresight import Foresight
from gms_flex_control.hardware.mapping import ReadingError
from gms_flex_control.nodes import messages, process, scheduling
from gms_flex_control.nodes.robot_links import DeviceLink, TopicLink
from gms_flex_control.nodes.topics import Inbox, Outlet
from gms_flex_control.schema.build import bridge_from_values
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_WATCH_PERIOD = 0.002      # how often the silence of both sides is measured [s]
_JUST = 2_000_000          # a look so soon after another one would only hold up the loop [ns]
_MOST_PASSED = 3           # looks that are left out one after the other
_SWITCH = 1e-3             # for so long a look may wait for a state that is handled [s]
_ZERO_PERIOD = 10_000_000  # period of zero torque without commands [ns]


class BridgedRobot(supervision.SupervisedRobot):
    """
    Joint states of a robot to the controller, its commands to the robot, within limits.

    Three threads meet here, one at a time: joint states and commands, the safety services, and
    the watch over both, which is the main one.
    """

    def __init__(self, node, values, joints):
        motors = values['motors'] or ('',) * len(joints)
        self._health = node.health
        self._bridge = Bridge(bridge_from_values(values, joints, motors))
        self._supervisor = self._bridge.supervisor
        self._lock = node.direct.lock
        self._steady = time.time_ns() - time.monotonic_ns()
        self._said = None
        self._sent = 0             # when efforts left last
        self._counted = {}, time.monotonic()
        self._writer = messages.JointStateWriter(joints, motors)
        self._state_pub = Outlet(node, JointState, 'joint_states', ahead=True)
        self._ends, self._passed = False, 0
        self._foresight, self._ahead = None, None  # what was sent ahead, and when
        self._link = (DeviceLink if values['bridge.device'] else TopicLink)(
            node, self, values, self._bridge.params.joint_map.command_names)
        Inbox(node, Float64MultiArray, 'effort_controller/commands', self._on_command)

    def now(self) -> int:
        """Return a time that never jumps, near that of the system at the start [ns]."""
        return time.monotonic_ns() + self._steady

    def foresee(self, controller) -> None:
        """Send efforts as soon as they can be known; ``controller`` is that of this process."""
        self._foresight = Foresight(self._bridge, (self._health, controller.health), controller)

    # what comes ----------------------------------------------------------------------------

    def take_state(self, source, names, position, velocity, effort, stamp) -> bool:
        """Take joint states of the link, publish the state they complete; False if refused."""
        now, bridge, refused = self.now(), self._bridge, False
        with self._lock:
            try:
                if self._foresight is not None:
                    self._send_ahead(names, (position, velocity, effort), stamp, now)
                if bridge.take_state(source, names, position, velocity, effort, stamp, now):
                    self._pass_on(bridge.robot)
            except ReadingError as error:
                bridge.refuse_state(str(error))
                self._health.warn('state', f'joint state refused: {error}')
                refused = True
            finally:
                if self._ahead is not None:  # the command has not come to that
                    self._send()
            self._settle()
            if self._foresight is not None:
                self._foresight.plan()
        return not refused

    def _pass_on(self, robot):
        self._state_pub.publish(self._writer.write(robot.measured, robot.applied, robot.stamp))
        if self._bridge.controller.lateness.share > supervision.NOTABLE:
            self._health.warn('late', f'{self._bridge.controller.lateness}: {supervision.LATE}')

    def _on_command(self, message):
        """Return whether the message is a command, to be obeyed or not."""
        now, bridge = self.now(), self._bridge
        stamp, source = messages.read_marks(message)
        with self._lock:
            try:
                torque = messages.read_command(message, len(bridge.params.joint_map.joints))
            except messages.RefusedError as error:
                bridge.refuse_command(str(error))
                self._health.warn('command', f'command refused: {error}')
                return False
            sent = None if self._ahead is None else self._ahead[1]
            if bridge.take_command(torque, stamp, source, now, sent):
                self._send()
            self._settle()
        return True

    # what goes -----------------------------------------------------------------------------

    def _send_ahead(self, names, fields, stamp, now):
        efforts = self._foresight.efforts(names, fields, stamp, now)
        if efforts is not None and self._write(efforts):
            self._ahead = efforts, now
            self._bridge.counters['efforts sent ahead'] += 1

    def _send(self):
        """Send what the bridge gives, unless just that was sent ahead."""
        efforts = self._bridge.params.joint_map.efforts(self._bridge.torque).tolist()
        ahead, self._ahead = self._ahead, None
        if ahead is not None and ahead[0] == efforts:
            return
        self._bridge.counters['efforts corrected'] += ahead is not None
        self._write(efforts)

    def _write(self, efforts):
        """Return whether the link took the efforts; a fault begins where it did not."""
        self._sent = self.now()
        try:
            self._link.write(efforts)
        except self._link.errors as error:
            self._bridge.fault(str(error))
            return False
        return True

    def _settle(self):
        """Say what has changed; without torque, send zero at once."""
        state = self._supervisor.state, self._supervisor.reason
        if state == self._said:
            return
        self._said = state
        if not self._supervisor.active:
            self._bridge.take_torque_away()
            self._send()
        self._health.report_state(self._supervisor)

    # requests, from any thread ---------------------------------------------------------------

    def obstacle(self) -> str:
        """Return what stands against torque now; '' if nothing does."""
        with self._lock:
            if not self.at_zero:
                return ''
            return (self._health.fault or self._bridge.obstacle(self.now())
                    or self._link.obstacle() or ('the bridge ends' if self._ends else ''))

    def enable(self, refusals=None) -> supervision.Outcome:
        """Let torque flow, unless it was taken away since there were ``refusals``."""
        with self._lock:
            obstacle = self.obstacle()
            if obstacle:
                return supervision.Outcome(False, f'not enabled: {obstacle}')
            return self._outdated(refusals) or self._settled(self._bridge.enable(self.now()))

    def disable(self) -> supervision.Outcome:
        """Take torque away; return an Outcome."""
        with self._lock:
            return self._settled(self._supervisor.disable())

    def reset(self) -> supervision.Outcome:
        """Leave a fault; return an Outcome."""
        with self._lock:
            return self._settled(self._supervisor.reset())

    def fail(self, sentence) -> None:
        """Enter the fault: something is wrong in this process or with the link."""
        with self._lock:
            self._bridge.fault(sentence)
            self._settle()

    # the watch -----------------------------------------------------------------------------

    def run(self, spinner) -> None:
        """Watch over both sides until a signal comes."""
        scheduling.tighten_timers()
        sys.setswitchinterval(_SWITCH)
        look = self._health.shield(self._look)
        with process.BackgroundSpin(spinner) as background, self._link.reading():
            try:
                while spinner.goes_on():
                    if background.error is not None:
                        raise background.error
                    look()
                    self._link.beat()
                    time.sleep(_WATCH_PERIOD)
            finally:  # commands still come, and nobody watches any more
                self._end()

    def _end(self):
        with self._lock:
            self._ends = True
            self._supervisor.disable('the bridge ends')
            self._settle()

    def _look(self):
        """Look after both sides, unless a state or command is just being handled, or has been."""
        self._passed += 1
        due = self._passed > _MOST_PASSED
        if not due and self._bridge.looked(self.now()) < _JUST:  # by a command, that is
            return
        if not self._lock.acquire(blocking=due):
            return
        try:
            self._passed = 0
            self._look_now()
        finally:
            self._lock.release()

    def _look_now(self):
        now = self.now()
        self._bridge.watch(now)
        broken = self._health.fault or self._link.broken
        if self._supervisor.active and broken:
            self._bridge.fault(broken)
        self._settle()
        if not self._supervisor.active and now - self._sent >= _ZERO_PERIOD:
            self._send()

    def finish(self) -> None:
        """Leave zero on the wire, and stay until those who acknowledge have it."""
        self._end()
        with self._lock:
            self._bridge.take_torque_away()
            self._send()
        self._link.finish()

    def figures(self) -> dict:
        """Return rates since the last call, counters and worst latencies for /diagnostics."""
        with self._lock:
            bridge, counters, now = self._bridge, dict(self._bridge.counters), time.monotonic()
            before, since = self._counted
            self._counted = counters, now
            rates = {f'rate of {name} [Hz]': round(
                (counters.get(name, 0) - before.get(name, 0)) / max(now - since, 1e-3), 1)
                for name in ('states in', supervision.BRIDGED[0], 'commands in',
                             'commands acted on')}
            return {
                'state': self._supervisor.state, 'reason': self._supervisor.reason, **rates,
                **counters, 'faults': self._supervisor.faults,
                'clock jumps of the robot': bridge.robot.merger.jumps,
                'velocities estimated': bridge.robot.merger.estimated,
                **bridge.controller.watch.figures(self.now()),
                'worst age of a state [ms]': round(bridge.robot.worst_age / 1e6, 3),
                'worst answer [ms]': round(bridge.controller.worst_answer / 1e6, 3),
                'torque [N m]': [round(float(torque), 4) for torque in bridge.torque],
                **self._link.figures()}
