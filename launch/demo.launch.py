# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Move the simulated arm at once and show it in RViz; compensation may change while it moves.

ros2 param set /cascade_controller compensation none
"""

from gms_flex_control.nodes import launch_parts as parts
from gms_flex_control.params.gains import COMPENSATIONS
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    """Return the closed loop with a trajectory that starts by itself, and RViz."""
    compensation = DeclareLaunchArgument(
        'compensation', default_value='gms', choices=list(COMPENSATIONS),
        description='Friction compensation of the controller')
    loop = parts.closed_loop(
        controller={'compensation': LaunchConfiguration('compensation')},
        trajectory={'trajectory.autostart': True})
    return parts.description([*parts.arguments(rviz='true'), compensation], loop)
