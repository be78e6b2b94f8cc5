# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The robot as a ROS 2 node: simulated, paced by the clock or stepped by its commands."""

from functools import partial
import sys
import time

from builtin_interfaces.msg import Time
from gms_flex_control.errors import SimulationError
from gms_flex_control.nodes import messages, process
from gms_flex_control.nodes.loop_timing import LoopTiming
from gms_flex_control.nodes.messages import NANOSECONDS
from gms_flex_control.nodes.parameters import NodeParameters
from gms_flex_control.schema.build import robot_from_values
from gms_flex_control.schema.keys import plant_node_keys, robot_keys
from gms_flex_control.simulation.stepped import SteppedPlant
import numpy as np
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

_REPEAT_PERIOD = 1.0     # an unanswered state is sent again in lockstep [s]
_LATEST_START = 5        # samples the loop may be late before it gives up catching up
_WARN_PERIOD = 5.0       # [s]


class PlantNode(Node):
    """Publish joint states and obey torque commands, as ros2_control's effort side does."""

    def __init__(self, **kwargs):
        super().__init__('plant', automatically_declare_parameters_from_overrides=True, **kwargs)
        parameters = NodeParameters(
            self, lambda joints: (*robot_keys(joints), *plant_node_keys(joints)))
        values = parameters.values
        robot = robot_from_values(values)
        self._mode = values['mode']
        self._period = round(NANOSECONDS / values['rate'])
        self._timeout = round(NANOSECONDS * values['command_timeout'])
        # as many samples as a run in one process has
        self._samples = None
        if values['duration'] > 0.0:
            self._samples = max(1, round(values['duration'] / (self._period / NANOSECONDS)))
        self._timing = LoopTiming(values['timing_file'], self._period,
                                  self._samples and self._samples * self._period)
        self._listeners = values['wait_for_subscribers']
        make_plant = partial(
            SteppedPlant, robot, period=self._period / NANOSECONDS, substeps=values['substeps'],
            seed=values['seed'],
            q_link=[values[f'initial.{joint}'] for joint in robot.joints])
        make_plant().advance(np.zeros(robot.n_joints))  # compile before the clock runs
        self._plant = make_plant()
        self._writer = messages.JointStateWriter(robot.joints, robot.motors)
        self._zero = np.zeros(robot.n_joints)
        self._command = (self._zero, None, 0)  # torque, stamp answered, when it came
        self._stamp = self._first = 0  # [ns]
        self._ticks = 0
        self._missed = 0
        self._state_pub = self.create_publisher(JointState, 'joint_states',
                                                process.publisher_qos(self._mode))
        self.create_subscription(
            Float64MultiArray, 'effort_controller/commands', self._on_command,
            process.subscriber_qos(self._mode), event_callbacks=process.NO_EVENTS)
        self._clock_pub = None
        if self._mode == 'lockstep':
            self._clock_pub = self.create_publisher(Clock, '/clock',
                                                    process.publisher_qos(self._mode))
            self._clock_period = round(NANOSECONDS / values['clock_rate'])
            self._next_clock = 0
        self.get_logger().info(
            f"{robot.n_joints} joints, {values['rate']:g} Hz, {self._mode}")

    def run(self, spinner):
        """Simulate until the duration is over or a signal comes."""
        while self._state_pub.get_subscription_count() < self._listeners and spinner.goes_on():
            spinner.spin_once(0.02)
        if self._mode == 'lockstep':
            self._run_lockstep(spinner)
        else:
            with process.BackgroundSpin(spinner) as background:
                self._run_paced(spinner, background)

    def _on_command(self, message):
        try:
            torque = messages.read_command(message, len(self._zero))
        except messages.RefusedError as error:
            self.get_logger().warning(f'command refused: {error}',
                                      throttle_duration_sec=_WARN_PERIOD)
            return
        stamp, now = messages.read_stamp(message), time.monotonic_ns()
        held = self._command[1]
        if stamp is not None and (stamp > self._stamp or (held is not None and stamp < held)):
            return  # answers a state that never was, or was overtaken on its way
        self._command = (np.array(torque), stamp, now)
        if stamp is not None and self._mode == 'realtime':
            self._timing.answered((stamp - self._first) // self._period, now)

    def _advance(self, torque):
        """Simulate one sample and publish what is measured at its end."""
        self._plant.advance(torque)
        if not np.isfinite(self._plant.measured.q_link).all():
            raise SimulationError(f'the simulation diverged under the torque '
                                  f'{torque.tolist()} N m; more substeps or a softer robot')
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

    # realtime ------------------------------------------------------------------------------

    def _acting(self):
        """Return the torque for the sample that ends now; zero if the last command is stale."""
        torque, stamp, arrived = self._command
        if stamp == self._stamp:
            return torque
        self._missed += 1
        if stamp is None:  # a plain command acts from its arrival until the timeout
            fresh = time.monotonic_ns() - arrived <= self._timeout
        else:
            fresh = 0 < self._stamp - stamp <= self._timeout
        return torque if fresh else self._zero

    def _run_paced(self, spinner, background):
        process.tighten_timers()
        self._stamp = self._first = self.get_clock().now().nanoseconds
        deadline = time.monotonic_ns()
        self._plant.measure()
        self._publish()
        while spinner.goes_on() and not self._is_last():
            if background.error is not None:
                raise background.error
            deadline += self._period
            late = time.monotonic_ns() - deadline
            if late < 0:
                time.sleep(-late / NANOSECONDS)
            elif late > _LATEST_START * self._period:
                self.get_logger().warning(
                    f'{late / 1e6:.1f} ms late: the machine is too busy for this rate',
                    throttle_duration_sec=_WARN_PERIOD)
                deadline += late
            self._advance(self._acting())
        if self._missed:
            self.get_logger().info(f'{self._missed} of {self._ticks} samples had no fresh command')

    # lockstep ------------------------------------------------------------------------------

    def _run_lockstep(self, spinner):
        self._plant.measure()
        self._publish_clock()
        self._publish()
        repeat = time.monotonic() + _REPEAT_PERIOD
        while spinner.goes_on():
            spinner.spin_once()
            torque, stamp, arrived = self._command
            if arrived and (stamp is None or stamp == self._stamp):
                if self._is_last():  # answered too: a recording lacks nothing
                    break
                self._command = (torque, None, 0)
                self._advance(torque)
                self._publish_clock()
                repeat = time.monotonic() + _REPEAT_PERIOD
            elif time.monotonic() > repeat:
                self._publish()  # a node that has just come needs the state it is to answer
                repeat = time.monotonic() + _REPEAT_PERIOD

    def _publish_clock(self):
        if self._stamp >= self._next_clock:
            sec, nanosec = divmod(self._stamp, NANOSECONDS)
            self._clock_pub.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))
            self._next_clock = self._stamp + self._clock_period

    def finish(self):
        """End: the plant itself commands nothing."""
        self._timing.save()


def main(args=None):
    """Run the plant node until a signal; return its exit code."""
    return process.run_node(PlantNode, args)


if __name__ == '__main__':
    sys.exit(main())
