# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verbs on recordings of a robot: `import-csv`, `analyse`."""

from pathlib import Path

from gms_flex_control.cli.terminal import conclude
from gms_flex_control.comparison.tracking import Run
from gms_flex_control.data import metadata
from gms_flex_control.data.conditions import NAME, UNKNOWN
from gms_flex_control.data.csv_import import currents_in
from gms_flex_control.data.csv_import import import_csv as read_csv
from gms_flex_control.data.csv_map import load_map
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import BagError
from gms_flex_control.file_io import as_json, share_path, write_text
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.identification.recording_checks import check
from gms_flex_control.params.arm import in_currents
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.reports import recordings_page

UNLABELLED = 'unlabelled'


def import_csv(args) -> int:
    """Import one text log; return 0."""
    import_map = load_map(find_map(args.map_file))
    log = read_csv(args.file, import_map, args.resample)
    custom = {'imported_from': Path(args.file).name, 'import_map': Path(import_map.path).name}
    if import_map.source:
        custom['source'] = import_map.source
    write_recording(args.out, log.recording, log.motors, custom=custom)
    names = log.recording.joints
    found = suspicions(log.recording)
    currents = currents_in(import_map)
    if currents:
        write_text(Path(args.out) / NAME, 'torque_constant:  # N m per unit of effort\n' + ''.join(
            f'  {joint}: {UNKNOWN}\n' for joint in currents))
    if args.json:
        print(as_json({'bag': str(args.out), 'joints': names, 'motors': log.motors,
                       'samples': len(log.recording.time), 'duration': log.recording.time[-1],
                       'remarks': log.remarks, 'suspicions': found}))
    else:
        lines = [log.summary(), *(f'  suspicious: {text}' for text in found)]
        words = in_currents if len(currents) == len(names) else str
        print(words('\n'.join([*lines, f'written to {args.out}'])))
    return 0


def suspicions(recording) -> list[str]:
    """Return what the checks of `identify` find in a recording of a robot that is not known."""
    found = check(recording, rigid_joints(recording.joints), rough=True)
    return [one.text for one in found if one.kind != 'torque_scale']  # of inertia, not known yet


def find_map(name) -> Path:
    """Return the map file ``name``, or the one of that name the package ships."""
    path = Path(name)
    shipped = share_path() / 'config' / name
    return shipped if not path.exists() and path.name == str(name) and shipped.exists() else path


def analyse(args) -> int:
    """Compare bags with and without compensation, write the report; return 0."""
    if args.label and len(args.label) != len(args.bags):
        raise BagError(f'--label was given {len(args.label)} times for {len(args.bags)} bags; '
                       'give it once per bag, in their order, or not at all')
    labels = list(map(given_label, args.label) if args.label else map(bag_label, args.bags))
    runs = [Run(*label, read_recording(bag, args.joints, args.motors))
            for bag, label in zip(args.bags, labels, strict=True)]
    table = recordings_page.write_tracking_report(runs, args.out)
    if args.json:
        print(as_json(table.as_dict()))
    else:
        print(table.text())
        conclude(table.answer(), {'report': Path(args.out) / 'report.html'})
    return 0


def bag_label(path) -> tuple[str, str]:
    """
    Return trajectory and compensation of a bag.

    From ``trajectory`` and ``compensation`` in the metadata's custom data, else from the
    folder's name.
    """
    path, custom = Path(path), {}
    if (path / 'metadata.yaml').is_file():
        custom = metadata.load(path / 'metadata.yaml').custom
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
