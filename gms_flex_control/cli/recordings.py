# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verbs on recordings of a robot: `import-csv`, `analyse`, `torsion`."""

from dataclasses import asdict
import json
import math
from pathlib import Path

from gms_flex_control.analysis.torsion import study
from gms_flex_control.analysis.tracking import Run
from gms_flex_control.cli.terminal import conclude
from gms_flex_control.data import metadata
from gms_flex_control.data.conditions import NAME, UNKNOWN
from gms_flex_control.data.csv_import import currents_in
from gms_flex_control.data.csv_import import import_csv as read_csv
from gms_flex_control.data.csv_map import load_map
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import BagError
from gms_flex_control.file_io import write_text
from gms_flex_control.params.arm import in_currents
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.reports import recordings_page
from gms_flex_control.resources import share_path
from gms_flex_control.schema.files import save_robot

UNLABELLED = 'unlabelled'


def import_csv(args) -> int:
    """Import one text log; return 0."""
    import_map = load_map(find_map(args.map_file))
    log = read_csv(args.file, import_map, args.resample)
    custom = {'imported_from': Path(args.file).name, 'import_map': Path(import_map.path).name}
    if import_map.source:
        custom['source'] = import_map.source
    write_recording(args.out, log.recording, log.motors, custom=custom)
    currents = currents_in(import_map)
    if currents:
        write_text(Path(args.out) / NAME, 'torque_constant:  # N m per unit of effort\n' + ''.join(
            f'  {joint}: {UNKNOWN}\n' for joint in currents))
    if args.json:
        print(json.dumps({
            'bag': str(args.out), 'joints': log.recording.joints, 'motors': log.motors,
            'samples': len(log.recording.time), 'duration': float(log.recording.time[-1]),
            'remarks': log.remarks,
            'suspicions': [suspicion._asdict() for suspicion in log.suspicions]}, indent=2))
    else:
        every = len(currents) == len(log.recording.joints)
        print(f'{in_currents(log.summary()) if every else log.summary()}\nwritten to {args.out}')
    return 0


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
        print(json.dumps(table.as_dict(), indent=2, allow_nan=False))
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


def torsion(args) -> int:
    """Fit a first flexible-joint model, write the report if asked to; return 0."""
    found = study(read_recording(args.bag), args.joint, args.stiffness, args.motor_inertia)
    print(json.dumps(_torsion_values(found), indent=2, allow_nan=False) if args.json
          else recordings_page.torsion_text(found))
    if args.out:
        page = recordings_page.write_torsion_report(found, args.out)
        robot = Path(args.out) / 'robot.yaml'
        given = 'as given' if found.motor_inertia else 'ASSUMED to be half of M + J'
        save_robot(found.robot, robot, comment=(
            f'First model of {found.joint} from {found.source}, by gms_flex torsion.\n'
            'M + J, coulomb and viscous were fitted to the torque; stiffness as given;\n'
            f'J {given}; Stribeck velocity, block stiffness and attraction are ASSUMED:\n'
            'the data do not identify them.'))
        if not args.json:
            conclude(recordings_page.torsion_answer(found, args.out),
                     {'report': page, 'robot': robot})
    return 0


def _torsion_values(found):
    """Return the figures of a TorsionStudy as plain values; no spring is stiffness None."""
    measured, error = found.torque_error
    explanations = [asdict(one) | {
        'stiffness': one.stiffness if math.isfinite(one.stiffness) else None}
        for one in found.explanations]
    return {'joint': found.joint, 'source': found.source, 'samples': len(found.time),
            'inertia': found.inertia, 'motor_inertia': found.motor_inertia,
            'coulomb': found.coulomb, 'viscous': found.viscous,
            'torque': {'rms_measured': measured, 'rms_error': error,
                       'relative_error': error / measured},
            'torsion_offset': found.torsion_offset, 'explanations': explanations}
