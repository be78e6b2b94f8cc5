# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the launch files have in common: their arguments, the three nodes, recorder and RViz."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, GroupAction
from launch.conditions import IfCondition
from launch.substitutions import (
    AndSubstitution,
    Command,
    EqualsSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node, PushRosNamespace, SetParameter
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare

PACKAGE = 'gms_flex_control'
RECORDED = ('joint_states', 'effort_controller/commands', 'reference',
            'cascade_controller/state', 'cascade_controller/blocks',
            'cascade_controller/sticking')
_FRAMES = [('/tf', 'tf'), ('/tf_static', 'tf_static')]  # absolute in tf2, whatever the namespace
_SWITCH = ('true', 'false')


def config(name):
    """Return the path of a file of the package's ``config`` folder, as a substitution."""
    return PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', name])


def arguments(*, bridge='', rviz='false', priority='0'):
    """
    Return the arguments that every launch file takes.

    Parameters
    ----------
    bridge, rviz, priority : str or substitution
        Their defaults, where launch files differ.

    Returns
    -------
    list of DeclareLaunchArgument

    """
    return [
        DeclareLaunchArgument('robot', default_value=config('robot.yaml'),
                              description='Parameter file of the robot'),
        DeclareLaunchArgument('controller', default_value=config('controller.yaml'),
                              description='Parameter file of the controller'),
        DeclareLaunchArgument('trajectory', default_value=config('sinusoid.yaml'),
                              description='Parameter file of the trajectory'),
        DeclareLaunchArgument('bridge', default_value=bridge,
                              description='Parameter file of the bridge to a real robot; empty '
                                          'simulates the robot'),
        DeclareLaunchArgument('mode', default_value='realtime', choices=['realtime', 'lockstep'],
                              description='Pace of the simulation: the wall clock, or one step '
                                          'per command as fast as it goes'),
        DeclareLaunchArgument('composed', default_value='false', choices=_SWITCH,
                              description='Run plant or bridge, controller and trajectory in one '
                                          'process, where no sample waits for DDS'),
        DeclareLaunchArgument('realtime_priority', default_value=priority,
                              description='Of controller, trajectory and simulation, 1 to 99 '
                                          'where it is permitted, 0 for none; a bridge has its '
                                          'own in its file'),
        DeclareLaunchArgument('record', default_value='',
                              description='Bag to be made of the loop; empty records nothing'),
        DeclareLaunchArgument('rviz', default_value=rviz, choices=_SWITCH,
                              description='Show the arm in RViz'),
        DeclareLaunchArgument('state_publisher', default_value=LaunchConfiguration('rviz'),
                              choices=_SWITCH,
                              description='Publish /robot_description and /tf, which RViz and the '
                                          '3D panel of Foxglove draw'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='Namespace of all nodes and topics'),
        DeclareLaunchArgument('use_sim_time', default_value='false', choices=_SWITCH,
                              description='Take the time from /clock, which the simulation '
                                          'publishes with mode:=lockstep')]


def description(declared, actions):
    """
    Return a launch file's description: its arguments, then its actions in their namespace.

    Parameters
    ----------
    declared : list of DeclareLaunchArgument
        See `arguments`.
    actions : list of Action
        See `closed_loop` and `helpers`.

    Returns
    -------
    LaunchDescription

    """
    return LaunchDescription([
        *declared,
        GroupAction([PushRosNamespace(LaunchConfiguration('namespace')),
                     SetParameter('use_sim_time', LaunchConfiguration('use_sim_time')),
                     *actions])])


def node(executable, *parameters, **options):
    """Return one of our nodes with the files of robot and controller, and what is its own."""
    files = [LaunchConfiguration('robot'), LaunchConfiguration('controller')]
    return Node(package=PACKAGE, executable=executable, output='screen',
                parameters=[*files, *parameters], **options)


def closed_loop(controller=None, trajectory=None):
    """
    Return the robot, simulated or bridged, the controller and the trajectory.

    Parameters
    ----------
    controller, trajectory : dict, optional
        Parameters of theirs beyond the files.

    Returns
    -------
    list of Node
        Three processes, or the one of ``loop_node``.

    """
    bridge = LaunchConfiguration('bridge')
    pace = {name: LaunchConfiguration(name) for name in ('mode', 'realtime_priority')}
    simulated, bridged = EqualsSubstitution(bridge, ''), NotEqualsSubstitution(bridge, '')
    composed = LaunchConfiguration('composed')
    apart = EqualsSubstitution(composed, 'false')
    motion = LaunchConfiguration('trajectory')
    own = {**pace, **(controller or {}), **(trajectory or {})}
    return [
        node('plant_node', pace, {'use_sim_time': False},
             condition=IfCondition(AndSubstitution(apart, simulated))),
        node('plant_node', bridge, {'backend': 'bridge'},
             condition=IfCondition(AndSubstitution(apart, bridged))),
        node('controller_node', {**pace, **(controller or {})}, condition=IfCondition(apart)),
        node('trajectory_node', motion, {**pace, **(trajectory or {})},
             condition=IfCondition(apart)),
        node('loop_node', motion, own,
             condition=IfCondition(AndSubstitution(composed, simulated))),
        node('loop_node', motion, own, bridge, {'backend': 'bridge'},
             condition=IfCondition(AndSubstitution(composed, bridged)))]


def helpers():
    """Return recorder, robot_state_publisher and RViz, each only where it is asked for."""
    return [_recorder(), _state_publisher(), _rviz()]


def _recorder():
    bag = LaunchConfiguration('record')
    topics = [[LaunchConfiguration('namespace'), f'/{name}'] for name in RECORDED]
    return ExecuteProcess(
        cmd=[ExecutableInPackage('gms_flex', PACKAGE), 'record', '--topics', *topics,
             '--out', bag],
        output='screen', condition=IfCondition(NotEqualsSubstitution(bag, '')))


def _state_publisher():
    urdf = Command([ExecutableInPackage('gms_flex', PACKAGE), ' urdf --robot "',
                    LaunchConfiguration('robot'), '"'])
    return Node(
        package='robot_state_publisher', executable='robot_state_publisher',
        parameters=[{'robot_description': ParameterValue(urdf, value_type=str),
                     'publish_frequency': 50.0}],  # at least as often as RViz draws [Hz]
        remappings=_FRAMES, condition=IfCondition(LaunchConfiguration('state_publisher')))


def _rviz():
    return Node(
        package='rviz2', executable='rviz2', arguments=['-d', config('arm.rviz')],
        remappings=[*_FRAMES, ('/robot_description', 'robot_description')],
        condition=IfCondition(LaunchConfiguration('rviz')))
