# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verbs on models and bags: `identify` fits friction, `discrepancy` says what is missing."""

from dataclasses import replace
import json
from pathlib import Path
import sys
from textwrap import fill

from gms_flex_control.cli.terminal import conclude, refuse_repeated, refuse_unwritable, say
from gms_flex_control.data.reader import joint_names, read_experiment
from gms_flex_control.data.recording import link_names, MOTOR_SUFFIX
from gms_flex_control.discrepancy.closed_loop import stretch_of, with_closed_loop
from gms_flex_control.discrepancy.compared import as_found, compare
from gms_flex_control.discrepancy.learning import learn
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE
from gms_flex_control.discrepancy.workflow import find_discrepancy
from gms_flex_control.discrepancy.workflow import Options as SearchOptions
from gms_flex_control.effects import registry
from gms_flex_control.errors import BagError, ConfigError
from gms_flex_control.file_io import as_json, write_json
from gms_flex_control.identification import output
from gms_flex_control.identification.assumed_robot import only_joints, rigid_joints
from gms_flex_control.identification.coordinates import MOST_BLOCKS
from gms_flex_control.identification.identify import identify, Options
from gms_flex_control.reports import discrepancy_values as files
from gms_flex_control.reports.answers import (
    discrepancy_answer,
    identification_answer,
    identification_text,
)
from gms_flex_control.reports.discrepancy_page import units_of, write_discrepancy_report
from gms_flex_control.reports.identification_page import write_identification_report
from gms_flex_control.schema.files import load_controller, load_robot, load_robot_to_identify
import numpy as np

_WIDTH = 96


def identify_bags(args) -> int:
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


def find_missing(args) -> int:
    """Compare, write and print; return the exit code of the verdict."""
    _refuse_out(Path(args.out), args)
    refuse_repeated(args.bags, args.holdout)
    _search_options(args)
    result, compared, holdout = _answered(args)
    values = _write_files(result, compared, holdout, args)
    return _printed(result, compared, values, args)


def _answered(args):
    """Return the Discrepancy of --robot with bags, Compared models, recordings held out."""
    options, robot = _search_options(args), load_robot(args.robot)
    others = _models_of(args, robot)
    recordings, holdout = ([read_experiment_of(path, robot)[0] for path in paths]
                           for paths in (args.bags, args.holdout))
    result = _looped(args, robot, holdout or recordings,
                     lambda: _searched(recordings, robot, options, holdout, args))
    compared = ()
    if others and result.behind is not None:
        compared = compare(result, [('as given', robot), ('with what was found', as_found(result)),
                                    *others], holdout)
    return result, compared, holdout


def _searched(recordings, robot, options, holdout, args):
    """Return the Discrepancy; raise BagError where forced data leave no number to go on with."""
    try:
        found = find_discrepancy(recordings, robot, options, holdout=holdout, say=_progress(args))
        return learn(found, holdout=holdout, say=_progress(args)) if args.learn else found
    except (np.linalg.LinAlgError, ValueError) as error:
        if not args.force:
            raise
        raise BagError(f'{", ".join(args.bags)}: no model can be fitted to these data ({error}); '
                       'without --force their faults are listed; correct those first') from error


def _looped(args, robot, recordings, search):
    """Return what ``search`` finds, with the closed loop of --controller; refuse before it."""
    if not args.controller:
        return search()
    gains = load_controller(args.controller, robot)
    for recording in recordings:
        stretch_of(recording)
    return with_closed_loop(search(), recordings, gains)


def _write_files(result, compared, holdout, args):
    out = Path(args.out)
    values = files.report_values(result, holdout=args.holdout, models=compared)
    earlier = _earlier(out)
    written = write_discrepancy_report(result, out, holdout=holdout, models=compared)
    if result.robot is not None:
        files.write_robot(result, out / 'robot.yaml')
        written.append(out / 'robot.yaml')
    for path in set(earlier) - set(written):  # no longer true
        path.unlink()
    write_json(out / 'report.json', values)  # at last
    return values


def _earlier(out):
    """Return the files in ``out`` that an earlier run of this verb has made."""
    try:
        earlier = json.loads((out / 'report.json').read_text())
    except (OSError, ValueError):
        return []
    if not isinstance(earlier, dict) or 'verdict' not in earlier:  # of another verb
        return []
    return [path for pattern in ('robot.yaml', 'gap.png', 'evidence_*.png', 'map_*.png')
            for path in out.glob(pattern)]


def _printed(result, compared, values, args):
    out, bad, words = Path(args.out), result.verdict == BAD_DATA, units_of(result)
    if args.json:
        print(as_json(values))
    elif bad:
        print(fill(f'gms_flex discrepancy: {result.words}', _WIDTH, break_on_hyphens=False),
              file=sys.stderr)
    elif result.details:
        print(fill(words(result.details), _WIDTH, break_on_hyphens=False))
    if not args.json and not bad:
        if compared:
            print(words(f'\n{files.comparison_text(compared, result.gap.joints)}'))
        conclude(discrepancy_answer(result, out), {
            'model': out / 'robot.yaml', 'report': out / 'report.html',
            'numbers': out / 'report.json'}, words)
    return 2 if bad else int(result.verdict != COMPLETE)


def _search_options(args):
    chosen = {'force': args.force, 'doubt': args.doubt, 'without': tuple(args.without)}
    for name in args.without:
        registry.find(name)
    if args.max_effects is not None:
        chosen['most'] = args.max_effects
    return SearchOptions(**chosen)


def _refuse_out(out, args):
    refuse_unwritable(out)
    target = (out / 'robot.yaml').resolve()
    for file in (*args.robot, *args.models):
        if Path(file).resolve() == target:
            raise ConfigError(f'{file} would be overwritten by the model that is found; name '
                              'another folder as --out')


def _models_of(args, robot):
    models = []
    for file in args.models:
        model = load_robot(file)
        if model.joints != robot.joints or tuple(model.arm.rigid) != tuple(robot.arm.rigid):
            raise ConfigError(f'{file}: its joints {", ".join(model.joints)}, flexible or rigid, '
                              f'are not those of --robot ({", ".join(robot.joints)})')
        models.append((str(file), model))
    return models


def _progress(args):
    """Return the function that prints progress: on a terminal only, and beside the results."""
    return (lambda text: None) if args.json else lambda text: say(f'  {text} ...')
