# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Picture of a tuned loop: frequency response of every joint in all poses, with its margins."""

from gms_flex_control.reports.figures import COLOURS, STYLES, WIDTH
from gms_flex_control.tuning.linear_loop import linear_loop
from gms_flex_control.tuning.margins import joint_margins, open_loop, poses
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

_LOWEST, _COUNT = 0.5, 400  # frequencies [rad/s]
_HIGHEST = 0.95             # of half the sample rate: there the hold takes everything away


def tuning_figure(robot, gains, timing):
    """
    Return the response of each joint's loop, the others closed.

    Parameters
    ----------
    robot : RobotParams
        The robot, also as believed.
    gains : ControllerParams
        With which the loop is stable.
    timing : Timing
        Sample and delay.

    Returns
    -------
    matplotlib.figure.Figure
        Magnitude and phase; a thin line per pose, a dot at each crossover.

    """
    figure = Figure(figsize=(WIDTH, 4.6), layout='constrained')
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True)
    grid = np.geomspace(_LOWEST, _HIGHEST * np.pi / timing.period, _COUNT)
    for pose in poses(robot.arm):
        loop = linear_loop(robot, robot, gains, timing, pose)
        for j in range(robot.n_joints):
            _draw(upper, lower, loop, j, grid)
    for j, joint in enumerate(robot.joints):
        upper.plot([], [], STYLES[j % len(STYLES)], color=COLOURS[j % len(COLOURS)], label=joint)
    upper.axhline(1.0, color='0.3', linewidth=0.8)
    lower.axhline(-180.0, color='0.3', linewidth=0.8)
    upper.set_ylabel('|L|')
    lower.set_ylabel('phase [deg]')
    lower.set_xlabel('frequency [rad/s]')
    upper.legend(frameon=False, fontsize=8.5)
    for panel in (upper, lower):
        panel.grid(color='0.9', linewidth=0.6)
        panel.tick_params(which='both', direction='in', top=True, right=True, labelsize=9)
        panel.set_xlim(grid[0], grid[-1])
    figure.suptitle(f'Loop of each joint, {1.0 / timing.period:.0f} Hz, '
                    f'{1e3 * timing.delay:g} ms of delay, in all poses', fontsize=11)
    return figure


def _draw(upper, lower, loop, j, grid):
    style = {'color': COLOURS[j % len(COLOURS)], 'linewidth': 0.9}
    response = open_loop(loop, j, grid)
    phase = np.degrees(np.unwrap(np.angle(response)))
    phase -= 360.0 * np.round((phase[0] + 180.0) / 360.0)
    line = STYLES[j % len(STYLES)]
    upper.loglog(grid, np.abs(response), line, **style)
    lower.semilogx(grid, phase, line, **style)
    crossover = joint_margins(loop, j).crossover
    if crossover > 0.0:
        lower.plot(crossover, np.interp(crossover, grid, phase), 'o', markersize=3.5,
                   color=style['color'])
