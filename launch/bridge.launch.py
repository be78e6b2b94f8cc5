# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Start the bridge to a real robot, controller and trajectory; docs/hardware.md comes first."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'gms_flex_control'


def generate_launch_description():
    """Return bridge, controller and trajectory; torque waits for /plant/enable."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config'])
    files = [LaunchConfiguration('robot_file'), LaunchConfiguration('controller_file')]
    return LaunchDescription([
        DeclareLaunchArgument(
            'robot_file', default_value=PathJoinSubstitution([config, 'robot.yaml']),
            description='Parameter file of the robot'),
        DeclareLaunchArgument(
            'bridge_file', default_value=PathJoinSubstitution([config, 'bridge.yaml']),
            description='Parameter file of the bridge: topics, mapping, limits'),
        DeclareLaunchArgument(
            'controller_file', default_value=PathJoinSubstitution([config, 'controller.yaml']),
            description='Parameter file of the controller'),
        DeclareLaunchArgument(
            'trajectory_file', default_value=PathJoinSubstitution([config, 'sinusoid.yaml']),
            description='Parameter file of the trajectory; call /trajectory/start to begin'),
        Node(package=PACKAGE, executable='plant_node', output='screen',
             parameters=[*files, LaunchConfiguration('bridge_file'), {'backend': 'bridge'}]),
        Node(package=PACKAGE, executable='controller_node', output='screen', parameters=files),
        Node(package=PACKAGE, executable='trajectory_node', output='screen',
             parameters=[*files, LaunchConfiguration('trajectory_file')]),
    ])
