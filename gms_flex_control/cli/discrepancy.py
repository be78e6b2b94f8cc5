# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex discrepancy`: what a model lacks, named, added and shown on data held out."""

from argparse import Namespace
import os
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.cli import each
from gms_flex_control.cli.output import add_batch_options, conclude, refuse_fitted, say

_WIDTH = 96
_MADE = ('robot.yaml', 'gap.png', 'evidence_*.png', 'map_*.png', 'over_*.png')  # not by every run
_FILES = ('robot', 'models', 'controller', 'holdout')  # options that name files


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'discrepancy', help='find what a model lacks, name it, add it, show the gap shrink',
        description='Compare a model with bags of its robot, recorded or simulated; name the '
                    'physical effects it lacks, write them into DIR/robot.yaml, and show on '
                    'held-out data how much better it predicts: report.json, report.html, '
                    'pictures. Exit codes: 0 nothing is missing, 1 effects were found or '
                    'something is unexplained, 2 the data or the input are bad. With --each '
                    'every bag is analysed by itself, and names are counted over the bags; a '
                    'killed run goes on when started again with the same --out.')
    parser.add_argument('bags', nargs='+', metavar='BAG', help='bags of one robot')
    parser.add_argument('--each', action='store_true',
                        help='each bag by itself into DIR/NAME OF THE BAG, all side by side in '
                             'DIR/summary.json, summary.csv and spread.csv; exit code 1 also '
                             'where the data of a bag are bad')
    parser.add_argument('--robot', metavar='FILE', nargs='+', required=True,
                        help='the model one believes in, later files winning')
    parser.add_argument('--out', required=True, metavar='DIR', help='folder for the results')
    parser.add_argument('--holdout', nargs='+', default=[], metavar='BAG',
                        help='bags on which the gap is measured; default: blocks of 2 s, each '
                             'predicted from the others')
    parser.add_argument('--max-effects', type=int, metavar='N',
                        help='how many effects may be added (default: 20)')
    parser.add_argument('--without', nargs='+', default=[], metavar='EFFECT',
                        help='effects of the catalogue that are not considered')
    parser.add_argument('--doubt', type=float, default=1.0, metavar='TIMES',
                        help='standard deviations of known parameters, as a multiple of the '
                             'usual ones: 1.5 %% of inertia and stiffness, 2 %% of friction '
                             '(default: 1)')
    parser.add_argument('--models', nargs='+', default=[], metavar='FILE',
                        help='further models of the robot to compare on the same bags')
    parser.add_argument('--controller', nargs='+', default=[], metavar='FILE',
                        help='the controller that drove the robot while it believed --robot: its '
                             'closed loop is simulated along the recorded /reference, too')
    parser.add_argument('--force', action='store_true',
                        help='go on in spite of faults in the data')
    parser.add_argument('--json', action='store_true',
                        help='print report.json, with --each summary.json, instead of text')
    add_batch_options(parser, None, 'of --each: processes of this machine (default: 2)')
    parser.set_defaults(run=run)


def run(args):
    """Compare, write and print; return the exit code of the verdict."""
    from gms_flex_control.errors import ConfigError

    refuse_out(Path(args.out), args)
    refuse_fitted(args.bags, args.holdout)
    options_of(args)
    if args.each:
        return run_each(args)
    if args.workers is not None or args.scheduler is not None:
        raise ConfigError('--workers and --scheduler divide many bags; add --each, or leave them '
                          'out: bags analysed together are one search')
    result, compared, holdout = answered(args)
    values = write_files(result, compared, holdout, args)
    return printed(result, compared, values, args)


def answered(args):
    """Return the Discrepancy of --robot with bags, Compared models, recordings held out."""
    from gms_flex_control.cli.identify import read_take
    from gms_flex_control.reports.model_comparison import as_found, compare
    from gms_flex_control.schema.files import load_robot

    options, robot = options_of(args), load_robot(args.robot)
    others = models_of(args, robot)
    takes, holdout = ([read_take(path, robot)[0] for path in paths]
                      for paths in (args.bags, args.holdout))
    result = looped(args, robot, holdout or takes,
                    lambda: searched(takes, robot, options, holdout, args))
    compared = ()
    if others and result.behind is not None:
        compared = compare(result, [('as given', robot), ('with what was found', as_found(result)),
                                    *others], holdout)
    return result, compared, holdout


