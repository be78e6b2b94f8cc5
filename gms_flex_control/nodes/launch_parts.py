# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What the launch files have in common: their arguments, the three nodes, recorder and RViz."""

from ament_index_python.packages import get_package_prefix, PackageNotFoundError
from gms_flex_control.nodes.process import LAUNCHED
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    OpaqueFunction,
    Shutdown,
)
from launch.conditions import IfCondition
from launch.logging import get_logger
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
_ENVIRONMENT = {LAUNCHED: 'true'}
# a Ctrl-C waits until the process has its handlers; till then Python would print a traceback
_PREFIX = ['env --block-signal=INT ', LaunchConfiguration('launch-prefix', default='')]


def config(name) -> PathJoinSubstitution:
    """Return the path of a file of the package's ``config`` folder, as a substitution."""
    return PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', name])


def arguments(*, bridge='', controller='controller.yaml', rviz='false', priority='0') -> list:
    """Return the arguments of every launch file; their defaults, where files differ, are given."""
    switch = {'choices': ['true', 'false']}
    return [DeclareLaunchArgument(name, default_value=default, description=words, **options)
            for name, default, options, words in (
                ('robot', config('robot.yaml'), {}, 'Parameter file of the robot'),
                ('controller', config(controller), {}, 'Parameter file of the controller'),
                ('trajectory', config('sinusoid.yaml'), {}, 'Parameter file of the trajectory'),
                ('bridge', bridge, {}, 'Parameter file of the bridge to a real robot; empty '
                 'simulates the robot'),
                ('mode', 'realtime', {'choices': ['realtime', 'lockstep']}, 'Pace of the '
                 'simulation: the wall clock, or one step per command as fast as it goes'),
                ('composed', 'false', switch, 'Run plant or bridge, controller and trajectory in '
                 'one process, where no sample waits for DDS'),
                ('realtime_priority', priority, {}, 'Of controller, trajectory and simulation, 1 '
                 'to 99 where it is permitted, 0 for none; a bridge has its own in its file'),
                ('record', '', {}, 'Bag to be made of the loop; empty records nothing'),
                ('rviz', rviz, switch, 'Show the arm in RViz'),
                ('state_publisher', LaunchConfiguration('rviz'), switch, 'Publish '
                 '/robot_description and /tf, which RViz and the 3D panel of Foxglove draw'),
                ('namespace', '', {}, 'Namespace of all nodes and topics'),
                ('use_sim_time', 'false', switch, 'Take the time from /clock, which the '
                 'simulation publishes with mode:=lockstep'))]


def description(declared, actions) -> LaunchDescription:
    """Return a LaunchDescription: what was declared, then ``actions`` in their namespace."""
    return LaunchDescription([
        *declared,
        GroupAction([PushRosNamespace(LaunchConfiguration('namespace')),
                     SetParameter('use_sim_time', LaunchConfiguration('use_sim_time')),
                     _state_publisher(), _rviz(), _recorder(), *actions])])


def node(executable, *parameters, **options) -> Node:
    """Return one of our nodes with the files of robot and controller, and what is its own."""
    files = [LaunchConfiguration('robot'), LaunchConfiguration('controller')]
    return Node(package=PACKAGE, executable=executable, exec_name=executable, output='screen',
                parameters=[*files, *parameters], additional_env=_ENVIRONMENT, prefix=_PREFIX,
                **options)


def closed_loop(controller=None, trajectory=None) -> list:
    """
    Return the robot, simulated or bridged, the controller and the trajectory, or loop_node.

    The launch ends with any of them: the others leave zero torque, and where it was no end in
    order the exit code is 1. ``controller`` and
    ``trajectory`` are parameters (dict) of theirs beyond the files.
    """
    bridge = LaunchConfiguration('bridge')
    pace = {name: LaunchConfiguration(name) for name in ('mode', 'realtime_priority')}
    simulated, bridged = EqualsSubstitution(bridge, ''), NotEqualsSubstitution(bridge, '')
    composed = LaunchConfiguration('composed')
    apart = EqualsSubstitution(composed, 'false')
    motion = LaunchConfiguration('trajectory')
    own = {**pace, **(controller or {}), **(trajectory or {})}
    return [
        _required('plant_node', pace, {'use_sim_time': False},
                  condition=IfCondition(AndSubstitution(apart, simulated))),
        _required('plant_node', bridge, {'backend': 'bridge'},
                  condition=IfCondition(AndSubstitution(apart, bridged))),
        _required('controller_node', {**pace, **(controller or {})},
                  condition=IfCondition(apart)),
        _required('trajectory_node', motion, {**pace, **(trajectory or {})},
                  condition=IfCondition(apart)),
        _required('loop_node', motion, own,
                  condition=IfCondition(AndSubstitution(composed, simulated))),
        _required('loop_node', motion, own, bridge, {'backend': 'bridge'},
                  condition=IfCondition(AndSubstitution(composed, bridged)))]


def _required(executable, *parameters, condition=None):
    return node(executable, *parameters, condition=condition, on_exit=_end)


def _end(event, context):
    """End the launch with a node; where that failed, so does the launch, with exit code 1."""
    if context.is_shutdown:  # too slow an end is killed
        return None
    if event.returncode:
        # of an exception alone launch makes an exit code; the other nodes end as they always do
        raise RuntimeError(f'{event.process_name} ended with exit code {event.returncode}')
    return Shutdown()


def _recorder():
    bag = LaunchConfiguration('record')
    space = LaunchConfiguration('ros_namespace', default='')  # what all files around it pushed
    topics = [[space, f'/{name}'] for name in RECORDED]
    return ExecuteProcess(
        cmd=[ExecutableInPackage('gms_flex', PACKAGE), 'record', '--topics', *topics,
             '--out', bag],
        name='gms_flex', output='screen', additional_env=_ENVIRONMENT, prefix=_PREFIX,
        condition=IfCondition(NotEqualsSubstitution(bag, '')))


def _where_installed(helper, package):
    """Return a node of a package that nobody needs to have, or a warning in its place."""
    try:
        get_package_prefix(package)
        return helper
    except (PackageNotFoundError, OSError):  # the latter: there is no ROS environment
        sentence = (f'{package} is not installed, the launch goes on without: '
                    f'sudo apt install ros-jazzy-{package.replace("_", "-")}')
        return OpaqueFunction(function=lambda _: get_logger('launch').warning(sentence),
                              condition=helper.condition)


def _state_publisher():
    urdf = Command([ExecutableInPackage('gms_flex', PACKAGE), ' urdf --robot "',
                    LaunchConfiguration('robot'), '"'])
    publisher = Node(
        package='robot_state_publisher', executable='robot_state_publisher',
        parameters=[{'robot_description': ParameterValue(urdf, value_type=str),
                     'publish_frequency': 50.0}],  # at least as often as RViz draws [Hz]
        remappings=_FRAMES, condition=IfCondition(LaunchConfiguration('state_publisher')))
    return _where_installed(publisher, 'robot_state_publisher')


def _rviz():
    rviz = Node(
        package='rviz2', executable='rviz2', arguments=['-d', config('arm.rviz')],
        remappings=[*_FRAMES, ('/robot_description', 'robot_description')],
        condition=IfCondition(LaunchConfiguration('rviz')))
    return _where_installed(rviz, 'rviz2')
