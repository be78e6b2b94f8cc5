# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The simulated robot of a plant node: paced by the clock or stepped by its commands."""

from functools import partial
import sys
import time

from builtin_interfaces.msg import Time
from gms_flex_control.errors import SimulationError
from gms_flex_control.hardware import limits as limiting
from gms_flex_control.hardware.command_watch import CommandWatch
from gms_flex_control.hardware.supervisor import SupervisedRobot, Supervisor
from gms_flex_control.nodes import messages, process, scheduling
from gms_flex_control.nodes.direct import Outlet
from gms_flex_control.nodes.health import ERROR, now, OK
from gms_flex_control.nodes.inbox import Inbox
from gms_flex_control.nodes.loop_timing import LateSamples, LoopTiming
from gms_flex_control.nodes.messages import NANOSECONDS
from gms_flex_control.schema.bridge import limits_from_values
from gms_flex_control.schema.build import robot_from_values
from gms_flex_control.simulation.stepped import SteppedPlant
import numpy as np
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

_SWITCH = 1e-4           # for so long a callback may delay a state that is due [s]
# where each state of lockstep is answered at once, in this process:
_CALLBACKS_PERIOD = 1e-2  # between looks at callbacks where nobody else listens [s]
_SHORTEST_SAMPLE = 4e-4   # where somebody does: a recorder keeps up with that [s]
_REPEAT_PERIOD = 1.0     # an unanswered state is sent again in lockstep [s]
_LATEST_START = 5        # samples the stamps may be off the clock before some are left out
_RISE = round(0.1 * NANOSECONDS)  # in which torque rises after a silence


