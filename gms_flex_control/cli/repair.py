# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex repair`: a sound bag from one that was killed, cut off or damaged."""

import json


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'repair', help='recover a killed, cut off or damaged bag',
        description='Write every sound message of a bag to a new one, name what is lost. '
                    'The old bag is not touched. Exit code 1 if messages were lost.')
    parser.add_argument('bag', help='bag folder or file (mcap or sqlite3, plain or zstd)')
    parser.add_argument('--out', metavar='DIR', help='the new bag (default: BAG_repaired)')
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.set_defaults(run=run)


def run(args):
    """Repair and print what was done; return 0, or 1 if messages were lost."""
    from gms_flex_control.bags.repair import repair_bag
    result = repair_bag(args.bag, args.out)
    print(json.dumps(result.as_dict(), indent=2) if args.json else result.text())
    return 0 if result.lost == 0 else 1
