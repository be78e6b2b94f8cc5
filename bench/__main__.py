# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The tool `python -m bench`: verbs, errors and exit codes as those of `gms_flex`."""

from importlib import import_module
import sys

from gms_flex_control.cli.main import main as run_tool
from gms_flex_control.cli.main import parser_of

PROG = 'python -m bench'
GROUPS = {
    'on this machine': {'speed': 'bench.speed.speed', 'growth': 'bench.growth',
                        'faults': 'bench.faults.faults'},
    'on robots that are simulated': {
        'recover': 'bench.recover', 'coverage': 'bench.coverage',
        'paper-method': 'bench.paper_method.paper_method',
        'hide': 'bench.hidden_robots.hide', 'score': 'bench.hidden_robots.score',
        'hidden-arms': 'bench.hidden_arms.hidden_arms',
        'base-parameters': 'bench.hidden_arms.base_parameters', 'learn': 'bench.learn',
        'next': 'bench.next'},
    'over ROS 2': {'demo-identify': 'bench.demos.identify',
                   'demo-discrepancy': 'bench.demos.discrepancy',
                   'demo-next': 'bench.demos.separate'},
    'on recordings of real ones': {'real-machines': 'bench.real_machines.real_machines',
                                   'real-arm': 'bench.real_arm'}}
EXAMPLES = {verb: [f'{PROG} {verb} {options}'.rstrip() for options in each]
            for verb, each in {
    'speed': ('--quick', '--only loop step --json'),
    'growth': ('--verbs identify', '--out growth'),
    'faults': ('--list', '--short --logs fault_logs'),
    'recover': ('--seeds 3', '--seeds 20 --out recovery'),
    'coverage': ('--seeds 100:104 --out coverage',),
    'paper-method': ('demo_identify_output/bag', 'my_bag --robot robot.yaml'),
    'hide': ('--effect backlash --out hidden', '--kind single double --seeds 0:5 --out hidden'),
    'score': ('--out quick', '--kind single --seeds 0:20 --no-peers --out singles'),
    'hidden-arms': ('--seeds 0:5 --kinds single clean', '--arms light --seeds 10:20 --identified'),
    'base-parameters': ('', '--seeds 0:5'),
    'learn': ('--seeds 0:1 --clean 0:2 --machines --out learned', '--out learned'),
    'next': ('--seeds 0:1 --out next', '--families "lag, delay" --seeds 0:4 --out lag'),
    'demo-identify': ('--out demo_identify_output',),
    'demo-discrepancy': ('--seed 3', '--effect position_friction --duration 30 --out found'),
    'demo-next': ('', '--seed 3 --out separated'),
    'real-machines': ('--first', 'kr300_axis1 --out bench_real_output'),
    'real-arm': ('', '--data tx40 --out tx40.json')}.items()}


def build_parser():
    """Return the parser with all verbs."""
    return parser_of(PROG, 'Measure the package: its speed, what faults do to its nodes, what it '
                     'finds in hidden robots and in recordings of real machines.',
                     {title: {verb: import_module(place).add_parser
                              for verb, place in group.items()}
                      for title, group in GROUPS.items()}, EXAMPLES)


def main(argv=None):
    """Run one verb with arguments, default those of the command line; return the exit code."""
    return run_tool(argv, PROG, build_parser)


if __name__ == '__main__':
    sys.exit(main())
