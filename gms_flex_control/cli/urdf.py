# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Write the robot as URDF."""

from gms_flex_control.cli.output import write_or_print


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'urdf', help='the robot as URDF, for RViz, robot_state_publisher and simulators',
        description='Describe links, motors and inertias of a robot file as URDF. Springs, which '
                    'URDF cannot express, become comments; friction is written as far as URDF '
                    'has it.')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning; default: the arm of the paper')
    parser.add_argument('--out', metavar='FILE', help='default: print it')
    parser.add_argument('--name', default='arm', help='of the robot (default: %(default)s)')
    parser.add_argument('--links-only', action='store_true',
                        help='leave out the motors: a rigid robot')
    parser.add_argument('--limits', nargs='+', metavar='FILE',
                        help='files with limits.<joint>, such as config/bridge.yaml')
    parser.add_argument('--ros2-control', metavar='PLUGIN', default='',
                        help='add a <ros2_control> block with this hardware interface, such as '
                             'mock_components/GenericSystem')
    parser.set_defaults(run=run)


def run(args):
    """Write or print; return 0."""
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.resources import robot_file
    from gms_flex_control.schema.files import load_limits, load_robot
    from gms_flex_control.schema.urdf import robot_urdf

    robot = load_robot(args.robot or robot_file())
    if robot.arm.frames and (args.limits or args.ros2_control):
        raise ConfigError(f'the URDF of this robot is {robot.arm.frames.source}: limits and '
                          '<ros2_control> belong into that file')
    limits = load_limits(args.limits, robot.joints) if args.limits else None
    text = robot_urdf(robot, name=args.name, motors=not args.links_only, limits=limits,
                      plugin=args.ros2_control)
    write_or_print(text, args.out, f'{robot.n_joints} joints')
    return 0