def searched(takes, robot, options, holdout, args):
    """Return the Discrepancy; raise BagError where forced data leave no number to go on with."""
    from gms_flex_control.discrepancy.workflow import find_discrepancy
    from gms_flex_control.errors import BagError
    import numpy as np
    try:
        return find_discrepancy(takes, robot, options, holdout=holdout, say=progress(args))
    except (np.linalg.LinAlgError, ValueError) as error:
        if not args.force:
            raise
        raise BagError(f'{", ".join(args.bags)}: no model can be fitted to these data ({error}); '
                       'without --force their faults are listed; correct those first') from error


def looped(args, robot, recordings, search):
    """Return what ``search`` finds, with the closed loop of --controller; refuse before it."""
    from gms_flex_control.discrepancy.closed_loop import stretch_of, with_closed_loop
    from gms_flex_control.schema.files import load_controller
    if not args.controller:
        return search()
    gains = load_controller(args.controller, robot)
    for recording in recordings:
        stretch_of(recording)
    return with_closed_loop(search(), recordings, gains)


def write_files(result, compared, holdout, args):
    """Write all files into --out; return the values of report.json."""
    from gms_flex_control.reports import discrepancy_values as files
    from gms_flex_control.reports.discrepancy import write_discrepancy_report

    out = Path(args.out)
    values = files.report_values(result, holdout=args.holdout, models=compared)
    earlier = _earlier(out)
    written = write_discrepancy_report(result, out, holdout=holdout, models=compared)
    if result.robot is not None:
        files.write_robot(result, out / 'robot.yaml')
        written.append(out / 'robot.yaml')
    for path in set(earlier) - set(written):  # no longer true
        path.unlink()
    files.write_report_values(values, out / 'report.json')  # at last
    return values


def _earlier(out):
    """Return the files in ``out`` that an earlier run of this verb has made."""
    import json
    try:
        told = json.loads((out / 'report.json').read_text())
    except (OSError, ValueError):
        return []
    if not isinstance(told, dict) or 'verdict' not in told:  # of another verb
        return []
    return [path for pattern in _MADE for path in out.glob(pattern)]


def printed(result, compared, values, args):
    """Print the words or the report; return the exit code."""
    import sys
    from textwrap import fill

    from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE
    from gms_flex_control.reports.discrepancy import discrepancy_answer, units_of
    from gms_flex_control.reports.discrepancy_values import as_json
    from gms_flex_control.reports.model_comparison import comparison_text

    out, bad, words = Path(args.out), result.verdict == BAD_DATA, units_of(result)(result.words)
    if args.json:
        print(as_json(values))
    else:
        stream = sys.stderr if bad else sys.stdout
        print(fill(f'gms_flex discrepancy: {words}' if bad else words, _WIDTH,
                   break_on_hyphens=False), file=stream)
    if not args.json and not bad:
        if compared:
            print(units_of(result)(f'\n{comparison_text(compared, result.gap.joints)}'))
        conclude(discrepancy_answer(result, out), {
            'model': out / 'robot.yaml', 'report': out / 'report.html',
            'numbers': out / 'report.json'}, units_of(result))
    return 2 if bad else int(result.verdict != COMPLETE)


def options_of(args):
    """Return the Options that the arguments ask for."""
    from gms_flex_control.discrepancy.workflow import Options
    from gms_flex_control.effects.registry import find
    from gms_flex_control.errors import ConfigError
    chosen = {'force': args.force, 'doubt': args.doubt, 'without': tuple(args.without)}
    for name in args.without:
        find(name)
    if args.max_effects is not None:
        if args.max_effects < 1:
            raise ConfigError(f'--max-effects {args.max_effects}: at least one is needed')
        chosen['most'] = args.max_effects
    if not 0.0 < args.doubt <= 100.0:
        raise ConfigError(f'--doubt {args.doubt:g}: give a number above 0, up to 100')
    return Options(**chosen)


