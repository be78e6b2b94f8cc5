# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex export`: the identified robot for other programs."""

from gms_flex_control.cli.output import write_or_print

TARGETS = ('mujoco', 'urdf', 'ros2_control', 'csv')


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'export', help='the identified robot for MuJoCo, URDF, ros2_control, or as a table',
        description='Write a robot with its friction and effects for another program. What that '
                    'program cannot express is refused by name; --without exports the robot '
                    'without it. mujoco: MJCF with springs, friction blocks, limits and delay of '
                    'the actuators. urdf: a rigid robot with <dynamics>. ros2_control: viscous '
                    'and Coulomb friction of each joint as ROS parameters. csv: every parameter '
                    'with its unit.')
    parser.add_argument('--to', required=True, choices=TARGETS, help=', '.join(TARGETS),
                        metavar='TARGET')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning, such as robot.yaml friction.yaml; '
                             'default: the arm of the paper')
    parser.add_argument('--without', nargs='+', default=[], metavar='NAME',
                        help='parts of the model or effects to leave out')
    parser.add_argument('--timestep', type=float, metavar='S',
                        help='integration step of MuJoCo [s]')
    parser.add_argument('--out', metavar='FILE', help='default: print it')
    parser.set_defaults(run=run)


def run(args):
    """Write or print; return 0."""
    from gms_flex_control.resources import robot_file
    from gms_flex_control.schema.files import load_robot

    robot = load_robot(args.robot or robot_file())
    text = _text_of(robot, args)
    write_or_print(text, args.out, f'{robot.n_joints} joints')
    return 0


def _text_of(robot, args):
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.exports import friction, mujoco, target

    if args.timestep is not None and (args.to != 'mujoco' or not 0.0 < args.timestep < 1.0):
        raise ConfigError(f'--timestep {args.timestep:g} --to {args.to}: give an integration step '
                          'above 0 s and below 1 s, to mujoco only')
    if args.to == 'mujoco' and robot.arm.frames:
        raise ConfigError(f'--to mujoco: MuJoCo reads {robot.arm.frames.source} itself; of '
                          'arm.kind urdf friction alone is exported, --to urdf, ros2_control or '
                          'csv')
    if args.to == 'csv':
        if args.without:
            raise ConfigError('--without: csv holds every parameter; leave the option out')
        return friction.table(robot)
    step = {} if args.timestep is None else {'timestep': args.timestep}
    chosen = {'mujoco': mujoco.target(**step), 'urdf': friction.URDF,
              'ros2_control': friction.ROS2_CONTROL}
    return target.export(robot, chosen[args.to], args.without)
