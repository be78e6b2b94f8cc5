# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A robot as a process of its own that speaks as ros2_control does.

It publishes JointState on /robot/joint_states and holds the last Float64MultiArray of
/robot/effort_controller/commands for ever, as the effort forwarder does. Its names, signs, gears
and units are not ours: see MAPPING. Two joints without effect on each other, without friction
but viscous; a law of its own, not the package's simulator.
"""

import sys
import time

from gms_flex_control.nodes.process import avoid_shared_memory
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

STIFFNESS, LINK, MOTOR, FRICTION = 1.5, 0.06, 0.006, 0.3  # of the joints, SI
GEAR, CONSTANT = 50.0, 0.1  # of joint 1; its motor counts backwards and takes amperes
OFFSET = 0.3                # the link encoder of joint 2 reads -0.3 at angle 0
STATES, EFFORTS = '/robot/joint_states', '/robot/effort_controller/commands'
NAMES = ['gripper', 'm2', 'a2', 'm1', 'a1']  # in the joint states
MAPPING = f"""
mapping:
  joint1:
    link: {{name: a1}}
    motor: {{name: m1, sign: -1.0, ratio: {GEAR}}}
    effort: {{sign: -1.0, torque_constant: {CONSTANT}, side: motor, ratio: {GEAR}}}
  joint2:
    link: {{name: a2, offset: {OFFSET}}}
    motor: {{name: m2}}
bridge: {{command_order: [joint2, joint1]}}
"""
START = (0.4, -0.2)         # where the joints rest


class Robot:
    """Two flexible joints; ``torque`` acts on the motors."""

    def __init__(self):
        self.q, self.dq = [*START, *START], [0.0] * 4  # links, then motors
        self.torque = [0.0, 0.0]

    def obey(self, message):
        """Take efforts in the order joint 2, joint 1; of joint 1 in amperes, reversed."""
        second, first = message.data
        self.torque = [-CONSTANT * GEAR * first, second]

    def step(self, duration):
        """Move for the time that has passed; a busy machine may have made it long."""
        steps = max(10, round(duration / 0.0004))
        h = duration / steps
        for _ in range(steps):
            for j in range(2):
                spring = STIFFNESS * (self.q[j + 2] - self.q[j])
                self.dq[j] += h * (spring - FRICTION * self.dq[j]) / LINK
                drag = 0.2 * FRICTION * self.dq[j + 2]
                self.dq[j + 2] += h * (self.torque[j] - spring - drag) / MOTOR
                self.q[j] += h * self.dq[j]
                self.q[j + 2] += h * self.dq[j + 2]

    def message(self):
        """Return the joint states; velocity of motor 1 and efforts at links are not measured."""
        q, nan = self.q, float('nan')
        efforts = [nan, self.torque[1], nan, -self.torque[0] / (CONSTANT * GEAR), nan]
        return JointState(name=NAMES, position=[nan, q[3], q[1] - OFFSET, -GEAR * q[2], q[0]],
                          velocity=[nan, self.dq[3], self.dq[1], nan, self.dq[0]], effort=efforts)


def main():
    """Run at the rate given first [Hz] until killed."""
    period = 1.0 / float(sys.argv[1])
    avoid_shared_memory()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, robot = rclpy.create_node('robot'), Robot()
    publisher = node.create_publisher(JointState, STATES, 10)
    node.create_subscription(Float64MultiArray, EFFORTS, robot.obey, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    last = time.monotonic()
    while True:
        while (left := last + period - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        now = time.monotonic()
        robot.step(now - last)
        last = now
        message = robot.message()
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)


if __name__ == '__main__':
    main()
