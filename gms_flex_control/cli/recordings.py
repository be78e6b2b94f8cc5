# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verbs on recordings of a robot: `import-csv`, `analyse`, `identify`, `discrepancy`."""

from functools import partial
import json
from pathlib import Path
import sys
from textwrap import fill
import warnings

from gms_flex_control.cli.terminal import end, progress, refuse_repeated, refuse_unwritable
from gms_flex_control.data import metadata
from gms_flex_control.data.conditions import NAME, UNKNOWN
from gms_flex_control.data.csv_import import currents_in, sliding
from gms_flex_control.data.csv_import import import_csv as read_csv
from gms_flex_control.data.csv_map import load_map
from gms_flex_control.data.reader import (
    joint_names,
    read_experiment,
    read_experiment_of,
    read_recording,
)
from gms_flex_control.data.recording import link_names
from gms_flex_control.data.writer import write_recording
from gms_flex_control.discrepancy.compared import as_found, compare, segment_of, with_closed_loop
from gms_flex_control.discrepancy.learning import learn
from gms_flex_control.discrepancy.result import BAD_DATA, COMPLETE
from gms_flex_control.discrepancy.workflow import find_discrepancy, SearchOptions
from gms_flex_control.effects import registry
from gms_flex_control.errors import BagError, ConfigError
from gms_flex_control.file_io import share_path, write_json, write_text, written_together
from gms_flex_control.identification import output
from gms_flex_control.identification.assumed_robot import only_joints, rigid_joints
from gms_flex_control.identification.coordinates import MOST_BLOCKS
from gms_flex_control.identification.identify import identify, IdentifyOptions
from gms_flex_control.identification.recording_checks import check
from gms_flex_control.identification.sampling_checks import doubtful_columns
from gms_flex_control.params.arm import in_currents, in_units_of
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.reports import discrepancy_values, recordings_page
from gms_flex_control.reports.answers import (
    discrepancy_answer,
    identification_answer,
    identification_text,
)
from gms_flex_control.reports.discrepancy_page import units_of, write_discrepancy_report
from gms_flex_control.reports.recordings_page import write_identification_report
from gms_flex_control.schema.files import load_controller, load_robot
from gms_flex_control.tuning.tracking import link_error, TrackingRun
import numpy as np

UNLABELLED = 'unlabelled'
_WIDTH = 96


def import_csv(args) -> int:
    """Import one text log; return 0."""
    import_map = load_map(find_map(args.map_file))
    log = read_csv(args.file, import_map, args.resample)
    custom = {'imported_from': Path(args.file).name, 'import_map': Path(import_map.path).name}
    if len(sliding(import_map)) == len(import_map.joints):
        custom['axes'] = 'linear'
    if import_map.source:
        custom['source'] = import_map.source
    write_recording(args.out, log.recording, log.motors, custom=custom)
    names = log.recording.joints
    found = suspicions(log.recording) + doubtful_columns(log.recording, import_map.joints)
    currents = currents_in(import_map)
    if currents:
        write_text(Path(args.out) / NAME, 'torque_constant:  # N m per unit of effort\n' + ''.join(
            f'  {joint}: {UNKNOWN}\n' for joint in currents))
    values = {'bag': str(args.out), 'joints': names, 'motors': log.motors,
              'samples': len(log.recording.time), 'duration': log.recording.time[-1],
              'remarks': log.remarks, 'suspicions': found}
    lines = [log.summary(), *(f'  suspicious: {text}' for text in found), f'written to {args.out}']
    return end(args, values, '\n'.join(lines),
               words=in_currents if len(currents) == len(names) else str)


def suspicions(recording) -> list[str]:
    """Return what the checks of `identify` find in a recording of a robot that is not known."""
    found = check(recording.by_motors(), rigid_joints(recording.joints), rough=True)
    return [one.text for one in found if one.kind != 'torque_scale']  # of inertia, not known yet


def find_map(name) -> Path:
    """Return the map file ``name``, or the one of that name the package ships."""
    path = Path(name)
    shipped = share_path() / 'config' / name
    return shipped if not path.exists() and path.name == str(name) and shipped.exists() else path


def analyse(args) -> int:
    """Compare bags with and without compensation, write the report; return 0."""
    refuse_unwritable(args, 'table4.json')
    refuse_repeated(args.bags, ())
    if args.label and len(args.label) != len(args.bags):
        raise BagError(f'--label was given {len(args.label)} times for {len(args.bags)} bags; '
                       'give it once per bag, in their order, or not at all')
    labels = list(map(given_label, args.label) if args.label else map(bag_label, args.bags))
    runs = [TrackingRun(*label, read_recording(bag, args.joints, args.motors))
            for bag, label in zip(args.bags, labels, strict=True)]
    _refuse_without_reference(runs)
    words = partial(in_units_of, _axes_of(args.bags))
    table = recordings_page.write_tracking_report(runs, args.out, words=words)
    return end(args, recordings_page.table_values(table, words), table.text(), table.answer(),
               {'report': Path(args.out) / 'report.html'}, words)


