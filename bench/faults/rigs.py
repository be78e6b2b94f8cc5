# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What the faults are tried on: a robot whose clock the bench holds, and the whole loop."""

import time

from bench.faults.node_bench import COMMANDS, config, default_files, DIAGNOSTICS, STATES
from bench.faults.wire import JOINTS, stamp_of
from diagnostic_msgs.msg import DiagnosticArray
from gms_flex_control.file_io import robot_file
from gms_flex_control.nodes.messages import JointStateWriter, NANOSECONDS
from gms_flex_control.schema.files import load_robot
from gms_flex_control.simulation.loop import SteppedPlant
import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

RATE = 250.0
PERIOD = round(NANOSECONDS / RATE)
CONTROLLER, TRAJECTORY, PLANT = '/cascade_controller', '/trajectory', '/plant'
_STALL = 0.025  # between two joint states [s]
_FRESH = 4  # samples a command acts at most
_SMALL = {f'trajectory__{joint}__amplitude': 0.3 for joint in JOINTS}


class Log:
    """
    Messages with the time at which they were published [s], in the order of coming.

    DDS gives that time, counted as time.monotonic() does: a bench that is late in
    reading does not make the nodes late.
    """

    def __init__(self):
        self.messages, self.times = [], []
        self._offset = time.time() - time.monotonic()

    def append(self, message):
        """Take a message that was published now."""
        self.times.append(time.monotonic())
        self.messages.append(message)

    def take(self, message, info):
        """Take a message and what DDS adds to it."""
        self.times.append(info['source_timestamp'] / NANOSECONDS - self._offset)
        self.messages.append(message)

    def __len__(self):
        return len(self.messages)

    def __getitem__(self, index):
        return self.messages[index]

    def since(self, moment):
        """Return (time, message) of all that came at ``moment`` [s] or later."""
        return [(when, message) for when, message in zip(self.times, self.messages, strict=True)
                if when >= moment]

    def longest_gap(self, moment):
        """Return the longest time between two messages since a moment [s]; infinite if none."""
        return max(np.diff([when for when, _ in self.since(moment)]), default=np.inf)


class Diagnostics:
    """What nodes have said of themselves last."""

    def __init__(self, bench):
        self._last = {}
        bench.listen(DiagnosticArray, DIAGNOSTICS, self)

    def append(self, message):
        """Take a message."""
        for status in message.status:
            self._last[status.hardware_id] = status

    def level(self, node):
        """Return the level of a node (int); -1 before it has said any."""
        status = self._last.get(node)
        return -1 if status is None else int.from_bytes(status.level, 'little')

    def sentence(self, node):
        """Return what a node says ('' before it has)."""
        status = self._last.get(node)
        return '' if status is None else status.message

    def figure(self, node, key):
        """Return one of its figures as a number; 0 before it has given any."""
        status = self._last.get(node)
        pairs = () if status is None else status.values
        return next((float(pair.value) for pair in pairs if pair.key == key), 0.0)


