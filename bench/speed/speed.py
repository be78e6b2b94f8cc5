# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`python -m bench speed`: how fast everything is on this machine, beside MuJoCo and numpy."""

from dataclasses import asdict
from functools import partial
from importlib import import_module
import json
import sys

from gms_flex_control.cli.options import add_verb, CONTROLLER, JSON, option, ROBOT, Verb

# suite: module and function (robot, gains, quick) -> list of Measurement
SUITES = {
    'loop': ('simulation', 'measure_loop'),
    'step': ('simulation', 'measure_step'),
    'tick': ('simulation', 'measure_tick'),
    'ros': ('ros_loop', 'measure'),
    'view': ('view_live', 'measure'),
    'fit': ('fit', 'measure_fit'),
    'identify': ('fit', 'measure_identification'),
    'export': ('mujoco_export', 'measure'),
}
# the others support docs/view.md and docs/export.md
DEFAULT = ('loop', 'step', 'tick', 'ros', 'fit', 'identify')


VERB = Verb(
    'speed', lambda args: run(args), 'speed on this machine, beside MuJoCo and numpy',
    'Measure speed: medians of interleaved repetitions. Compare figures of one run only. MuJoCo '
    'is measured where the extra "bench" is installed. Only when asked for: '
    '"export", free runs of the exported MJCF beside our own, effect by effect '
    '(docs/export.md), and "view", the late samples of the loop with and without the page of view '
    'live.', (
        option('--quick', action='store_true', help='rough figures in a few seconds'), JSON,
        option('--only', nargs='+', choices=SUITES, metavar='SUITE',
               help=f'some of: {", ".join(SUITES)}'),
        ROBOT, CONTROLLER), ())
add_parser = partial(add_verb, VERB)


def run(args):
    """Measure and print; return 0, or 1 where a target was missed."""
    from bench.speed import mujoco_arm
    from gms_flex_control.file_io import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot

    robot = load_robot(args.robot or robot_file())
    gains = load_controller(args.controller or controller_file(), robot)
    found = list(measured(args.only or DEFAULT, robot, gains, args.quick))
    if args.json:
        print(json.dumps([{**asdict(m), 'verdict': m.verdict} for m in found], indent=2))
    else:
        print(table(found))
        if not mujoco_arm.available():
            print("\nMuJoCo is not installed; pip install '.[bench]' in the clone adds it",
                  file=sys.stderr)
    return 1 if any(m.verdict == 'missed' for m in found) else 0


def measured(names, robot, gains, quick=False):
    """Yield the Measurements of suites, keys of SUITES, one suite after the other."""
    for name in names:
        module, function = SUITES[name]
        yield from getattr(import_module(f'bench.speed.{module}'), function)(robot, gains, quick)


def table(measurements):
    """Return Measurements as aligned lines of text."""
    rows = [(m.suite, m.name, f'{m.value:.4g}', m.unit, _target(m), m.note)
            for m in measurements]
    rows.insert(0, ('suite', 'what', 'value', 'unit', 'target', ''))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    return '\n'.join(
        f'{row[0]:<{widths[0]}}  {row[1]:<{widths[1]}}  {row[2]:>{widths[2]}} '
        f'{row[3]:<{widths[3]}}  {row[4]:<{widths[4]}}  {row[5]}'.rstrip() for row in rows)


def _target(m):
    if m.target is None:
        return ''
    return f'{">=" if m.at_least else "<="} {m.target:g} {m.verdict}'
