# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Run the identification experiment on the simulated robot, or on a real one through the bridge.

Its bag, the friction found and a report stand in the folder it was started from. On hardware
read docs/identification.md first: the arm moves as soon as the bridge is enabled.
"""

from gms_flex_control.nodes import launch_parts as parts
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description():
    """Return the closed loop and the node of the experiment; all end with it."""
    own = [
        DeclareLaunchArgument('experiment', default_value=parts.config('identification.yaml'),
                              description='Parameter file of the experiment: ranges, limits, '
                                          'steps'),
        DeclareLaunchArgument('bag', default_value='identification',
                              description='Recording to be made, results beside it')]
    experiment = parts.node(
        'identification_node', LaunchConfiguration('experiment'),
        {'mode': LaunchConfiguration('mode'),
         'identification.bag': ParameterValue(LaunchConfiguration('bag'), value_type=str)},
        on_exit=Shutdown())
    return parts.description([*parts.arguments(), *own],
                             [*parts.closed_loop(), experiment])
