# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex import-csv`: other people's logs become bags."""

import json
from pathlib import Path


def add_parser(subparsers):
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'import-csv', help='turn a text log into a bag',
        description='Read a CSV or similar log as a map file says (columns, units, signs, gear '
                    'ratios) and write it as a bag; say what looks wrong in it.')
    parser.add_argument('file', help='the log, UTF-8 text')
    parser.add_argument('--map', required=True, dest='map_file',
                        help='YAML map; a bare name is looked for in the package too, '
                             'for instance import_kr300.yaml')
    parser.add_argument('--out', required=True, help='folder of the bag, must not exist')
    parser.add_argument('--resample', type=float, metavar='HZ',
                        help='put all on a fixed rate; by default the stamps stay as they are')
    parser.add_argument('--json', action='store_true', help='print the findings as JSON')
    parser.set_defaults(run=run)


def run(args):
    """Import one file and return the exit code."""
    from gms_flex_control.analysis.csv_import import import_csv
    from gms_flex_control.analysis.import_map import load_map
    from gms_flex_control.bags.experiment import write_recording

    import_map = load_map(find_map(args.map_file))
    log = import_csv(args.file, import_map, args.resample)
    custom = {'imported_from': Path(args.file).name, 'import_map': Path(import_map.path).name}
    if import_map.source:
        custom['source'] = import_map.source
    write_recording(args.out, log.recording, log.motors, custom=custom)
    if args.json:
        print(json.dumps({
            'bag': str(args.out), 'joints': log.recording.joints, 'motors': log.motors,
            'samples': len(log.recording.time), 'duration': float(log.recording.time[-1]),
            'remarks': log.remarks,
            'suspicions': [suspicion._asdict() for suspicion in log.suspicions]}, indent=2))
    else:
        print(f'{log.summary()}\nwritten to {args.out}')
    return 0


def find_map(name):
    """Return the map file ``name`` (str), or the one of that name the package ships (Path)."""
    from gms_flex_control.resources import share_path

    path = Path(name)
    if not path.exists() and path.name == str(name):
        shipped = share_path() / 'config' / name
        return shipped if shipped.exists() else path
    return path
