# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Publish messages that nobody should act on as fast as this process can.

``python -m bench.faults.storm TOPIC SECONDS``
"""

import sys
import time

from bench.faults.node_bench import COMMANDS, REFERENCE, STATES
from bench.faults.wire import array_message, joint_state
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

# topic: a message that is refused, of another time or of no interest
KINDS = {
    COMMANDS: array_message([float('nan')] * 2, 'stamp:0'),
    STATES: joint_state(0, names=['other'] * 4),
    REFERENCE: array_message([0.1] * 10, 'stamp:-1000000000000'),
    '/emergency_stop': Bool(data=False)}
_AT_ONCE = 100


def main():
    """Publish for a time; print how many messages a second that were."""
    topic, duration = sys.argv[1], float(sys.argv[2])
    message = KINDS[topic]
    rclpy.init()
    node = rclpy.create_node('storm', enable_rosout=False, start_parameter_services=False)
    publisher = node.create_publisher(
        type(message), topic, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    print('begins', flush=True)
    begin, count = time.monotonic(), 0
    while (elapsed := time.monotonic() - begin) < duration:
        for _ in range(_AT_ONCE):
            publisher.publish(message)
        count += _AT_ONCE
    print(f'{count / elapsed:.0f} messages a second', flush=True)


if __name__ == '__main__':
    main()
