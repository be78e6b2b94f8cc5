# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verb `compare`: friction compensations side by side, on a plant or along a bag."""

from functools import partial
from pathlib import Path

from gms_flex_control.batches import run_batch
from gms_flex_control.cli.identify_bags import motors_in
from gms_flex_control.cli.robots import controller_of
from gms_flex_control.cli.terminal import conclude, refuse_unwritable
from gms_flex_control.cli.verbs import OF_A_BAG, OF_A_PLANT
from gms_flex_control.comparison import prediction, study
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import as_json, robot_file, write_json
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports import comparison_page
from gms_flex_control.results import prediction_values
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np


def compare_verb(args) -> int:
    """Compare, write and print; return 0."""
    files = _plant_files(args)
    _settle(args, files is not None)
    refuse_unwritable(args.out)
    shown, values, page, answer, units = _along_bag(args) if files is None else _on_plant(
        args, files)
    write_json(Path(args.out) / 'comparison.json', values)
    page.write(Path(args.out) / 'report.html')
    print(as_json(values) if args.json else units(shown))
    if not args.json:
        conclude(answer, {'report': Path(args.out) / 'report.html',
                          'numbers': Path(args.out) / 'comparison.json'}, units)
    return 0


def _plant_files(args):
    """Return the robot files of the plant, [] for the arm of the paper; None for a bag."""
    is_file = [Path(source).suffix in ('.yaml', '.yml') for source in args.source]
    if all(is_file):
        if args.source and args.robot:
            raise ConfigError(f'--robot {args.robot[0]}: the plant is {args.source[0]} already; '
                              'give all its files in one place')
        return args.source or args.robot or []
    if len(args.source) > 1:
        raise ConfigError(f'{args.source[1]}: give one bag, and robot files behind --robot'
                          if any(is_file) else f'{args.source[1]}: give one bag at a time')
    return None


def _settle(args, is_plant):
    """Fill in what was not given; raise ConfigError for what is not used."""
    foreign, where = (OF_A_BAG, 'bag') if is_plant else (OF_A_PLANT, 'plant')
    for name in foreign:
        value = getattr(args, name)
        if value is not None:
            raise ConfigError(f'--{name} {value:g}: applies to a {where}, and none is compared '
                              'here; leave it out')
    for name, value in (OF_A_PLANT | OF_A_BAG).items():
        if getattr(args, name) is None:
            setattr(args, name, value)


def _on_plant(args, files):
    """Return table, plain values, page, Answer and units of the comparison in simulation."""
    robot = load_robot(files or robot_file())
    gains = load_controller(controller_of(args, robot.joints), robot)
    setting = study.Setting(robot, gains, np.full(robot.n_joints, args.amplitude), args.rate,
                            args.draws, args.seed)
    outcomes = run_batch(study.try_cell, study.cells(setting), args.workers, 'cells')
    rows = study.table(outcomes, setting)
    values = {'rate': args.rate, 'amplitude': args.amplitude, 'draws': args.draws,
              'seed': args.seed, 'rows': [row._asdict() for row in rows], 'cells': outcomes}
    return (comparison_page.plant_text(rows), values,
            comparison_page.plant_page(rows, outcomes, setting, files),
            comparison_page.plant_answer(rows, outcomes, files), partial(in_units, robot.arm))


def _along_bag(args):
    """Return table, plain values, page, Answer and units of the comparison along a bag."""
    bag, = args.source
    robot = load_robot(args.robot or robot_file())
    gains = load_controller(controller_of(args, robot.joints), robot)
    motors = motors_in(bag, robot)
    found = prediction.read_along(bag, motors, robot)
    prediction.split(found.pieces, args.fit)  # says now what is too short
    items = {mode: prediction.FitItem(bag, motors, robot, gains, args.fit, mode)
             for mode in prediction.modes_to_fit(found.has_reference)}
    fits = run_batch(prediction.fit_item, items, args.workers, 'fits')
    predictions = prediction.compare_along(found, gains, args.fit, fits)
    values = {'bag': bag, 'fit': args.fit, 'rows': prediction_values(predictions)}
    return (comparison_page.bag_text(predictions, found, robot.joints), values,
            comparison_page.bag_page(predictions, found, robot, bag, args.fit,
                                     args.robot or ()),
            comparison_page.bag_answer(predictions, robot.joints, bag, args.robot or ()),
            partial(in_units, robot.arm))
