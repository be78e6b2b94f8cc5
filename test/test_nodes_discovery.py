# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A process that comes later, such as a command of ros2, finds our nodes at once."""

import time

from node_harness import DISCOVERY, Lab, MOTION, rclpy

NO_HANDLERS = rclpy.signals.SignalHandlerOptions.NO


def test_a_process_that_comes_later_finds_the_nodes_at_once(tmp_path, monkeypatch):
    """By default Fast DDS announces a node every 3 s: who misses an answer waits so long."""
    with Lab(tmp_path) as lab:
        lab.environment[DISCOVERY] = 'SUBNET'
        monkeypatch.setenv(DISCOVERY, 'SUBNET')
        states = lab.hear('states')
        for name in ('controller_node', 'trajectory_node', 'plant_node'):
            lab.start(name, files=MOTION)
        lab.until(lambda: states)
        searched = [seconds_until_found({'cascade_controller', 'trajectory', 'plant'}, lab.domain)
                    for _ in range(4)]
        assert max(searched) < 2.0, searched


def seconds_until_found(names, domain):
    """Return how long a new participant takes to see nodes (set of str)."""
    context, begun = rclpy.Context(), time.monotonic()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=NO_HANDLERS)
    node = rclpy.create_node('late', context=context)
    try:
        while not names <= set(node.get_node_names()) and time.monotonic() < begun + 10.0:
            time.sleep(0.01)
        return time.monotonic() - begun
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
