# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex record`: topics into a bag that survives kill -9."""

import json
import sys

from gms_flex_control.cli.output import import_ros
from gms_flex_control.errors import BagError


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'record', help='record topics into a bag',
        description='Record topics, each as soon as it has a publisher, until Ctrl-C, SIGTERM or '
                    '--duration. At most 0.2 s are lost if the recorder is killed; "gms_flex '
                    'repair" then completes the bag. Exit code 1 if nothing was received.')
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument('--topics', nargs='+', metavar='TOPIC', help='what to record')
    what.add_argument('--all', action='store_true', help='every topic that is not hidden')
    parser.add_argument('--out', required=True, metavar='DIR', help='the bag to be made')
    parser.add_argument('--duration', type=float, metavar='S', help='stop after S seconds')
    parser.add_argument('--json', action='store_true', help='print the counts as JSON, no more')
    parser.set_defaults(run=run)


def run(args):
    """Record and print the counts; return 0, or 1 if there was nothing to be recorded."""
    if args.duration is not None and not 0.0 < args.duration < float('inf'):
        raise BagError(f'--duration must be a positive number of seconds, got {args.duration}')
    # imported here: rclpy takes 0.1 s and may not be installed
    recorder = import_ros('gms_flex_control.nodes.recorder')
    counts = recorder.record(args.out, None if args.all else args.topics, duration=args.duration,
                             say=_hush if args.json else _say)
    total = sum(counts.values())
    if args.json:
        print(json.dumps({'bag': args.out, 'messages': counts}, indent=2))
    else:
        for name, count in counts.items():
            _say(f'  {name}  {count}')
        _say(f'{args.out}: {total} messages')
    if not total:
        print('gms_flex record: nothing was received; are the publishers running, in this '
              'ROS_DOMAIN_ID, under these names? (ros2 topic list)', file=sys.stderr)
    return 0 if total else 1


def _say(text):
    print(text, flush=True)


def _hush(_text):
    pass
