# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The verbs on bag files: `info`, `record`."""

from dataclasses import asdict
import sys

from gms_flex_control.cli.terminal import end, import_ros
from gms_flex_control.file_io import as_json


def info(args) -> int:
    """Print the summary of a bag; return 0, or 1 for a damaged bag."""
    from gms_flex_control.data.bag import summarise
    summary = summarise(args.bag)
    return end(args, asdict(summary), summary.text(), code=int(bool(summary.damage)))


def record(args) -> int:
    """Record topics and print the counts; return 0, or 1 if nothing was received."""
    recorder = import_ros('gms_flex_control.nodes.recorder')
    counts = recorder.record(args.out, None if args.all else args.topics, duration=args.duration,
                             say=(lambda _: None) if args.json else _say)
    total = sum(counts.values())
    if args.json:
        print(as_json({'bag': str(args.out), 'messages': counts}))
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
