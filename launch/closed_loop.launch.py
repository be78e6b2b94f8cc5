# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Start plant, controller and trajectory, each with both parameter files."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'gms_flex_control'


def generate_launch_description():
    """Return the closed loop of three nodes, with its launch arguments."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), 'config'])
    files = [LaunchConfiguration('robot_file'), LaunchConfiguration('controller_file')]
    mode = {'mode': LaunchConfiguration('mode')}
    return LaunchDescription([
        DeclareLaunchArgument(
            'robot_file', default_value=PathJoinSubstitution([config, 'robot.yaml']),
            description='Parameter file of the robot'),
        DeclareLaunchArgument(
            'controller_file', default_value=PathJoinSubstitution([config, 'controller.yaml']),
            description='Parameter file of the controller'),
        DeclareLaunchArgument(
            'trajectory_file', default_value=PathJoinSubstitution([config, 'sinusoid.yaml']),
            description='Parameter file of the trajectory; call /trajectory/start to begin'),
        DeclareLaunchArgument(
            'mode', default_value='realtime', choices=['realtime', 'lockstep'],
            description='Pace of the plant: the wall clock, or one step per command'),
        Node(package=PACKAGE, executable='plant_node', output='screen',
             parameters=[*files, mode]),
        Node(package=PACKAGE, executable='controller_node', output='screen',
             parameters=[*files, mode]),
        Node(package=PACKAGE, executable='trajectory_node', output='screen',
             parameters=[*files, LaunchConfiguration('trajectory_file'), mode]),
    ])
