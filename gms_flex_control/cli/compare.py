# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex compare`: friction compensations side by side, on a plant or along a bag."""

from functools import partial
from pathlib import Path

from gms_flex_control.cli.output import add_batch_options, conclude, refuse_unwritable

# options of one way to compare alone, and their values where none was given
OF_A_PLANT = {'draws': 50, 'rate': 500.0, 'amplitude': 1.0, 'seed': 0}
OF_A_BAG = {'fit': 0.5}


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'compare', help='friction compensations side by side',
        description='Compare eight ways to compensate friction: none, static Stribeck, LuGre, '
                    'four kinds of GMS (of the paper, improved, of the desired motion, adaptive) '
                    'and a disturbance observer. On a plant (a robot file) each drives it in '
                    'simulation, also with friction, K and M that differ from the belief, with '
                    'coarse and fine encoders, and at other rates. Along a bag they predict the '
                    'friction torque, fitted to its first part and judged on the rest. A killed '
                    'run goes on when started again with the same --out.')
    parser.add_argument('source', nargs='*', metavar='BAG|PLANT',
                        help='a bag, or robot files, later ones winning; default: --robot')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning: of a bag, or the plant if none is '
                             'named before; default: the arm of the paper')
    parser.add_argument('--controller', nargs='+', metavar='FILE',
                        help='gains, such as of gms_flex tune; default: those of the paper')
    parser.add_argument('--draws', type=int, metavar='N',
                        help='of a plant: robots with all parameters off at once '
                             f'(default: {OF_A_PLANT["draws"]})')
    parser.add_argument('--rate', type=float, metavar='HZ',
                        help='of a plant: that of the controller '
                             f'(default: {OF_A_PLANT["rate"]:g})')
    parser.add_argument('--amplitude', type=float, metavar='RAD',
                        help=f'of a plant: of the motions (default: {OF_A_PLANT["amplitude"]:g})')
    parser.add_argument('--seed', type=int, metavar='N', help='of a plant: of the draws')
    parser.add_argument('--fit', type=float, metavar='SHARE',
                        help='of a bag: its first part, that is fitted '
                             f'(default: {OF_A_BAG["fit"]:g})')
    add_batch_options(parser)
    parser.add_argument('--out', default='comparison', metavar='DIR',
                        help='report.html, comparison.json, journal (default: %(default)s)')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    parser.set_defaults(run=run)


def run(args):
    """Compare, write and print; return 0."""
    import json

    from gms_flex_control.files import write_text

    files = plant_files(args)
    settle(args, files is not None)
    refuse_unwritable(args.out)
    shown, values, page, answer, units = along_bag(args) if files is None else on_plant(
        args, files)
    write_text(Path(args.out) / 'comparison.json',
               json.dumps(values, indent=2, allow_nan=False) + '\n')
    page.write(Path(args.out) / 'report.html')
    print(json.dumps(values, indent=2) if args.json else units(shown))
    if not args.json:
        conclude(answer, {'report': Path(args.out) / 'report.html',
                          'numbers': Path(args.out) / 'comparison.json'}, units)
    return 0


def plant_files(args):
    """Return the robot files of the plant, [] for the arm of the paper; None for a bag."""
    from gms_flex_control.errors import ConfigError

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


def settle(args, is_plant):
    """Fill in what was not given; raise ConfigError for what is out of range or not used."""
    from gms_flex_control.errors import ConfigError

    foreign, where = (OF_A_BAG, 'bag') if is_plant else (OF_A_PLANT, 'plant')
    for name in foreign:
        value = getattr(args, name)
        if value is not None:
            raise ConfigError(f'--{name} {value:g}: applies to a {where}, and none is compared '
                              'here; leave it out')
    for name, value in (OF_A_PLANT | OF_A_BAG).items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    for name, value, most in (('rate', args.rate, 1e4), ('amplitude', args.amplitude, 100.0)):
        if not 0.0 < value <= most:
            raise ConfigError(f'--{name} {value:g}: must be above 0 and at most {most:g}')
    if not 0.05 <= args.fit <= 0.95:
        raise ConfigError(f'--fit {args.fit:g}: must be from 0.05 to 0.95')
    for name, value in (('draws', args.draws), ('seed', args.seed)):
        if value < 0:
            raise ConfigError(f'--{name} {value}: must be at least 0')


