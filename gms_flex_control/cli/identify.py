# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex identify`: friction parameters from bags, each with how far to trust it."""

from dataclasses import replace
from pathlib import Path

from gms_flex_control.cli.output import refuse_unwritable, say


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'identify', help='friction parameters from bags, with intervals and a report',
        description='Fit the friction of a robot to bags of identification_node, of `ros2 bag '
                    'record` or of import-csv. Writes friction.yaml, which plant and controller '
                    'take as it is, report.json, report.html and pictures. Inertia, stiffness '
                    'and gravity of the robot file are relied on unless --estimate all.')
    parser.add_argument('bags', nargs='+', metavar='BAG', help='bags of one robot at one rate')
    parser.add_argument('--robot', metavar='FILE', nargs='+',
                        help='robot parameters, later files winning; by default each joint of '
                             'the bag is a rigid axis of its own and all is estimated')
    parser.add_argument('--out', required=True, metavar='DIR', help='folder for the results')
    parser.add_argument('--holdout', nargs='+', default=[], metavar='BAG',
                        help='bags that are only predicted; default: every fourth block of 2 s')
    parser.add_argument('--method', choices=('default', 'paper'), default='default',
                        help='default: all parameters together; paper: its section 4')
    parser.add_argument('--estimate', choices=('friction', 'all'), default='friction',
                        help='all: inertia, gravity, stiffness, motor inertia as well')
    parser.add_argument('--blocks', type=int, nargs='+', metavar='N',
                        help='numbers of Maxwell blocks to choose from')
    parser.add_argument('--joints', nargs='+', metavar='NAME',
                        help='joints to take from the bags; default: all of the robot')
    parser.add_argument('--force', action='store_true',
                        help='go on in spite of faults in the data')
    parser.add_argument('--json', action='store_true', help='print report.json instead of text')
    parser.set_defaults(run=run)


def run(args):
    """Identify, write and print; return 0."""
    import json

    from gms_flex_control.identification.identify import identify
    from gms_flex_control.identification.output import (
        report_json,
        write_friction,
        write_report_json,
    )
    from gms_flex_control.reports.identification import write_identification_report
    from gms_flex_control.reports.identification_text import identification_text

    refuse_unwritable(args.out)
    robot = robot_of(args)
    takes, holdouts = ([read_take(path, robot, args.robot is None) for path in paths]
                       for paths in (args.bags, args.holdout))
    found = identify(takes, robot, holdouts=holdouts, options=options_of(args),
                     say=quiet if args.json else say)
    found = replace(found, described=args.robot is not None)
    out = Path(args.out)
    write_friction(found, out / 'friction.yaml')
    write_report_json(found, out / 'report.json')
    write_identification_report(found, out)
    if args.json:
        print(json.dumps(report_json(found), indent=2, allow_nan=False))
        return 0
    print(f'{identification_text(found)}\n\nparameters {out / "friction.yaml"}\n'
          f'report     {out / "report.html"}\nnumbers    {out / "report.json"}')
    return 0


def options_of(args):
    """Return the Options that the arguments ask for."""
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.identification.coordinates import MOST_BLOCKS
    from gms_flex_control.identification.identify import Options
    chosen = {'method': args.method, 'force': args.force,
              'estimate': 'all' if args.robot is None else args.estimate}
    if args.blocks:
        wrong = [n for n in args.blocks if not 1 <= n <= MOST_BLOCKS]
        if wrong:
            raise ConfigError(f'--blocks {wrong[0]}: give numbers from 1 to {MOST_BLOCKS}')
        chosen['blocks'] = tuple(sorted(set(args.blocks)))
    return Options(**chosen)


def robot_of(args):
    """Return the robot of the arguments; without a file, rigid axes named as in the bag."""
    from gms_flex_control.bags.names import link_names
    from gms_flex_control.bags.reader import joint_names
    from gms_flex_control.identification.unknown_robot import only_joints, rigid_joints
    from gms_flex_control.schema.files import load_robot
    if args.robot is None:
        return rigid_joints(args.joints or link_names(joint_names(args.bags[0])))
    robot = load_robot(args.robot)
    return only_joints(robot, args.joints) if args.joints else robot


def read_take(path, robot, guess_motors=False):
    """Return a bag as (Recording, phases), motors by their names in the bag if to be guessed."""
    from gms_flex_control.bags.phases import read_experiment
    return read_experiment(path, robot.joints, None if guess_motors else motors_in(path, robot))


def motors_in(path, robot):
    """
    Return the motor names of the robot that the bag has, '' for the others.

    A rigid joint needs none, but a bag may still give its torque as that of a motor.
    """
    from gms_flex_control.bags.names import MOTOR_SUFFIX
    from gms_flex_control.bags.reader import joint_names
    names = joint_names(path)
    wanted = (motor or joint + MOTOR_SUFFIX
              for joint, motor in zip(robot.joints, robot.motors, strict=True))
    return tuple(motor if motor in names else '' for motor in wanted)


def quiet(_text):
    """Print nothing."""