def refuse_out(out, args):
    """Raise ConfigError if the results cannot go to ``out``."""
    from gms_flex_control.cli.output import refuse_unwritable
    from gms_flex_control.errors import ConfigError
    refuse_unwritable(out)
    target = (out / 'robot.yaml').resolve()
    for file in (*args.robot, *args.models):
        if Path(file).resolve() == target:
            raise ConfigError(f'{file} would be overwritten by the model that is found; name '
                              'another folder as --out')


def models_of(args, robot):
    """Return name and model of each file of --models."""
    from gms_flex_control.errors import ConfigError
    from gms_flex_control.schema.files import load_robot
    models = []
    for file in args.models:
        model = load_robot(file)
        if model.joints != robot.joints or tuple(model.arm.rigid) != tuple(robot.arm.rigid):
            raise ConfigError(f'{file}: its joints {", ".join(model.joints)}, flexible or rigid, '
                              f'are not those of --robot ({", ".join(robot.joints)})')
        models.append((str(file), model))
    return models


def progress(args):
    """Return what tells progress: on a terminal only, and beside the results."""
    return (lambda text: None) if args.json else lambda text: say(f'  {text} ...')


class BagItem(NamedTuple):
    """A bag to be asked, perhaps in another process."""

    place: each.Place
    asked: dict  # options of the verb by name, files as absolute paths


def run_each(args):
    """Ask each bag, write, print; return 1 if one finds something or is bad, else 0."""
    from gms_flex_control.discrepancy.result import COMPLETE
    from gms_flex_control.reports.over_bags import discrepancy_text

    items, asked = items_of(args)
    found = each.run_each(args, ask_bag, items, asked)
    each.write_summary(args, found, discrepancy_text)
    return int(any(values.get('verdict') != COMPLETE for values in found.values()))


def items_of(args):
    """Return the items of a batch by key, and what their results depend on beside the bag."""
    from gms_flex_control.batches.journal import content_of, digest_of, fingerprint
    from gms_flex_control.schema.files import load_controller, load_robot

    robot = load_robot(args.robot)  # says now what is wrong with it
    models_of(args, robot)
    if args.controller:
        load_controller(args.controller, robot)
    options = {name: value for name, value in vars(args).items()
               if name not in ('bags', 'out', 'json', 'run', 'verb', 'command', 'workers',
                               'scheduler')}
    for name in _FILES:
        options[name] = [os.path.abspath(path) for path in options[name]]
    files = [(path, content_of(path)) for name in _FILES for path in options[name]]
    asked = f'{fingerprint()} {digest_of((sorted(options.items()), files))}'
    places = each.places_of(args.bags, args.out, asked)
    refuse_own(places.values(), options)
    return {key: BagItem(place, options) for key, place in places.items()}, asked


def refuse_own(places, options):
    """Raise ConfigError if a file that is asked with is one that the results replace."""
    from gms_flex_control.errors import ConfigError
    folders = {place.folder.resolve() for place in places}
    for name in _FILES:
        for file in options[name]:
            if folders & set(Path(file).resolve().parents):
                raise ConfigError(f'{file} lies in the folder of results of a bag, which may '
                                  'replace it; copy it elsewhere, or name another folder as --out')


def ask_bag(item):
    """
    Ask one bag what the model lacks, and write the results.

    Parameters
    ----------
    item : BagItem
        Which, and where to.

    Returns
    -------
    dict
        Verdict, words, effects and ``estimates`` of their parameters as those of
        `identification.over_bags.bag_values`, and ``reason``, None unless the data are bad.

    """
    from gms_flex_control.reports.discrepancy_values import over_bags_values

    args = Namespace(**item.asked, bags=[item.place.bag], json=True)
    result, compared, holdout = answered(args)
    with each.whole(item.place) as folder:
        args.out = folder
        write_files(result, compared, holdout, args)
    return over_bags_values(result)
