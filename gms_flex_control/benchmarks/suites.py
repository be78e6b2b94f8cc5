# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The suites of the benchmark by name, and their figures as text."""

from importlib import import_module
from importlib.util import find_spec

from gms_flex_control.benchmarks.timing import Measurement

# suite: module and function (robot, gains, quick) -> list of Measurement
SUITES = {
    'loop': ('core', 'measure_loop'),
    'step': ('core', 'measure_step'),
    'tick': ('core', 'measure_tick'),
    'ros': ('ros_loop', 'measure'),
    'view': ('view_live', 'measure'),
    'fit': ('identification', 'measure_fit'),
    'identify': ('identified_bag', 'measure'),
    'effects': ('effect_dispatch', 'measure'),
    'arguments': ('kernel_arguments', 'measure'),
    'batches': ('batches', 'measure'),
    'export': ('mujoco_export', 'measure'),
}
# the others support decisions in docs/decisions
DEFAULT = ('loop', 'step', 'tick', 'ros', 'fit', 'identify')


def run(names, robot, gains, quick=False):
    """
    Yield the figures of suites, one suite after the other.

    Parameters
    ----------
    names : sequence of str
        Keys of SUITES.
    robot : RobotParams
        The robot.
    gains : ControllerParams
        Of its controller.
    quick : bool
        Rough figures in a few seconds.

    Yields
    ------
    Measurement

    """
    for name in names:
        module, function = SUITES[name]
        path = f'{__package__}.{module}'
        if find_spec(path) is None:
            continue
        yield from getattr(import_module(path), function)(robot, gains, quick)


def table(measurements):
    """Return Measurements as aligned lines of text."""
    rows = [(m.suite, m.name, f'{m.value:.4g}', m.unit, _target(m), m.note)
            for m in measurements]
    rows.insert(0, ('suite', 'what', 'value', 'unit', 'target', ''))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    return '\n'.join(
        f'{row[0]:<{widths[0]}}  {row[1]:<{widths[1]}}  {row[2]:>{widths[2]}} '
        f'{row[3]:<{widths[3]}}  {row[4]:<{widths[4]}}  {row[5]}'.rstrip() for row in rows)


def _target(m: Measurement):
    if m.target is None:
        return ''
    return f'{">=" if m.at_least else "<="} {m.target:g} {m.verdict}'
