# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The robot as a ROS 2 node: simulated, or the bridge to a real one."""

import sys

from gms_flex_control.nodes import process, scheduling
from gms_flex_control.nodes.bridged_robot import BridgedRobot
from gms_flex_control.nodes.direct import Direct
from gms_flex_control.nodes.health import Health
from gms_flex_control.nodes.parameters import NodeParameters
from gms_flex_control.nodes.safety import Safety
from gms_flex_control.nodes.simulated_robot import SimulatedRobot
from gms_flex_control.schema.keys import robot_keys
from gms_flex_control.schema.node_keys import bridge_keys, plant_node_keys, safety_keys
from rclpy.node import Node


def _simulator_keys(joints):
    return (*robot_keys(joints), *plant_node_keys(joints), *safety_keys(joints))


def _bridge_keys(joints):
    names = [key for key in robot_keys(()) if key.name in ('joints', 'motors')]
    return (*names, *safety_keys(joints), *bridge_keys(joints))


class PlantNode(Node):
    """Publish joint states and obey torque commands, as ros2_control's effort side does."""

    def __init__(self, direct=None, **kwargs):
        super().__init__('plant', automatically_declare_parameters_from_overrides=True, **kwargs)
        self.direct = direct or Direct()
        bridged = self.has_parameter('backend') and self.get_parameter('backend').value == 'bridge'
        parameters = NodeParameters(self, _bridge_keys if bridged else _simulator_keys)
        values = parameters.values
        self.health = Health(self, lambda: self._robot.figures(),
                             lambda: self._robot.fail(self.health.fault), self.direct.lock)
        self._robot = (BridgedRobot if bridged else SimulatedRobot)(
            self, values, parameters.joints, self.health)
        self._safety = Safety(
            self, self._robot, self.health, topic=values['emergency_stop_topic'],
            hold_service=values['bridge.hold_service'] if bridged else '')
        scheduling.take_priority(self, values['realtime_priority'])

    def run(self, spinner):
        """Simulate or bridge until a signal comes, or the duration is over."""
        self._safety.start()
        self._robot.run(spinner)

    def finish(self):
        """Leave zero torque on the wire."""
        self._robot.finish()
        self._safety.end()


def main(args=None):
    """Run the plant node until a signal; return its exit code."""
    return process.run_node(PlantNode, args)


if __name__ == '__main__':
    sys.exit(main())
