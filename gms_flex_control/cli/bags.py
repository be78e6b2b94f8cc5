# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Verbs that look at bags: `view` in a browser, `info` and `record`."""

from contextlib import nullcontext
from dataclasses import asdict
import re
import signal
import sys
import time
import webbrowser

from gms_flex_control.cli.main import raise_interrupt
from gms_flex_control.cli.terminal import end, import_ros, say
from gms_flex_control.errors import ConfigError
from gms_flex_control.file_io import as_json, robot_file
from gms_flex_control.schema.files import load_robot
from gms_flex_control.view.recorded import open_bag
from gms_flex_control.view.server import ViewServer


def view(args) -> int:
    """Serve the page until Ctrl-C; return 0."""
    before = {}

    def interrupt(number, frame):
        try:
            raise_interrupt(number, frame)
        except KeyboardInterrupt:
            for one in before:  # a second signal must not interrupt the ending
                signal.signal(one, signal.SIG_IGN)
            raise

    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, interrupt)
    try:
        with _view(args) as shown, ViewServer(shown, args.port) as server:
            print(f'{server.url}  (Ctrl-C ends it)', flush=True)
            if args.open:
                webbrowser.open(server.url)
            while True:  # whichever thread a signal wakes, this one then raises
                time.sleep(0.2)
    except KeyboardInterrupt:
        return 0  # the way to end it
    except BaseException:
        for number, handler in before.items():
            signal.signal(number, handler)
        raise


def _view(args):
    """Return the bag or the running loop as a context."""
    first, *others = args.what
    if first == 'live':
        if others:
            raise ConfigError(f'live {others[0]}: only bags are drawn over each other')
        for option in ('robot', 'joints', 'motors'):
            if getattr(args, option):
                raise ConfigError(f'--{option}: the running controller says it; leave it out')
        live_view = import_ros('gms_flex_control.nodes.viewer',
                               '; bags can be viewed without').LiveView
        space = f'/{args.namespace.strip("/")}' if args.namespace.strip('/') else ''
        controller = args.controller or f'{space}/cascade_controller'
        for option, name in (('namespace', f'{space}/plant'), ('controller', controller)):
            if not re.fullmatch(r'(/[A-Za-z_]\w*)+', name, re.ASCII):
                raise ConfigError(f'--{option}: {name!r} is not the full name of a node')
        return live_view(space, controller)
    say(f'reading {", ".join(args.what)}')
    return nullcontext(open_bag(
        first, load_robot(args.robot) if args.robot else None, default=load_robot(robot_file()),
        joints=args.joints, motors=args.motors, others=others))


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
