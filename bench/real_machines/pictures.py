# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""One picture per machine: what torque is left on the data held out, over time and speed."""

from bench.real_machines.machines import MACHINES
from matplotlib.figure import Figure
import numpy as np

# the pictures that docs/real_machines.md shows, of the first split of each machine
NAMES = {
    'emps': 'real_emps.png', 'kr300_axis1': 'real_kr300_axis1.png',
    'kr300_axis2': 'real_kr300_axis2.png', 'kr300_axis3': 'real_kr300_axis3.png',
    'xl330': 'real_xl330.png', 'arts_friction_damper': 'real_arts_friction_damper.png',
    'odri_motor': 'real_odri_motor.png'}
_SPEED = 'rate', 'speed'
_OVER = {'arts_friction_damper': ('angle', 'displacement')}
_UNITS = {'mrad': {'rate': 'rad/s', 'angle': 'rad'}, 'mm': {'rate': 'm/s', 'angle': 'm'}}
_BINS = 24
_FEWEST = 5        # samples in a bin
_GAP = 0.1         # without samples: the axis stands, and the line is broken [s]
_LINES = (('identified', '#999999'), ('library', '#e69f00'), ('final', '#0072b2'))
_LABELS = {'identified': 'identified', 'library': 'least squares (b)', 'final': 'final'}


def draw(outcome, path):
    """Draw the residual torque of an Outcome as PNG."""
    machine, shown = MACHINES[outcome.machine], outcome.pictured
    figure = Figure(figsize=(9.0, 2.8), layout='constrained')
    over_time, over_other = figure.subplots(1, 2, width_ratios=(2, 1))
    over, words = _OVER.get(machine.name, _SPEED)
    for name, color in _LINES:
        left = machine.factor * shown[name]
        over_time.plot(*broken(shown['time'], left), color=color, lw=0.8, label=_LABELS[name])
        over_other.plot(*binned(shown[over], left), color=color, lw=1.2)
    over_time.set_title(f'{machine.title}, {outcome.bands[0].band:g} Hz', loc='left',
                        fontsize=9)
    over_time.set(xlabel='time [s]', ylabel=f'residual torque [{machine.unit}]')
    over_other.set_title('mean', fontsize=9)
    over_other.set(xlabel=f'{words} [{_UNITS[machine.length[0]][over]}]')
    for axes in (over_time, over_other):
        axes.axhline(0.0, color='black', lw=0.5)
        axes.spines[['top', 'right']].set_visible(False)
    over_time.legend(fontsize=8, ncols=3, handlelength=1.0, columnspacing=1.0,
                     loc='lower right', bbox_to_anchor=(1.0, 0.98), frameon=False)
    figure.savefig(path, dpi=100)


def broken(time, values):
    """Return times and values (S,) with NaN in each gap."""
    after = np.flatnonzero(np.diff(time) > _GAP) + 1
    return np.insert(time, after, np.nan), np.insert(values, after, np.nan)


def binned(values, torque):
    """Return centre and mean torque of bins of ``values`` that hold enough samples."""
    edges = np.linspace(*np.quantile(values, (0.01, 0.99)), _BINS + 1)
    place = np.digitize(values, edges) - 1
    inside = (place >= 0) & (place < _BINS)
    count = np.bincount(place[inside], minlength=_BINS)
    total = np.bincount(place[inside], torque[inside], _BINS)
    mean = np.where(count >= _FEWEST, total / np.maximum(count, 1), np.nan)
    return 0.5 * (edges[1:] + edges[:-1]), mean