def on_plant(args, files):
    """Return table, plain values, page, Answer and units of the comparison in simulation."""
    from gms_flex_control.comparison import study, words
    from gms_flex_control.params.units import in_units
    from gms_flex_control.reports.comparison import plant_page
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot
    import numpy as np

    robot = load_robot(files or robot_file())
    gains = load_controller(args.controller or controller_file(), robot)
    setting = study.Setting(robot, gains, np.full(robot.n_joints, args.amplitude), args.rate,
                            args.draws, args.seed)
    outcomes = finished(args, study.try_cell, study.cells(setting), robot, gains,
                        (args.amplitude, args.rate, args.seed), 'cells')
    rows = study.table(outcomes, setting)
    values = {'rate': args.rate, 'amplitude': args.amplitude, 'draws': args.draws,
              'seed': args.seed, 'rows': [row._asdict() for row in rows], 'cells': outcomes}
    return (words.text(rows), values, plant_page(rows, outcomes, setting, files),
            words.plant_answer(rows, outcomes, files), partial(in_units, robot.arm))


def along_bag(args):
    """Return table, plain values, page, Answer and units of the comparison along a bag."""
    from gms_flex_control.batches.journal import content_of
    from gms_flex_control.cli.identify import motors_in
    from gms_flex_control.comparison import held_out, words
    from gms_flex_control.params.units import in_units
    from gms_flex_control.reports.comparison import bag_page
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot

    bag, = args.source
    robot = load_robot(args.robot or robot_file())
    gains = load_controller(args.controller or controller_file(), robot)
    motors = motors_in(bag, robot)
    found = held_out.read_along(bag, motors, robot)
    held_out.split(found.pieces, args.fit)  # says now what is too short
    items = {mode: held_out.FitItem(bag, motors, robot, gains, args.fit, mode)
             for mode in held_out.modes_to_fit(found.has_reference)}
    fits = finished(args, held_out.fit_item, items, robot, gains,
                    (content_of(bag), args.fit), 'fits')
    predictions = held_out.compare_along(found, gains, args.fit, fits)
    values = {'bag': bag, 'fit': args.fit, 'rows': [
        {name: getattr(one, name) for name in ('mode', 'name', 'error', 'fitted', 'remark')}
        for one in predictions]}
    return (words.bag_text(predictions, found, robot.joints), values,
            bag_page(predictions, found, robot, bag, args.fit, args.robot or ()),
            words.bag_answer(predictions, robot.joints, bag, args.robot or ()),
            partial(in_units, robot.arm))


def finished(args, function, items, robot, gains, asked, label):
    """Return what a batch found; what the journal in --out has of the same is not done again."""
    from gms_flex_control.batches.batch import run_batch
    from gms_flex_control.batches.executor import open_executor
    from gms_flex_control.batches.journal import digest_of, fingerprint, Journal
    from gms_flex_control.schema.build import robot_values
    from gms_flex_control.tuning.words import controller_values

    digest = digest_of((robot_values(robot), controller_values(gains, robot.joints), asked))
    journal = Journal(args.out, f'{fingerprint(SOURCES)} {digest}')
    with open_executor(args.workers, args.scheduler) as executor:
        return run_batch(function, items, executor=executor, journal=journal, label=label)


# what a figure depends on
SOURCES = ('params', 'friction', 'effects', 'dynamics', 'trajectory', 'control', 'simulation',
           'bags', 'identification', 'tuning', 'comparison/contestants.py',
           'comparison/study.py', 'comparison/along.py', 'comparison/held_out.py')