class SimulatedRobot(SupervisedRobot):
    """
    A robot that is simulated sample by sample.

    Silence and two controllers at once are faults that pass when one controller commands again,
    there being nothing to break; an emergency stop and a broken limit last until ``~/reset``.

    Parameters
    ----------
    node : rclpy.node.Node
        The plant.
    values : dict of str to object
        Checked parameters.
    joints : sequence of str
        Link names.
    health : Health
        Told of every change.

    """

    def __init__(self, node, values, joints, health):
        self._node, self._health, self._joints = node, health, joints
        robot = robot_from_values(values)
        self._mode = values['mode']
        self._period = round(NANOSECONDS / values['rate'])
        self._timeout = round(NANOSECONDS * values['command_timeout'])
        self._silence_timeout = round(NANOSECONDS * values['silence_timeout'])
        # as many samples as a run in one process has
        self._samples = None
        if values['duration'] > 0.0:
            self._samples = max(1, round(values['duration'] / (self._period / NANOSECONDS)))
        self._timing = LoopTiming(values['timing_file'], self._period,
                                  self._samples and self._samples * self._period)
        self._late = LateSamples(self._period)
        self._listeners = values['wait_for_subscribers']
        make_plant = partial(
            SteppedPlant, robot, period=self._period / NANOSECONDS, substeps=values['substeps'],
            seed=values['seed'],
            q_link=[values[f'initial.{joint}'] for joint in robot.joints])
        make_plant().advance(np.zeros(robot.n_joints))  # compile before the clock runs
        self._plant = make_plant()
        self._writer = messages.JointStateWriter(robot.joints, robot.motors)
        self._zero = np.zeros(robot.n_joints)
        self._given = self._zero
        self._limits = limits_from_values(values, joints)
        self._supervisor, self._commands = Supervisor('no command yet'), CommandWatch()
        self._wanted = True      # whether commands enable torque
        self._passing = False    # whether the fault passes by itself
        self._paused = False     # whether a robot in lockstep waits, whatever comes
        self._said = None
        self._lock = node.direct.lock
        self._command = (self._zero, None, 0)  # torque, stamp answered, when it came
        self._stamp = self._first = 0  # [ns]
        self._resumed = -_RISE   # stamp at which torque began to rise
        self._ticks = self._missed = self._refused = self._left_out = 0
        self._create_topics(values)
        node.get_logger().info(f"{robot.n_joints} joints, {values['rate']:g} Hz, {self._mode}")

    def _create_topics(self, values):
        self._state_pub = Outlet(self._node, JointState, 'joint_states', self._mode)
        Inbox(self._node, Float64MultiArray, 'effort_controller/commands', self._on_command,
              self._mode)
        if self._mode == 'lockstep':
            self._clock_pub = self._node.create_publisher(
                Clock, '/clock', process.publisher_qos(self._mode))
            self._clocks = self._node.direct.hearers[self._clock_pub.topic_name]
            self._clock_period = round(NANOSECONDS / values['clock_rate'])
            self._next_clock = 0
            self._node.create_service(SetBool, '~/pause', self._health.guard(self._on_pause))

    def _on_pause(self, request, response):
        self._paused = request.data
        response.success, response.message = True, 'paused' if request.data else 'goes on'
        return response

    def run(self, spinner):
        """Simulate until the duration is over or a signal comes."""
        while self._state_pub.count_hearers() < self._listeners and spinner.goes_on():
            spinner.spin_once(0.02)
        if self._mode == 'lockstep':
            self._run_lockstep(spinner)
        else:
            with process.BackgroundSpin(spinner) as background:
                self._run_paced(spinner, background)

    def _on_command(self, message):
        """Return whether the message is a command, to be obeyed or not."""
        try:
            torque = messages.read_command(message, len(self._zero))
        except messages.RefusedError as error:
            self._refused += 1
            self._health.warn('command', f'command refused: {error}')
            return False
        stamp, now = messages.read_stamp(message), time.monotonic_ns()
        source = messages.read_source(message) or ''
        conflict = self._commands.hear(source, now) if self._mode == 'realtime' else ''
        if conflict:
            self._fail_passing(conflict)
            return True
        held = self._command[1]
        if stamp is not None and (stamp > self._stamp or (held is not None and stamp < held)):
            return True  # answers a state that never was, or was overtaken on its way
        silence = self._commands.silence(now) or 0
        self._commands.take(source, now)  # first: `_watch` in the other thread looks at it
        if not self._supervisor.active:
            self._resume(silence)
        self._command = (np.array(torque), stamp, now)
        if stamp is not None and self._mode == 'realtime':
            self._timing.answered((stamp - self._first) // self._period, now)
        return True

    def _advance(self, torque):
        """Simulate one sample and publish what is measured at its end."""
        self._simulate(torque)
        self._end_sample()

    def _simulate(self, torque):
        measured = self._plant.measured
        if not self._supervisor.active:
            torque = self._zero
        elif self._limits is not None:
            torque = limiting.limited(torque, self._given, self._period / NANOSECONDS,
                                      measured.q_link, measured.dq_link, self._limits)
        self._given = torque
        self._plant.advance(torque)
        if not np.isfinite(measured.q_link).all():
            raise SimulationError(f'the simulation diverged under the torque '
                                  f'{torque.tolist()} N m; more substeps or a softer robot')
        if self._limits is not None:
            broken = limiting.violation(self._joints, measured, self._limits)
            if broken:
                self.fail(broken)

    def _end_sample(self):
        self._ticks += 1
        self._stamp += self._period
        self._publish()

    def _is_last(self):
        return self._samples is not None and self._ticks + 1 >= self._samples

    def _publish(self):
        plant = self._plant
        message = self._writer.write(plant.measured, plant.applied, self._stamp)
        self._timing.published()
        self._state_pub.publish(message)

    # faults and requests, from any thread ----------------------------------------------------

    def _fail_passing(self, sentence):
        with self._lock:
            if self._supervisor.trip(sentence):
                self._passing = True
            elif self._passing:  # a silence, say, and then two controllers
                self._supervisor.amend(sentence)
            self._settle()

    def _resume(self, silence):
        """Let torque flow again, now that one controller commands after ``silence`` [ns]."""
        with self._lock:
            if self._passing and not self._supervisor.stopped:
                self._node.get_logger().info(f'{self._commands.name} was silent for '
                                             f'{silence / 1e6:.0f} ms; commands come again')
                self._supervisor.reset()
                self._resumed = self._stamp  # as a bridge lets it rise, whoever begins how
            if self._wanted:
                self._supervisor.enable(self._health.fault)
            self._settle()

    def _watch(self):
        """Look for the silence of the controller."""
        silence = self._commands.silence(time.monotonic_ns())
        if silence is not None and silence > self._silence_timeout and self._supervisor.active:
            self._fail_passing(f'no command from {self._commands.name} for '
                               f'{silence / 1e6:.0f} ms')

    def _settle(self):
        state = self._supervisor.state, self._supervisor.reason
        if state == self._said:
            return
        self._said = state
        if state[0] != 'FAULT' or self._supervisor.stopped:
            self._passing = False
        fault = state[0] == 'FAULT'
        sentence = f'{state[0]}: {state[1]}'
        self._health.tell(ERROR if fault else OK, sentence)
        if fault:  # two lines of code: rclpy refuses two severities from one
            self._node.get_logger().warning(sentence)
        else:
            self._node.get_logger().info(sentence)

    def obstacle(self):
        """Return what stands against torque now (str)."""
        return self._health.fault

    def enable(self, refusals=None):
        """Let torque flow as soon as there is a command; as BridgedRobot.enable."""
        with self._lock:
            outdated = self._outdated(refusals)
            self._wanted = self._wanted or not outdated
            return outdated or self._settled(self._supervisor.enable())

    def disable(self):
        """Take torque away until `enable`; return an Outcome."""
        with self._lock:
            self._wanted = False
            return self._settled(self._supervisor.disable())

    def reset(self):
        """Leave a fault; `enable` then lets torque flow again. Return an Outcome."""
        with self._lock:
            self._wanted = self._wanted and self._supervisor.state != 'FAULT'
            return self._settled(self._supervisor.reset())

    def fail(self, sentence):
        """Enter a fault that lasts until `reset`, also from one that would pass by itself."""
        with self._lock:
            if not self._supervisor.trip(sentence) and self._passing:
                self._supervisor.amend(sentence)
            self._passing = False
            self._settle()

    def figures(self):
        """Return what to report on /diagnostics."""
        silence = self._commands.silence(time.monotonic_ns())
        return {
            'state': self._supervisor.state, 'reason': self._supervisor.reason,
            'samples': self._ticks, 'samples without a fresh command': self._missed,
            'samples left out': self._left_out, 'commands refused': self._refused,
            'faults': self._supervisor.faults,
            'controller': self._commands.name if silence is not None else 'none yet',
            'silence of the controller [ms]': round((silence or 0) / 1e6, 1)}

    # realtime ------------------------------------------------------------------------------

    def _simulate_acting(self):
        """Simulate the sample that follows the last state."""
        with self._lock:
            self._watch()
            self._simulate(self._acting() * min((self._stamp - self._resumed) / _RISE, 1.0))

    def _acting(self):
        """Return the torque for the sample that ends now; zero if the last command is stale."""
        torque, stamp, arrived = self._command
        self._tell_late(stamp)
        if stamp == self._stamp:
            return torque
        self._missed += 1
        if stamp is None:  # a plain command acts from its arrival until the timeout
            fresh = time.monotonic_ns() - arrived <= self._timeout
        else:
            fresh = 0 < self._stamp - stamp <= self._timeout
        return torque if fresh else self._zero

    def _tell_late(self, stamp):
        """Warn where too many samples end before the command that answers them has come."""
        if stamp is None or not self._supervisor.active:  # plain commands answer no state
            self._late.restart()
            return
        sentence = self._late.add(stamp != self._stamp)
        if sentence:
            self._health.warn('late', sentence)

    def _run_paced(self, spinner, background):
        scheduling.tighten_timers()
        sys.setswitchinterval(_SWITCH)
        self._stamp = self._first = now(self._node).nanoseconds
        deadline = time.monotonic_ns()
        self._plant.measure()
        with self._lock:
            self._publish()
        while spinner.goes_on() and not self._is_last():
            if background.error is not None:
                raise background.error
            deadline += self._period
            ahead = self._command[1] == self._stamp  # answered at once, in this process
            if ahead:
                self._simulate_acting()
            early = deadline - time.monotonic_ns()
            if early > 0:
                time.sleep(early / NANOSECONDS)
            with self._lock:
                left_out = self._follow_clock()
            if left_out > 0:  # no more than it is late: the clock may have been set
                late = time.monotonic_ns() - deadline
                deadline += min(left_out, late // self._period) * self._period
            if not ahead:
                self._simulate_acting()
            with self._lock:
                self._end_sample()
        if self._missed:
            self._node.get_logger().info(
                f'{self._missed} of {self._ticks} samples had no fresh command')

    def _follow_clock(self):
        """Let the stamp of the sample that ends now be near the clock; return samples left out."""
        behind = now(self._node).nanoseconds - self._stamp - self._period
        if abs(behind) <= _LATEST_START * self._period:
            return 0
        count = int(behind / self._period)
        self._left_out += max(count, 0)
        if count < 0:
            self._command = (self._zero, None, 0)  # the next ones are older than it
        self._stamp += count * self._period
        self._first += count * self._period  # which counts samples for the timing
        self._resumed += count * self._period
        self._health.warn('clock', (
            f'{behind / 1e6:.1f} ms late, {count} samples are left out: the machine is too busy '
            'for this rate or stood still, or the clock was set' if behind > 0 else
            f'the clock was set back by {-behind / 1e6:.1f} ms'))
        return count

    # lockstep ------------------------------------------------------------------------------

    def _run_lockstep(self, spinner):
        self._plant.measure()
        self._publish_clock()
        self._publish()
        repeat, due = time.monotonic() + _REPEAT_PERIOD, 0.0
        while spinner.goes_on():
            if self._paused or not self._is_answered():
                spinner.spin_once()
            elif self._state_pub.count_others():  # answered at once, in this process
                spinner.spin_once(max(due - time.monotonic(), 0.0))
                due = time.monotonic() + _SHORTEST_SAMPLE
            elif time.monotonic() > due:
                spinner.spin_once(0.0)
                due = time.monotonic() + _CALLBACKS_PERIOD
            if self._paused:
                continue
            if self._is_answered():
                torque = self._command[0]
                if self._is_last():  # answered too: a recording lacks nothing
                    break
                self._command = (torque, None, 0)
                self._advance(torque)
                self._publish_clock()
                repeat = time.monotonic() + _REPEAT_PERIOD
            elif time.monotonic() > repeat:
                self._publish()  # a node that has just come needs the state it is to answer
                repeat = time.monotonic() + _REPEAT_PERIOD

    def _is_answered(self):
        _, stamp, arrived = self._command
        return arrived and (stamp is None or stamp == self._stamp)

    def _publish_clock(self):
        if self._stamp >= self._next_clock:
            sec, nanosec = divmod(self._stamp, NANOSECONDS)
            message = Clock(clock=Time(sec=sec, nanosec=nanosec))
            self._clock_pub.publish(message)
            for hear in self._clocks:
                hear(message)
            self._next_clock = self._stamp + self._clock_period

    def finish(self):
        """End: a simulated robot needs no last zero."""
        self._timing.save()
