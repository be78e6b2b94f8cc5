# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex info`: what is in a bag."""

import json


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'info', help='topics, rates, gaps, joints and checksums of a bag',
        description='Read a whole bag and list what is in it. Exit code 1 if messages are lost '
                    'or damaged.')
    parser.add_argument('bag', help='bag folder or file (mcap or sqlite3, plain or zstd)')
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.set_defaults(run=run)


def run(args):
    """Print the summary; return 0, or 1 for a damaged bag."""
    from gms_flex_control.bags.summary import summarise
    summary = summarise(args.bag)
    print(json.dumps(summary.as_dict(), indent=2) if args.json else summary.text())
    return 0 if summary.sound else 1
