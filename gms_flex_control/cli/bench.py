# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex bench`: how fast everything is on this machine, beside MuJoCo and numpy."""

from dataclasses import asdict
import json
import sys

SUITES = ('loop', 'step', 'tick', 'ros', 'view', 'fit', 'identify', 'effects', 'arguments',
          'batches', 'export')


def add_parser(subparsers):
    """Add the verb to the tool's parser."""
    parser = subparsers.add_parser(
        'bench', help='speed on this machine, beside MuJoCo and numpy',
        description='Measure speed: medians of interleaved repetitions. Compare figures of one '
                    'run only. MuJoCo is measured where the extra "bench" is installed. The '
                    'suites "effects", "arguments" and "batches" are those of docs/decisions '
                    'and docs/scale.md, "export" compares free runs of the exported MJCF with our '
                    'own, effect by effect (docs/export.md), "view" the late samples of the loop '
                    'with and without the page of view live; these run only when asked for.')
    parser.add_argument('--quick', action='store_true', help='rough figures in a few seconds')
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.add_argument('--only', nargs='+', choices=SUITES, metavar='SUITE',
                        help=f'some of: {", ".join(SUITES)}')
    parser.add_argument('--robot', nargs='+', metavar='FILE',
                        help='robot files, later ones winning; default: the arm of the paper')
    parser.add_argument('--controller', metavar='FILE', help='default: the gains of the paper')
    parser.set_defaults(run=run)


def run(args):
    """Measure and print; return 0, or 1 where a target was missed."""
    from gms_flex_control.benchmarks import mujoco_arm, suites
    from gms_flex_control.resources import controller_file, robot_file
    from gms_flex_control.schema.files import load_controller, load_robot

    robot = load_robot(args.robot or robot_file())
    gains = load_controller(args.controller or controller_file(), robot)
    found = list(suites.run(args.only or suites.DEFAULT, robot, gains, args.quick))
    if args.json:
        print(json.dumps([{**asdict(m), 'verdict': m.verdict} for m in found], indent=2))
    else:
        print(suites.table(found))
        if not mujoco_arm.available():
            print("\nMuJoCo is not installed; pip install '.[bench]' in the clone adds it",
                  file=sys.stderr)
    return 1 if any(m.verdict == 'missed' for m in found) else 0
