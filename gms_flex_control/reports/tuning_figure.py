# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A tuned loop: the answer, and the frequency response of every joint in all poses."""

import math
from pathlib import Path

from gms_flex_control.reports.answer import Answer, command, measured
from gms_flex_control.reports.figures import COLOURS, STYLES, WIDTH
from gms_flex_control.tuning.linear_loop import linear_loop
from gms_flex_control.tuning.margins import joint_margins, open_loop, poses
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

_LOWEST, _COUNT = 0.5, 400  # frequencies [rad/s]
_HIGHEST = 0.95             # of half the sample rate: there the hold takes everything away


def tuning_answer(proposal, trials, robot, demands, files, folder):
    """
    Return what error to expect of proposed gains, and their margin.

    Parameters
    ----------
    proposal : Proposal
        The gains.
    trials : dict
        Of simulation, mode -> motion -> Trial; the last mode is the one that is meant.
    robot : RobotParams
        Names the joints.
    demands : Demands
        What was asked.
    files : sequence of str
        Of the robot, if not the arm of the paper.
    folder : str or Path
        Of the results.

    Returns
    -------
    Answer

    """
    mode, judgement = list(trials)[-1], proposal.judgement
    rms, peak = ({name: _worse(trials[name].values(), figure, robot.n_joints)
                  for name in ('none', mode)} for figure in ('mse', 'peak'))
    worst = int(np.argmax(rms[mode]))
    joint, phase = robot.joints[worst], min(one.phase for one in judgement.joints)
    numbers = (
        measured(f'rms error of {joint} [mrad]', *(
            math.sqrt(rms[name][worst]) for name in ('none', mode)),
               judgement.jitter.angle[worst]),
        measured(f'largest error of {joint} [mrad]', *(peak[name][worst] for name in ('none', mode)),
               judgement.jitter.angle[worst]),
        measured('phase margin [deg]', None, math.degrees(phase), math.degrees(demands.phase),
               scale=1.0))
    columns = 'none', mode, 'noise floor, or least asked'
    if proposal.unmet:
        return Answer(f'No gains meet what is asked: {"; ".join(proposal.unmet)}.', columns,
                      numbers, command('tune', '--help'))
    return Answer(
        f'With these gains and {mode} the links follow within '
        f'{1e3 * math.sqrt(rms[mode][worst]):.3g} mrad (rms) in simulation, and the loop keeps the '
        'margins asked for; the noise floor is what encoder noise alone shakes the links by.',
        columns, numbers, command(
            'simulate', *(('--robot', *files) if files else ()), '--controller', Path(folder) / 'controller.yaml', '--out',
            Path(folder) / 'trial'))


def _worse(found, figure, count):
    """Return a figure of each joint, of the worse motion; infinite where one was lost."""
    return np.max([[np.inf] * count if one.lost else getattr(one, figure) for one in found],
                  axis=0)


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