class HeldRobot:
    """
    A simulated arm in this process, with controller and trajectory as processes around it.

    ``controller`` and ``trajectory`` are commands (list of str) of other processes than the
    installed ones, ``parameters`` (dict) are of both nodes. ``commands`` has all commands,
    ``shift`` [ns] is added to the stamps that are published, ``quiet`` keeps the states back, and
    ``spoil`` changes each before it is published.
    """

    def __init__(self, bench, *, controller=None, trajectory=None, parameters=None):
        self.bench, self.commands, self.diagnostics = bench, Log(), Diagnostics(bench)
        robot = load_robot(robot_file())
        self._plant = SteppedPlant(robot, period=PERIOD / NANOSECONDS, substeps=20)
        self._writer = JointStateWriter(robot.joints, robot.motors)
        self.stamp, self.shift, self.quiet = 10 * NANOSECONDS, 0, False
        self.spoil = lambda message: None
        bench.listen(Float64MultiArray, COMMANDS, self.commands)
        self.states = bench.speak(JointState, STATES)
        self.controller = bench.start('controller_node', command=controller, **parameters or {})
        self.trajectory = bench.start(
            'trajectory_node', command=trajectory, trajectory__autostart=True,
            trajectory__ramp_time=3.0, **_SMALL,
            files=[*default_files(), config('sinusoid.yaml')], **parameters or {})
        self._plant.advance(np.zeros(robot.n_joints))
        bench.until(lambda: self.states.get_subscription_count() == 2)
        self._deadline = time.monotonic()

    def message(self):
        """Return the joint state of now; the same object every time."""
        return self._writer.write(self._plant.measured, self._plant.applied,
                                  self.stamp + self.shift)

    def step(self):
        """Obey for one period, publish, and handle what comes until the next one."""
        self._plant.advance(self._torque())
        self.stamp += PERIOD
        if not self.quiet:
            message = self.message()
            self.spoil(message)
            self.states.publish(message)
        self._deadline = max(self._deadline + 1.0 / RATE, time.monotonic())  # never in bursts
        while (left := self._deadline - time.monotonic()) > 0:
            self.bench.spin(left)

    def _torque(self):
        if not self.commands:
            return np.zeros(2)
        command = self.commands[-1]
        age = self.stamp + self.shift - (stamp_of(command) or 0)
        if not 0 <= age <= _FRESH * PERIOD:
            return np.zeros(2)
        return np.array(command.data)

    def run(self, duration):
        """Go on for a time [s]; return when that began."""
        begin = time.monotonic()
        while time.monotonic() < begin + duration:
            self.step()
        return begin

    def until(self, condition, bound=10.0):
        """Go on until ``condition()`` holds; return its value, falsy if it never did."""
        end = time.monotonic() + bound
        while not (value := condition()) and time.monotonic() < end:
            self.step()
        return value

    def pushes(self):
        """Return whether the last command is a torque."""
        return bool(self.commands) and any(abs(t) > 0.01 for t in self.commands[-1].data)

    def settle(self):
        """Go on until the controller follows and pushes."""
        return self.until(lambda: self.diagnostics.sentence(CONTROLLER) == 'following'
                          and self.pushes())

    def stalled(self, since):
        """Return whether the machine itself held up the loop since a moment [s]."""
        return self.commands.longest_gap(since) > _STALL

    def largest(self, since):
        """Return the largest torque commanded since a moment [N m]; 0 without any command."""
        return largest_torque(self.commands.since(since))


def largest_torque(timed):
    """Return the largest torque of (time, command) pairs [N m]; infinite for NaN."""
    torques = [abs(torque) for _, command in timed for torque in command.data]
    return max((torque if torque == torque else np.inf for torque in torques), default=0.0)


def zero_after(commands, moment):
    """Return when the first zero came after ``moment`` [s] of a Log; None if none has."""
    return next((when for when, command in commands.since(moment) if not any(command.data)),
                None)


class Loop:
    """
    Plant, controller and trajectory as processes, moving along the sinusoid.

    ``rate`` [Hz] is that of joint states, ``deaf_to`` a topic the bench does not listen to,
    because it will be flooded.
    """

    def __init__(self, bench, *, rate=RATE, controller_parameters=None, deaf_to=''):
        self.bench = bench
        self.commands, self.states, self.diagnostics = Log(), Log(), Diagnostics(bench)
        self._heard = []
        for kind, topic, log in ((Float64MultiArray, COMMANDS, self.commands),
                                 (JointState, STATES, self.states)):
            if topic != deaf_to:
                bench.listen(kind, topic, log)
                self._heard.append(log)
        self._files = [*default_files(), config('sinusoid.yaml')]
        self._parameters = controller_parameters or {}
        self.start_controller()
        self.start_trajectory()
        self.plant = bench.start('plant_node', files=self._files, rate=rate,
                                 wait_for_subscribers=3 - (deaf_to == STATES))
        self.settle()

    def start_controller(self, name='controller_node', arguments=()):
        """Start the controller (again), with further words of the command line."""
        self.controller = self.bench.start(name, files=self._files, arguments=arguments,
                                           **self._parameters)

    def start_trajectory(self, name='trajectory_node', arguments=()):
        """Start the trajectory node (again), with further words of the command line."""
        self.trajectory = self.bench.start(
            name, files=self._files, arguments=arguments, trajectory__autostart=True,
            trajectory__ramp_time=3.0, **_SMALL)

    def moves(self):
        """Return whether the plant is given torque now."""
        if self.states:
            return any(self.states[-1].effort[2:])
        return bool(self.commands) and any(self.commands[-1].data)

    def release(self):
        """Leave a fault, and start the motion again: an enabled arm holds."""
        for service in ('plant/reset', 'plant/enable', 'trajectory/start'):
            self.bench.until(lambda name=service: self.bench.call(Trigger, f'/{name}').success)
        self.bench.until(self.moves)

    def stalled(self, since):
        """Return whether the machine itself held up the loop since a moment [s]."""
        return self.states.longest_gap(since) > _STALL

    def settle(self):
        """Wait until the arm is moved, and heard to be."""
        self.bench.until(lambda: all(len(log) > 50 for log in self._heard) and self.moves())

    def run(self, duration):
        """Listen for a time [s]; return when that began."""
        begin = time.monotonic()
        self.bench.until(lambda: time.monotonic() > begin + duration)
        return begin
