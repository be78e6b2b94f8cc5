# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex simulate`: the nodes' experiment in this process, from the same files."""

from itertools import product
import json
from pathlib import Path

from gms_flex_control.answer import command
from gms_flex_control.errors import ConfigError
from gms_flex_control.params.gains import COMPENSATIONS


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'simulate', help='the closed loop without ROS, as a bag',
        description='Simulate plant, controller and reference in this process from the '
                    'parameter files of the nodes and write the same bag they would. Several '
                    'trajectories or compensations make one bag each, in the folder --out, '
                    'named <trajectory>_<compensation>.')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning, such as robot.yaml friction.yaml; '
                             'default: the arm of the paper')
    parser.add_argument('--model', nargs='+', metavar='FILE',
                        help='robot files the controller believes in; default: --robot')
    parser.add_argument('--controller', metavar='FILE', help='default: the gains of the paper')
    parser.add_argument('--trajectory', nargs='+', default=['sinusoid'], metavar='FILE',
                        help='file with trajectory parameters, or the name of one of config/')
    modes = parser.add_argument('--compensation', nargs='+', metavar='MODE',
                                help=f'any of {", ".join(COMPENSATIONS)}; default: that of the '
                                     'controller file')
    modes.completer = lambda **_: COMPENSATIONS  # for argcomplete, which else offers files
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE', dest='overrides',
                        help='single parameters, such as gains.joint1.kd_link=1.0')
    parser.add_argument('--duration', type=float, metavar='S',
                        help='default: until the trajectory ends, 20 s if it has no end')
    parser.add_argument('--out', required=True, metavar='DIR', help='the bag, or their folder')
    parser.add_argument('--json', action='store_true', help='print the results as JSON')
    parser.set_defaults(run=run)


def run(args):
    """Simulate, write the bags and print the tracking errors; return 0."""
    from gms_flex_control.experiment.plan import read_plan
    from gms_flex_control.experiment.simulated import simulate_to_bag
    from gms_flex_control.params.units import in_units
    from gms_flex_control.resources import controller_file, robot_file
    import numpy as np

    overrides = dict(parse_override(text) for text in args.overrides)
    modes = args.compensation or [None]
    several = len(args.trajectory) * len(modes) > 1
    results = []
    for motion, mode in product(args.trajectory, modes):
        files = [*(args.robot or [robot_file()]), args.controller or controller_file(),
                 trajectory_file(motion)]
        chosen = overrides | ({'compensation': mode} if mode else {})
        plan = read_plan(files, model=args.model, overrides=chosen, duration=args.duration)
        name = f'{Path(motion).stem}_{plan.gains.compensation}'
        bag = Path(args.out) / name if several else Path(args.out)
        outcome = simulate_to_bag(plan, bag)
        error = outcome.q_link - outcome.reference[:, 0]
        results.append({'bag': str(bag), 'trajectory': plan.motion,
                        'compensation': plan.gains.compensation, 'duration': plan.duration,
                        'mse': np.mean(error ** 2, axis=0).tolist()})
        if not args.json:
            shown = '  '.join(f'{value:.3g}' for value in results[-1]['mse'])
            square = in_units(plan.robot.arm, 'rad^2')
            print(f'{bag}: {plan.motion}, {plan.gains.compensation}, {plan.duration:g} s, '
                  f'MSE per link [{square}]  {shown}')
    if args.json:
        print(json.dumps(results, indent=2))
        return 0
    bags = [one['bag'] for one in results]
    again = ('analyse', *bags, '--out', Path(args.out) / 'results') if several else ('view', *bags)
    print(f'\nnext: {command(*again)}')
    return 0


def parse_override(text):
    """
    Return name and value of ``name=value``, the value read as YAML reads it.

    Parameters
    ----------
    text : str
        Such as ``gains.joint1.kd_link=1.0``.

    Returns
    -------
    tuple of str and object

    Raises
    ------
    ConfigError
        If there is no '=' or the value is not YAML.

    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    name, equals, value = text.partition('=')
    if not equals or not name:
        raise ConfigError(f'--set {text!r} must have the form NAME=VALUE')
    try:
        return name, YAML(typ='safe').load(value)
    except YAMLError as error:
        raise ConfigError(f'--set {name}: {value!r} is not a YAML value') from error


def trajectory_file(name):
    """Return the path of a trajectory file given as a path or as a name from config/."""
    from gms_flex_control.resources import share_path
    if Path(name).suffix:
        return Path(name)
    path = share_path() / 'config' / f'{name}.yaml'
    if not path.is_file():
        raise ConfigError(f'--trajectory {name}: no such file in {path.parent}; give a path or '
                          'one of sinusoid, polynomial')
    return path
