# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex analyse`: bags become the paper's Table 4, a report and pictures."""

import json
from pathlib import Path

from gms_flex_control.cli.output import conclude
from gms_flex_control.params.gains import COMPENSATIONS

UNLABELLED = 'unlabelled'


def add_parser(subparsers):
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'analyse', help="the paper's Table 4 and a report from bags",
        description='Compare bags of one robot with and without friction compensation: '
                    'table4.json, report.html and PNGs in one folder.')
    parser.add_argument('bags', nargs='+', metavar='BAG',
                        help='bag folder; its trajectory and compensation are taken from its '
                             'metadata, else from a name like sinusoid_none')
    parser.add_argument('--out', required=True, help='folder for the results')
    parser.add_argument('--label', action='append', default=[], metavar='TRAJECTORY_COMPENSATION',
                        help='label of a bag, once per bag and in their order')
    parser.add_argument('--joints', nargs='+', help='link names in the bags')
    parser.add_argument('--motors', nargs='+', help='motor names in the bags')
    parser.add_argument('--json', action='store_true', help='print table4.json, not the text')
    parser.set_defaults(run=run)


def run(args):
    """Analyse the bags and return the exit code."""
    from gms_flex_control.analysis.tracking import Run
    from gms_flex_control.bags.reader import read_recording
    from gms_flex_control.errors import BagError
    from gms_flex_control.reports.tracking import write_tracking_report

    if args.label and len(args.label) != len(args.bags):
        raise BagError(f'--label was given {len(args.label)} times for {len(args.bags)} bags; '
                       'give it once per bag, in their order, or not at all')
    labels = list(map(given_label, args.label) if args.label else map(bag_label, args.bags))
    runs = [Run(*label, read_recording(bag, args.joints, args.motors))
            for bag, label in zip(args.bags, labels, strict=True)]
    table = write_tracking_report(runs, args.out)
    if args.json:
        print(json.dumps(table.as_dict(), indent=2, allow_nan=False))
    else:
        print(table.text())
        conclude(table.answer(), {'report': Path(args.out) / 'report.html'})
    return 0


def bag_label(path):
    """
    Return trajectory and compensation of a bag.

    Parameters
    ----------
    path : str or Path
        Bag folder or file.

    Returns
    -------
    tuple of str
        From ``trajectory`` and ``compensation`` in the metadata's custom data, else from the
        folder's name.

    """
    from gms_flex_control.bags import metadata

    path = Path(path)
    custom = {}
    if (path / 'metadata.yaml').is_file():
        custom = metadata.load(path / 'metadata.yaml').custom
    trajectory, compensation = split_label(path.resolve().name)
    return (str(custom.get('trajectory', trajectory)),
            str(custom.get('compensation', compensation)))


def given_label(label):
    """Return trajectory and compensation of --label; raise BagError without a known mode."""
    from gms_flex_control.errors import BagError

    trajectory, compensation = split_label(label)
    if compensation == UNLABELLED:
        raise BagError(f'--label {label}: must end with _ and a compensation, such as '
                       f'sinusoid_gms; known: {", ".join(COMPENSATIONS)}')
    return trajectory, compensation


def split_label(label):
    """Split a name like 'sinusoid_gms_paper' in two; without a mode it is 'unlabelled'."""
    for mode in COMPENSATIONS:
        if label.endswith(f'_{mode}') and len(label) > len(mode) + 1:
            return label[:-len(mode) - 1], mode
    return label, UNLABELLED