def _refuse_without_reference(runs):
    """Warn about each TrackingRun without a tracking error; raise BagError if none has one."""
    without = [run.recording.source for run in runs
               if not np.isfinite(link_error(run.recording)).any()]
    sentence = ('no sample has both a link angle and a reference, so there is no tracking error; '
                'record /reference as well, or name the links by --joints')
    if len(without) == len(runs):
        raise BagError(f'{", ".join(without)}: {sentence}')
    for source in without:
        warnings.warn(f'{source}: {sentence}', stacklevel=2)


def _axes_of(bags):
    """Return 'linear' where the import of all bags says so, else 'rotary'."""
    axes = {_remarks(bag).get('axes', 'rotary') for bag in bags}
    return 'linear' if axes == {'linear'} else 'rotary'


def _remarks(bag):
    path = Path(bag) / 'metadata.yaml'
    return metadata.load(path).custom if path.is_file() else {}


def bag_label(path) -> tuple[str, str]:
    """Return trajectory and compensation of a bag, by its metadata or else its folder's name."""
    path, custom = Path(path), _remarks(path)
    trajectory, compensation = _split_label(path.resolve().name)
    return (str(custom.get('trajectory', trajectory)),
            str(custom.get('compensation', compensation)))


def given_label(label: str) -> tuple[str, str]:
    """Return trajectory and compensation of --label; raise BagError without a known mode."""
    trajectory, compensation = _split_label(label)
    if compensation == UNLABELLED:
        raise BagError(f'--label {label}: must end with _ and a compensation, such as '
                       f'sinusoid_gms; known: {", ".join(COMPENSATIONS)}')
    return trajectory, compensation


def _split_label(label):
    """Split a name like 'sinusoid_gms_paper' in two; without a mode it is 'unlabelled'."""
    for mode in COMPENSATIONS:
        if label.endswith(f'_{mode}') and len(label) > len(mode) + 1:
            return label[:-len(mode) - 1], mode
    return label, UNLABELLED


def identify_bags(args) -> int:
    """Identify, write and print; return 0."""
    refuse_unwritable(args, 'friction.yaml')
    refuse_repeated(args.bags, args.holdout)
    found, out = _written(args, _options_of(args)), Path(args.out)
    return end(args, output.report_json(found), identification_text(found),
               identification_answer(found, out, args.robot or ()), {
                   'parameters': out / 'friction.yaml', 'report': out / 'report.html',
                   'numbers': out / 'report.json'}, found.in_units)


def _written(args, options):
    """Return the Identification of the bags fitted together, its files written to --out."""
    if args.robot is None:
        robot, joints = None, args.joints or link_names(joint_names(args.bags[0]))
        read = partial(read_experiment, joints=joints)
    else:
        robot = load_robot(args.robot, to_identify=True)
        robot = only_joints(robot, args.joints) if args.joints else robot
        read = partial(read_experiment_of, robot=robot)
    recordings, apart = (list(map(read, paths)) for paths in (args.bags, args.holdout))
    found = identify(recordings, robot, holdouts=apart, options=options, say=progress(args))
    out = Path(args.out)
    with written_together():
        output.write_friction(found, out / 'friction.yaml')
        output.write_conditions(found, out)
        write_json(out / 'report.json', output.report_json(found))
        write_identification_report(found, out, robot=args.robot or ())
    return found


def _options_of(args):
    chosen = {'force': args.force, 'widened': args.widen, 'estimate': args.estimate}
    if args.robot is None:
        chosen |= {'joints': tuple(args.joints or ()), 'axes': _axes_of(args.bags)}
    if args.blocks:
        wrong = [n for n in args.blocks if not 1 <= n <= MOST_BLOCKS]
        if wrong:
            raise ConfigError(f'--blocks {wrong[0]}: give numbers from 1 to {MOST_BLOCKS}')
        chosen['blocks'] = tuple(sorted(set(args.blocks)))
    return IdentifyOptions(**chosen)


def discrepancy_verb(args) -> int:
    """Compare, write and print; return the exit code of the verdict."""
    refuse_unwritable(args, 'robot.yaml')
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
    values = discrepancy_values.report_values(result, holdout=args.holdout, models=compared)
    earlier = _earlier(out)
    with written_together():
        written = write_discrepancy_report(result, out, holdout=holdout, models=compared)
        if result.robot is not None:
            discrepancy_values.write_robot(result, out / 'robot.yaml', units_of(result))
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
            compared and f'\n{discrepancy_values.comparison_text(compared, result.gap.joints)}')
    answer = discrepancy_answer(result, out, args.holdout)
    return end(args, values, '\n'.join(filter(None, text)), answer, {
        'model': out / 'robot.yaml', 'report': out / 'report.html',
        'numbers': out / 'report.json'}, words, int(result.verdict != COMPLETE))


def _search_options(args):
    chosen = {'force': args.force, 'widened': args.widen, 'without': tuple(args.without)}
    for name in args.without:
        registry.find(name)
    if args.max_effects is not None:
        chosen['most'] = args.max_effects
    return SearchOptions(**chosen)


def _models_of(args, robot):
    models = []
    for file in args.models:
        model = load_robot(file)
        if model.joints != robot.joints or tuple(model.arm.rigid) != tuple(robot.arm.rigid):
            raise ConfigError(f'{file}: its joints {", ".join(model.joints)}, flexible or rigid, '
                              f'are not those of --robot ({", ".join(robot.joints)})')
        models.append((str(file), model))
    return models
