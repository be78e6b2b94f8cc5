# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench faults`: every fault tried on the installed nodes, as a table."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
import json
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory

from gms_flex_control.cli.options import add_verb, JSON, option, Verb
from gms_flex_control.cli.terminal import import_ros
from gms_flex_control.errors import ConfigError, did_you_mean

_LONGEST_SOAK = 10_000.0  # [min]
_PRIORITY = 50            # of the nodes, where it is permitted


VERB = Verb(
    'faults', lambda args: run(args),
    'try faults on the installed nodes: what happens, and how fast',
    'Start the installed nodes over DDS on a domain of their own, on this machine alone and with '
    'a simulated arm, do to them what must never move an arm, and print the table of '
    'docs/faults.md filled in. It takes about ten minutes, --short about three. Figures hold for '
    'a machine with little else to do. Exit code 1 if anything was not as required.', (
        option('--short', action='store_true', help='few tries of each, for CI'),
        option('--only', nargs='+', metavar='FAULT', help='some rows; see --list'),
        option('--list', action='store_true', help='name the rows and end'),
        option('--soak', type=float, metavar='MINUTES',
               help='instead of faults: run the loop at 500 Hz so long, and watch memory and '
                    'missed deadlines'),
        option('--priority', type=int, metavar='N',
               help=f'realtime_priority of the nodes, 1 to 99, 0 for none; default {_PRIORITY}, '
                    'as config/bridge.yaml asks for, or 0 where the system does not permit it'),
        JSON, option('--logs', type=Path, metavar='FOLDER',
                     help='keep there what the nodes print')), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Try faults and print the table; return 0, or 1 where one was not as required."""
    table = import_ros('bench.faults.table')
    if args.list:
        names = {fault.name: fault.fault for fault in table.FAULTS.values()}
        print(json.dumps(names, indent=2) if args.json else
              '\n'.join(f'{name:<16} {fault}' for name, fault in names.items()))
        return 0
    for name in args.only or ():
        if name not in table.FAULTS:
            raise ConfigError(f'there is no fault {name!r}{did_you_mean(name, table.FAULTS)} ('
                              'python -m bench faults --list names all)')
    priority = _priority(args.priority)
    if args.soak is not None:
        if not 0.0 < args.soak <= _LONGEST_SOAK:
            raise ConfigError(f'--soak {args.soak:g}: expected minutes above 0, at most '
                              f'{_LONGEST_SOAK:g}')
        return _soaked(args, priority)
    rows = []
    for name in args.only or table.FAULTS:
        fault = table.FAULTS[name]
        tries = fault.tries[0 if args.short else 1]
        _progress(f'{len(rows) + 1} of {len(args.only or table.FAULTS)}: {fault.fault}, '
                  f'{tries} tries ...')
        rows.append(table.try_fault(fault, tries, _folder(args.logs, name), priority))
        _progress('')
    print(table.as_json(rows) if args.json else f'{table.table(rows)}\n{_condition(priority)}')
    return 0 if table.all_held(rows) else 1


def _priority(asked):
    """Return the priority that the nodes get (int)."""
    if asked is None:
        return _PRIORITY if is_permitted(_PRIORITY) else 0
    if not 0 <= asked <= 99:
        raise ConfigError(f'--priority {asked}: expected 1 to 99, or 0 for none')
    if asked and not is_permitted(asked):
        raise ConfigError(f'--priority {asked}: the system does not permit it; '
                          f'{import_ros("gms_flex_control.nodes.scheduling").WAY_OUT}, or give 0')
    return asked


def is_permitted(priority) -> bool:
    """Return whether a thread of this process may take a priority (1 to 99) of SCHED_FIFO."""
    try:
        with ThreadPoolExecutor(1) as pool:
            pool.submit(os.sched_setscheduler, 0, os.SCHED_FIFO, os.sched_param(priority)).result()
    except (OSError, AttributeError):
        return False
    return True


def _soaked(args, priority):
    from bench.faults import soak
    from bench.faults.node_bench import Bench
    with nullcontext(_folder(args.logs, 'soak')) if args.logs else TemporaryDirectory() as place:
        with Bench(Path(place), priority) as bench:
            windows = soak.soak(bench, 60.0 * args.soak, say=_progress)
    _progress('')
    wrong = soak.judged(windows)
    print(json.dumps({'windows': [window._asdict() for window in windows], 'problems': wrong,
                      'priority': priority}, indent=2)
          if args.json else f'{soak.table(windows)}\n{_condition(priority)}')
    return 1 if wrong else 0


def _condition(priority):
    return (f'The nodes had realtime_priority {priority}.' if priority else
            'The nodes had no realtime_priority: other programs make them late.')


def _folder(logs, name):
    if logs is None:
        return None
    folder = logs / name
    if folder.exists():
        raise ConfigError(f'{folder} exists: name another --logs')
    folder.mkdir(parents=True)
    return folder


def _progress(text):
    """Say on a terminal what is being done; '' takes it away."""
    if sys.stderr.isatty():
        print(f'\r\033[K{text}', end='', file=sys.stderr, flush=True)
