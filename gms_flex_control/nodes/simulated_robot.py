# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The simulated robot of a plant node, and what takes its torque away."""

from functools import partial
import time

from gms_flex_control.errors import SimulationError
from gms_flex_control.hardware import limits as limiting
from gms_flex_control.hardware import supervision
from gms_flex_control.nodes import messages
from gms_flex_control.nodes.messages import NANOSECONDS
from gms_flex_control.nodes.pacing import Lockstep, Paced
from gms_flex_control.nodes.topics import Inbox, Outlet
from gms_flex_control.schema.build import limits_from_values, robot_from_values
from gms_flex_control.simulation.loop import count_samples, SteppedPlant
import numpy as np
from rclpy.logging import LoggingSeverity
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


class _Arm:
    """The simulated arm: limited, stepped and published; ``stamp`` is that of its last state."""

    def __init__(self, node, values, joints):
        robot = robot_from_values(values)
        self.period, self.stamp, self.ticks = round(NANOSECONDS / values['rate']), 0, 0  # [ns]
        duration = values['duration']
        self._samples = count_samples(duration, self.period) if duration else None
        make_plant = partial(
            SteppedPlant, robot, period=self.period / NANOSECONDS, substeps=values['substeps'],
            seed=values['seed'],
            q_link=[values[f'initial.{joint}'] for joint in robot.joints])
        make_plant().advance(np.zeros(robot.n_joints))  # compile before the clock runs
        self._plant = make_plant()
        self._limits, self._joints = limits_from_values(values, joints), joints
        self.zero = self._given = np.zeros(robot.n_joints)
        self._writer = messages.JointStateWriter(robot.joints, robot.motors)
        self.outlet = Outlet(node, JointState, 'joint_states', values['mode'])

    def begin(self, stamp) -> None:
        """Measure the first state."""
        self.stamp = stamp
        self._plant.measure()
        self._ready()

    def simulate(self, torque) -> str:
        """Simulate one sample; return which limit is broken (str), '' if none is."""
        measured, limits = self._plant.measured, self._limits
        if limits is not None and torque is not self.zero:
            torque = limiting.limited(torque, self._given, self.period / NANOSECONDS,
                                      measured.q_link, measured.dq_link, limits)
        self._given = torque
        self._plant.advance(torque)
        if not np.isfinite(measured.q_link).all():
            raise SimulationError(f'the simulation diverged under the torque '
                                  f'{torque.tolist()} N m; more substeps or a softer robot')
        return '' if limits is None else limiting.violation(self._joints, measured, limits)

    def end_sample(self) -> None:
        """Make what is measured at the end of a sample the state there is."""
        self.ticks += 1
        self.stamp += self.period
        self._ready()

    def _ready(self):
        self._message = self._writer.write(self._plant.measured, self._plant.applied, self.stamp)

    def publish(self, deadline=0) -> None:
        """Publish the state there is at ``deadline`` by monotonic_ns."""
        while time.monotonic_ns() < deadline:
            # a sleep would end too late, and what it finds would be cold; nobody else gets the
            # interpreter meanwhile, see _UNDISTURBED in pacing.py
            pass
        self.outlet.publish(self._message)

    def is_last(self) -> bool:
        """Return whether the sample that ends now is the last of the run."""
        return self._samples is not None and self.ticks + 1 >= self._samples


