# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Publish joint states at 500 Hz and leave the last stamp in a file for the test to read."""

import array
import mmap
import struct
import sys
import time

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

PERIOD = 0.002


def main(path, reliability):
    rclpy.init()
    node = rclpy.create_node('bags_publisher')
    publisher = node.create_publisher(JointState, '/joint_states', QoSProfile(
        depth=10, reliability=ReliabilityPolicy[reliability.upper()]))
    with open(path, 'r+b') as stream, mmap.mmap(stream.fileno(), 8) as shared:
        message = JointState(name=['joint1', 'joint1_motor'])
        k, deadline = 0, time.monotonic()
        while True:
            stamp = time.time_ns()
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            message.position = array.array('d', [float(k), -float(k)])
            publisher.publish(message)
            shared[:] = struct.pack('<Q', stamp)
            k, deadline = k + 1, deadline + PERIOD
            time.sleep(max(0.0, deadline - time.monotonic()))


if __name__ == '__main__':
    main(*sys.argv[1:])
