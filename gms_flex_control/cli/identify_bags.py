# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verb `identify`: friction parameters from bags fitted together."""

from dataclasses import replace
from pathlib import Path

from gms_flex_control.cli.terminal import conclude, refuse_repeated, refuse_unwritable, say
from gms_flex_control.data.reader import joint_names, read_experiment
from gms_flex_control.data.recording import link_names, MOTOR_SUFFIX
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import as_json
from gms_flex_control.identification import output
from gms_flex_control.identification.assumed_robot import only_joints, rigid_joints
from gms_flex_control.identification.coordinates import MOST_BLOCKS
from gms_flex_control.identification.identify import identify, Options
from gms_flex_control.reports.answers import identification_answer, identification_text
from gms_flex_control.reports.identification_page import write_identification_report
from gms_flex_control.schema.files import load_robot_to_identify


def identify_verb(args) -> int:
    """Identify, write and print; return 0."""
    refuse_unwritable(args.out)
    refuse_repeated(args.bags, args.holdout)
    options = _options_of(args)
    found, out = _written(args, options, (lambda _: None) if args.json else say), Path(args.out)
    if args.json:
        print(as_json(output.report_json(found)))
        return 0
    words = found.in_units
    print(words(identification_text(found)))
    conclude(identification_answer(found, out, args.robot or ()), {
        'parameters': out / 'friction.yaml', 'report': out / 'report.html',
        'numbers': out / 'report.json'}, words)
    return 0


def _written(args, options, progress):
    """Return the Identification of the bags fitted together, its files written to --out."""
    robot, described = _robot_of(args), args.robot is not None
    recordings, apart = ([read_experiment_of(path, robot, not described) for path in paths]
                         for paths in (args.bags, args.holdout))
    found = replace(identify(recordings, robot, holdouts=apart, options=options, say=progress),
                    described=described)
    out = Path(args.out)
    output.write_friction(found, out / 'friction.yaml')
    output.write_conditions(found, out)
    output.write_report_json(found, out / 'report.json')
    write_identification_report(found, out, robot=args.robot or ())
    return found


def _options_of(args):
    chosen = {'force': args.force, 'estimate': 'all' if args.robot is None else args.estimate}
    if args.blocks:
        wrong = [n for n in args.blocks if not 1 <= n <= MOST_BLOCKS]
        if wrong:
            raise ConfigError(f'--blocks {wrong[0]}: give numbers from 1 to {MOST_BLOCKS}')
        chosen['blocks'] = tuple(sorted(set(args.blocks)))
    return Options(**chosen)


def _robot_of(args):
    """Return the robot of the arguments; without a file, rigid axes named as in the bag."""
    if args.robot is None:
        return rigid_joints(args.joints or link_names(joint_names(args.bags[0])))
    robot = load_robot_to_identify(args.robot)
    return only_joints(robot, args.joints) if args.joints else robot


def read_experiment_of(path, robot, guess_motors: bool = False) -> tuple:
    """Return a bag as (Recording, phases), motors by their names in the bag if to be guessed."""
    return read_experiment(path, robot.joints, None if guess_motors else motors_in(path, robot))


def motors_in(path, robot) -> tuple[str, ...]:
    """
    Return the motor names of the robot that the bag has, '' for the others.

    A rigid joint needs none, but a bag may still give its torque as that of a motor.
    """
    names = joint_names(path)
    wanted = (motor or joint + MOTOR_SUFFIX
              for joint, motor in zip(robot.joints, robot.motors, strict=True))
    return tuple(motor if motor in names else '' for motor in wanted)
