# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Plant or bridge, controller and trajectory in one process: no sample waits for DDS."""

from functools import partial

from gms_flex_control.nodes import process
from gms_flex_control.nodes.controller_node import ControllerNode
from gms_flex_control.nodes.plant_node import PlantNode
from gms_flex_control.nodes.topics import Direct
from gms_flex_control.nodes.trajectory_node import TrajectoryNode
from rclpy.parameter import Parameter
from rclpy.time import Time


class LoopNode:
    """The nodes of the loop; a state is answered at once by the thread that publishes it."""

    def __init__(self):
        process.refuse_own_messages()
        direct = Direct()
        # the order in which they hear a joint state: the command does not wait for the next
        # reference
        self._controller = ControllerNode(direct)
        self._trajectory = TrajectoryNode(direct)
        self._plant = PlantNode(  # whose simulation makes the time that the others may take
            direct, parameter_overrides=[Parameter('use_sim_time', value=False)])
        self._plant.foresee(self._controller)
        self.nodes = [self._plant, self._controller, self._trajectory]
        for node in self.nodes:
            if node.get_parameter('use_sim_time').value:
                direct.hearers[node.resolve_topic_name('/clock')].append(partial(_set, node))

    def run(self, spinner) -> None:
        """Run the loop until a signal comes, or the plant's duration is over."""
        spinner.attend = partial(self._controller.attend, spinner)
        self._plant.run(spinner)

    def finish(self) -> None:
        """Leave zero torque on the wire."""
        for node in self.nodes:
            node.finish()

    def destroy_node(self) -> None:
        """End the nodes."""
        for node in self.nodes:
            node.destroy_node()


def _set(node, message):
    """Set the clock of a node that takes the time from /clock."""
    node.get_clock().set_ros_time_override(Time.from_msg(message.clock))
