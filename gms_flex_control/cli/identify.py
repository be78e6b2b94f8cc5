# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex identify`: friction parameters from bags, each with how far to trust it."""

from dataclasses import replace
import os
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.cli import each
from gms_flex_control.cli.output import (
    add_batch_options,
    conclude,
    refuse_fitted,
    refuse_unwritable,
    say,
)
from gms_flex_control.errors import ConfigError


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'identify', help='friction parameters from bags, with intervals and a report',
        description='Fit the friction of a robot to bags of identification_node, of `ros2 bag '
                    'record` or of import-csv. Writes friction.yaml, which plant and controller '
                    'take as it is, report.json, report.html and pictures. Inertia, stiffness '
                    'and gravity of the robot file are relied on unless --estimate all. With '
                    '--each every bag is identified by itself, and each parameter is compared '
                    'over the bags; exit code 1 if a bag could not be identified; a killed run '
                    'goes on when started again with the same --out.')
    parser.add_argument('bags', nargs='+', metavar='BAG',
                        help='bags of one robot, fitted together; with --each of any number')
    parser.add_argument('--each', action='store_true',
                        help='each bag by itself into DIR/NAME OF THE BAG, all side by side in '
                             'DIR/summary.json, summary.csv and spread.csv')
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
    parser.add_argument('--json', action='store_true',
                        help='print report.json, with --each summary.json, instead of text')
    add_batch_options(parser, None, 'of --each: processes of this machine (default: 2)')
    parser.set_defaults(run=run)


def run(args):
    """Identify, write and print; return 0, with --each 1 if a bag could not be identified."""
    from functools import partial
    import json

    from gms_flex_control.identification.output import report_json
    from gms_flex_control.params.units import in_units
    from gms_flex_control.reports.identification import identification_answer
    from gms_flex_control.reports.identification_text import identification_text

    refuse_unwritable(args.out)
    refuse_fitted(args.bags, args.holdout)
    if args.each:
        return run_each(args)
    if args.workers is not None or args.scheduler is not None:
        raise ConfigError('--workers and --scheduler divide many bags; add --each, or leave them '
                          'out: bags identified together are one fit')
    robot, options, out = robot_of(args), options_of(args), Path(args.out)
    found = identified(args.bags, args.holdout, robot, options, args.robot is not None,
                       say=quiet if args.json else say)
    write_results(found, out, args.robot or ())
    if args.json:
        print(json.dumps(report_json(found), indent=2, allow_nan=False))
        return 0
    words = partial(in_units, found.robot.arm)
    print(words(identification_text(found)))
    conclude(identification_answer(found, out, args.robot or ()), {
        'parameters': out / 'friction.yaml', 'report': out / 'report.html',
        'numbers': out / 'report.json'}, words)
    return 0


def identified(bags, holdouts, robot, options, described, **further):
    """Return the Identification of bags fitted together; ``further`` as that of `identify`."""
    from gms_flex_control.identification.identify import identify
    takes, apart = ([read_take(path, robot, not described) for path in paths]
                    for paths in (bags, holdouts))
    found = identify(takes, robot, holdouts=apart, options=options, **further)
    return replace(found, described=described)


def write_results(found, out, robot=()):
    """Write all files of an Identification of a robot file into the folder ``out``."""
    from gms_flex_control.identification.output import write_friction, write_report_json
    from gms_flex_control.reports.identification import write_identification_report
    write_friction(found, out / 'friction.yaml')
    write_report_json(found, out / 'report.json')
    write_identification_report(found, out, robot=robot)


def options_of(args):
    """Return the Options that the arguments ask for."""
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
    from gms_flex_control.identification.unknown_robot import only_joints
    from gms_flex_control.schema.files import load_robot
    if args.robot is None:
        return robot_in(args.bags[0], args.joints)
    robot = load_robot(args.robot)
    return only_joints(robot, args.joints) if args.joints else robot


def robot_in(bag, joints=None):
    """Return rigid axes of unknown inertia, as many as the bag has links or ``joints`` name."""
    from gms_flex_control.bags.names import link_names
    from gms_flex_control.bags.reader import joint_names
    from gms_flex_control.identification.unknown_robot import rigid_joints
    return rigid_joints(joints or link_names(joint_names(bag)))


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


class BagItem(NamedTuple):
    """A bag to be identified, perhaps in another process."""

    place: each.Place
    robot: object     # RobotParams; None: rigid axes named as in the bag
    joints: tuple     # to take from the bag; empty: all
    holdouts: tuple   # of str, absolute paths
    options: object   # identification.identify.Options


def run_each(args):
    """Identify each bag, write, print; return 1 if one could not be identified, else 0."""
    from gms_flex_control.reports.over_bags import identification_text

    items, asked = items_of(args)
    found = each.run_each(args, identify_bag, items, asked)
    each.write_summary(args, found, identification_text)
    return int(any(values['reason'] is not None for values in found.values()))


def items_of(args):
    """Return the items of a batch by key, and what their results depend on beside the bag."""
    from gms_flex_control.batches.journal import content_of, digest_of, fingerprint
    from gms_flex_control.schema.build import robot_values

    options = options_of(args)
    robot = None if args.robot is None else robot_of(args)
    holdouts = tuple(os.path.abspath(path) for path in args.holdout)
    joints = tuple(args.joints or ())
    asked = f'{fingerprint()} ' + digest_of((
        robot and robot_values(robot), joints, options,
        [(path, content_of(path)) for path in holdouts]))
    return {key: BagItem(place, robot, joints, holdouts, options)
            for key, place in each.places_of(args.bags, args.out, asked).items()}, asked


def identify_bag(item):
    """
    Identify one bag and write its results.

    Parameters
    ----------
    item : BagItem
        Which, and where to.

    Returns
    -------
    dict
        `identification.over_bags.bag_values`, and why there are none as ``reason``.

    """
    from gms_flex_control.identification.over_bags import bag_values

    place, described = item.place, item.robot is not None
    robot = item.robot if described else robot_in(place.bag, item.joints)
    found = identified([place.bag], item.holdouts, robot, item.options, described)
    with each.whole(place) as folder:
        write_results(found, folder)
    return {'reason': None, **bag_values(found)}
