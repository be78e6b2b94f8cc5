# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex view`: a bag or the running loop in a browser."""

from contextlib import nullcontext
import signal
import sys
import time
import webbrowser

from gms_flex_control.cli.output import import_ros, say
from gms_flex_control.errors import ConfigError

PORT = 8642
HIGHEST_PORT = 65535
_LOOK = 0.2  # at most between a signal and the end [s]


def add_parser(subparsers):
    """Add the verb to the command line."""
    parser = subparsers.add_parser(
        'view', help='the arm moving in a browser, from a bag or live',
        description='Serve a page that shows the arm, its spring deflection, tracking error, '
                    'torque and friction blocks: a bag to play and scrub, or the running loop '
                    'with sliders for the gains of the controller. Everything comes from this '
                    'one process and stays on this machine. Ctrl-C ends it.')
    parser.add_argument('what', metavar='BAG|live', nargs='+',
                        help='bags, the others drawn pale over the first, such as with and '
                             'without compensation; or the word live (needs ROS)')
    parser.add_argument('--robot', nargs='+', metavar='FILE', help='robot file of the bag, and '
                        'others that complete it, such as friction.yaml; default: that of the '
                        'package where the joints have the same names')
    parser.add_argument('--joints', nargs='+', help='link names in the bag')
    parser.add_argument('--motors', nargs='+', help='motor names in the bag')
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='namespace of the running nodes, such as /left')
    parser.add_argument('--controller', metavar='NODE', help='full name of the controller node; '
                        'default: /cascade_controller in the namespace')
    parser.add_argument('--port', type=int, default=PORT,
                        help=f'0 takes a free one (default: {PORT})')
    parser.add_argument('--host', default='127.0.0.1', metavar='ADDRESS',
                        help='address to listen on (default: this machine alone)')
    parser.add_argument('--allow-set', action='store_true',
                        help='with --host: gains may be set from other machines too')
    parser.add_argument('--open', action='store_true', help='open the page in a browser')
    parser.set_defaults(run=run)


def run(args):
    """Serve the page until Ctrl-C; return 0."""
    from gms_flex_control.view.access import is_loopback
    from gms_flex_control.view.server import ViewServer

    if not 0 <= args.port <= HIGHEST_PORT:
        raise ConfigError(f'--port must be 0 to {HIGHEST_PORT}, got {args.port}')
    local = is_loopback(args.host)
    before = {number: signal.signal(number, _interrupt)
              for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with _view(args) as view, ViewServer(view, args.host, args.port,
                                             may_set=local or args.allow_set) as server:
            if not local:
                _warn(args)
            print(f'{server.url}  (Ctrl-C ends it)', flush=True)
            if args.open:
                webbrowser.open(server.url)
            while True:  # whichever thread a signal wakes, this one then raises
                time.sleep(_LOOK)
    except KeyboardInterrupt:
        return 0  # the way to end it
    except BaseException:
        for number, handler in before.items():
            signal.signal(number, handler)
        raise


def _interrupt(_number, _frame):
    """End as Ctrl-C does; a second signal must not interrupt the ending."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _view(args):
    """Return the bag or the running loop as a context."""
    first, *others = args.what
    if first == 'live':
        if others:
            raise ConfigError(f'live {others[0]}: only bags are drawn over each other')
        live_view = import_ros('gms_flex_control.nodes.viewer',
                               '; bags can be viewed without').LiveView
        space = f'/{args.namespace.strip("/")}' if args.namespace.strip('/') else ''
        return live_view(space, args.controller or f'{space}/cascade_controller')
    from gms_flex_control.resources import robot_file
    from gms_flex_control.schema.files import load_robot
    from gms_flex_control.view.bag import open_bag
    say(f'reading {", ".join(args.what)}')
    view = open_bag(first, load_robot(args.robot) if args.robot else None,
                    default=load_robot(robot_file()), joints=args.joints, motors=args.motors,
                    others=others)
    return nullcontext(view)


def _warn(args):
    what = 'see the arm and set gains' if args.allow_set else 'see this page'
    print(f'gms_flex view: warning: listening on {args.host}: whoever reaches that address can '
          f'{what}; there is no encryption and no password', file=sys.stderr,
          flush=True)