class SimulatedRobot(supervision.SupervisedRobot):
    """
    A robot that is simulated sample by sample.

    The silence of its controller is a fault that passes when that commands again: it knows of the
    gap, by the stamps or because it is new. All others last until ``~/reset``.
    """

    def __init__(self, node, values, joints):
        self._node, self._health, self._lock = node, node.health, node.direct.lock
        self._lockstep = values['mode'] == 'lockstep'
        self._silence_timeout = round(NANOSECONDS * values['silence_timeout'])
        self._listeners = values['wait_for_subscribers']
        self._arm = _Arm(node, values, joints)
        self._pace = (Lockstep if self._lockstep else Paced)(self, self._arm, node, values)
        self._supervisor = supervision.Supervisor('no command yet')
        self._commands = supervision.CommandWatch()
        self._wanted = True      # whether commands enable torque
        self._passing = False    # whether the fault passes by itself
        self._said, self._refused = None, 0
        self.command = (self._arm.zero, None, 0)  # torque, stamp answered, when it came
        Inbox(node, Float64MultiArray, 'effort_controller/commands', self._on_command,
              values['mode'])
        node.get_logger().info(f"{len(joints)} joints, {values['rate']:g} Hz, {values['mode']}")

    def run(self, spinner) -> None:
        """Simulate until the duration is over or a signal comes."""
        while self._arm.outlet.count_hearers() < self._listeners and spinner.goes_on():
            spinner.spin_once(0.02)
        self._pace.run(spinner)

    def _on_command(self, message):
        """Return whether the message is a command, to be obeyed or not."""
        arm = self._arm
        try:
            torque = messages.read_command(message, len(arm.zero))
        except messages.RefusedError as error:
            self._refused += 1
            self._health.warn('command', f'command refused: {error}')
            return False
        (stamp, source), now = messages.read_marks(message), time.monotonic_ns()
        conflict = '' if self._lockstep else self._commands.hear(source, now)
        if conflict:
            self.fail(conflict)
            return True
        held = self.command[1]
        if stamp is not None and (stamp > arm.stamp or (held is not None and stamp < held)):
            return True  # answers a state that never was, or was overtaken on its way
        silence = self._commands.silence(now) or 0
        self._commands.take(source, now)  # first: `watch` in the other thread looks at it
        if not self._supervisor.active:
            self._resume(silence)
        self.command = (np.array(torque), stamp, now)
        return True

    def simulate(self, torque) -> None:
        """Simulate one sample under a torque, if any may flow."""
        broken = self._arm.simulate(torque if self._supervisor.active else self._arm.zero)
        if broken:
            self.fail(broken)

    @property
    def active(self) -> bool:
        """Return whether torque may flow."""
        return self._supervisor.active

    # faults and requests, from any thread ----------------------------------------------------

    def _resume(self, silence):
        """Let torque flow again, now that one controller commands after ``silence`` [ns]."""
        with self._lock:
            if self._passing and not self._supervisor.stopped:
                self._node.get_logger().info(f'{self._commands.name} was silent for '
                                             f'{silence / 1e6:.0f} ms; commands come again')
                self._supervisor.reset()
                self._pace.resumed = self._arm.stamp  # as a bridge lets it rise
            if self._wanted:
                self._supervisor.enable(self._health.fault)
            self._settle()

    def watch(self) -> None:
        """Look for the silence of the controller."""
        silence = self._commands.silence(time.monotonic_ns())
        if silence is not None and silence > self._silence_timeout and self._supervisor.active:
            self._passing = self._supervisor.trip(
                f'no command from {self._commands.name} for {silence / 1e6:.0f} ms')
            self._settle()

    def _settle(self):
        state = self._supervisor.state, self._supervisor.reason
        if state == self._said:
            return
        self._said = state
        if state[0] != 'FAULT' or self._supervisor.stopped:
            self._passing = False
        self._health.report_state(self._supervisor, LoggingSeverity.WARN)

    def obstacle(self) -> str:
        """Return what stands against torque now (str)."""
        return self._health.fault

    def enable(self, refusals=None) -> supervision.Outcome:
        """Let torque flow as soon as there is a command; as BridgedRobot.enable."""
        with self._lock:
            outdated = self._outdated(refusals)
            self._wanted = self._wanted or not outdated
            return outdated or self._settled(self._supervisor.enable())

    def disable(self) -> supervision.Outcome:
        """Take torque away until `enable`; return an Outcome."""
        with self._lock:
            self._wanted = False
            return self._settled(self._supervisor.disable())

    def reset(self) -> supervision.Outcome:
        """Leave a fault; `enable` then lets torque flow again. Return an Outcome."""
        with self._lock:
            self._wanted = self._wanted and self._supervisor.state != 'FAULT'
            return self._settled(self._supervisor.reset())

    def fail(self, sentence) -> None:
        """Enter a fault that lasts until `reset`, also from one that would pass by itself."""
        with self._lock:
            if not self._supervisor.trip(sentence) and self._passing:
                self._supervisor.amend(sentence)
            self._passing = False
            self._settle()

    def figures(self) -> dict:
        """Return what to report on /diagnostics."""
        return {
            'state': self._supervisor.state, 'reason': self._supervisor.reason,
            **dict(zip(supervision.SIMULATED, (
                self._arm.ticks, self._pace.missed, self._pace.left_out), strict=True)),
            'commands refused': self._refused, 'faults': self._supervisor.faults,
            **self._commands.figures(time.monotonic_ns())}

    def finish(self) -> None:
        """Stay until those who acknowledge have the last state; it needs no last zero."""
        self._arm.outlet.wait_for_all_acked()
