# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verb `discrepancy`: what a model lacks to explain bags of its robot."""

import json
from pathlib import Path
import sys
from textwrap import fill

from gms_flex_control.cli.terminal import end, progress, refuse_repeated, refuse_unwritable
from gms_flex_control.data.reader import read_experiment_of
from gms_flex_control.discrepancy.compared import as_found, compare, segment_of, with_closed_loop
from gms_flex_control.discrepancy.learning import learn
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE
from gms_flex_control.discrepancy.workflow import find_discrepancy, Options
from gms_flex_control.effects import registry
from gms_flex_control.errors import BagError, ConfigError
from gms_flex_control.file_io import write_json, written_together
from gms_flex_control.reports import discrepancy_values as files
from gms_flex_control.reports.answers import discrepancy_answer
from gms_flex_control.reports.discrepancy_page import units_of, write_discrepancy_report
from gms_flex_control.schema.files import load_controller, load_robot
import numpy as np

_WIDTH = 96


def discrepancy_verb(args) -> int:
    """Compare, write and print; return the exit code of the verdict."""
    _refuse_out(Path(args.out), args)
    refuse_repeated(args.bags, args.holdout)
    _options_of(args)
    result, compared, holdout = _answered(args)
    values = _write_files(result, compared, holdout, args)
    return _printed(result, compared, values, args)


def _answered(args):
    """Return the Discrepancy of --robot with bags, Compared models, recordings held out."""
    options, robot = _options_of(args), load_robot(args.robot)
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
        told = progress(args, '  {} ...')
        found = find_discrepancy(recordings, robot, options, holdout=holdout, say=told)
        return learn(found, holdout=holdout, say=told) if args.learn else found
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
        segment_of(recording)
    return with_closed_loop(search(), recordings, gains)


def _write_files(result, compared, holdout, args):
    out = Path(args.out)
    values = files.report_values(result, holdout=args.holdout, models=compared)
    earlier = _earlier(out)
    with written_together():
        written = write_discrepancy_report(result, out, holdout=holdout, models=compared)
        if result.robot is not None:
            files.write_robot(result, out / 'robot.yaml', units_of(result))
            written.append(out / 'robot.yaml')
        write_json(out / 'report.json', values)
    for path in set(earlier) - set(written):  # no longer true
        path.unlink()
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
    out, words = Path(args.out), units_of(result)
    if result.verdict == BAD_DATA:
        if not args.json:
            print(fill(f'gms_flex discrepancy: {result.words}', _WIDTH, break_on_hyphens=False),
                  file=sys.stderr)
        return end(args, values, code=2)
    text = (fill(words(result.details), _WIDTH, break_on_hyphens=False),
            compared and f'\n{files.comparison_text(compared, result.gap.joints)}')
    answer = discrepancy_answer(result, out, args.holdout)
    return end(args, values, '\n'.join(filter(None, text)), answer, {
        'model': out / 'robot.yaml', 'report': out / 'report.html',
        'numbers': out / 'report.json'}, words, int(result.verdict != COMPLETE))


def _options_of(args):
    chosen = {'force': args.force, 'widened': args.widen, 'without': tuple(args.without)}
    for name in args.without:
        registry.find(name)
    if args.max_effects is not None:
        chosen['most'] = args.max_effects
    return Options(**chosen)


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
