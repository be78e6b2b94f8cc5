# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Tuned gains as tables, plain values, a picture and the controller's file."""

import math
from pathlib import Path

from gms_flex_control.answer import align, Answer, command, measured
from gms_flex_control.file_io import plain
from gms_flex_control.params.gains import GAINS
from gms_flex_control.reports.figure_style import COLOURS, finished, panels_of, STYLES, WIDTH
from gms_flex_control.schema.build import controller_values
from gms_flex_control.tuning.linear_loop import linear_loop
from gms_flex_control.tuning.margins import joint_margins, open_loop, poses
from gms_flex_control.tuning.propose import link_bandwidth
from gms_flex_control.tuning.study import MOTIONS
from matplotlib.figure import Figure
import numpy as np

_KINDS = {'gershgorin': 'Gershgorin', 'exact': 'exact, N_2 > 0'}


def gains_table(gains, robot) -> str:
    """Return the gains and the link's bandwidth, a row per joint, as text."""
    speed = link_bandwidth(gains, robot)
    rows = [[joint, *(f'{getattr(gains, name)[j]:.4g}' for name in GAINS[:4]),
             f'{speed[j]:.3g}'] for j, joint in enumerate(robot.joints)]
    return align(['joint', 'kd_link', 'lambda_link', 'kd_motor', 'lambda_motor',
                  'link bandwidth [rad/s]'], rows)


def margins_table(judgement, robot) -> str:
    """Return the worst margins of all poses, a row per joint, as text."""
    rows = [[joint, f'{one.gain_up:.3g}', f'{one.gain_down:.2g}',
             f'{math.degrees(one.phase):.1f}', f'{one.distance:.2f}', f'{one.crossover:.0f}',
             f'{judgement.jitter.torque[j]:.3g}', f'{1e3 * judgement.jitter.angle[j]:.2g}']
            for j, (joint, one) in enumerate(zip(robot.joints, judgement.joints, strict=True))]
    return align(['joint', 'gain up', 'down', 'phase [deg]', 'least |1 + L|', 'crossover [rad/s]',
                  'encoder torque [N m]', 'jitter [mrad]'], rows)


def loop_lines(judgement, timing) -> list:
    """Return delay margin and ringing as lines of text."""
    delay = ('more than 50 samples' if math.isinf(judgement.delay)
             else f'{1e3 * judgement.delay:.2f} ms')
    ringing = f'decay at {judgement.ringing:.2g} 1/s or faster'
    if judgement.ringing < 0.0:
        ringing = f'grow at {-judgement.ringing:.2g} 1/s until blocks slip'
    return [f'further delay until unstable, all joints: {delay} (already there: '
            f'{1e3 * timing.delay:.3g} ms, and the hold of {1e3 * timing.period:.3g} ms)',
            f'while every block sticks, oscillations {ringing}']


def answer_of(proposal, trials, robot, demands, files, folder) -> Answer:
    """Return what error to expect of a Proposal, and its margin (Answer)."""
    missed = (f'These gains miss {len(proposal.unmet)} '
              f'requirement{"s" * (len(proposal.unmet) > 1)} (NOT MET, above).')
    if not trials:
        return Answer(missed, (), (), command('tune', '--help'))
    mode, judgement, count = list(trials)[-1], proposal.judgement, robot.n_joints
    rms, peak = ([_worse(trials[name], figure, count) for name in ('none', mode)]
                 for figure in ('rms', 'peak'))
    worst = int(np.argmax(rms[1]))
    phase = min(one.phase for one in judgement.joints)
    numbers = tuple(
        measured(f'{label} of {robot.joints[worst]} [mrad]', *(one[worst] for one in error),
                 judgement.jitter.angle[worst])
        for label, error in (('rms error', rms), ('largest error', peak))) + (
        measured('phase margin [deg]', None, math.degrees(phase), math.degrees(demands.phase),
                 scale=1.0),)
    columns = 'none', mode, 'noise floor, or least required'
    if proposal.unmet:
        return Answer(missed, columns, numbers, command('tune', '--help'))
    again = ('--robot', *files, '--trajectory', Path(folder) / 'trajectory.yaml') if files else ()
    return Answer(
        f'With these gains and compensation {mode} the links follow within {numbers[0].after} '
        'mrad (rms) in simulation, and the loop keeps the required margins; the noise floor is '
        'the motion of the links that encoder noise alone causes.', columns, numbers, command(
            'simulate', *again, '--controller', Path(folder) / 'controller.yaml', '--out',
            Path(folder) / 'trial'))


def _worse(trials, figure, count):
    """Return a figure of each joint, of the worse motion; infinite where one was lost."""
    return np.max([[np.inf] * count if one.lost else getattr(one, figure)
                   for one in trials.values()], axis=0)


def expected_lines(trials, judgement, robot) -> list:
    """Return what error of the links to expect of the last mode of ``trials``, as lines."""
    mode = list(trials)[-1]
    rms, peak = (1e3 * _worse(trials[mode], name, robot.n_joints) for name in ('rms', 'peak'))
    errors = '; '.join(f'{joint} ' + (f'{rms[j]:.3g} mrad rms, {peak[j]:.3g} at most'
                                      if np.isfinite(rms[j]) else 'lost')
                       for j, joint in enumerate(robot.joints))
    held = ', '.join(f'{joint} {1e3 * value:.3g} mrad' for joint, value in zip(
        robot.joints, judgement.held, strict=True))
    return [f'expected error, {mode}, the worse motion: {errors}',
            f'error that static friction can hold without compensation: {held}']


def conditions_text(report) -> str:
    """Return a GainReport as a table and a few lines."""
    rows = []
    for c in report.conditions:
        verdict = 'ok' if c.met else 'VIOLATED'
        if not c.met and c.kind == 'gershgorin':
            verdict = 'not met (sufficient only)'
        rows.append((c.joint, f'{c.condition}  ({_KINDS[c.kind]})', f'{c.value:.5g}',
                     f'{c.limit:.5g}', verdict))
    alphas = ', '.join(f'{joint} {alpha:.5g}'
                       for joint, alpha in zip(report.joints, report.alpha, strict=True))
    low, high = report.mass_range
    bottom, top = report.energy_range
    table = [align(('joint', 'condition', 'value', 'limit', 'verdict'), rows), ''] if rows else []
    return '\n'.join([
        *table,
        f'alpha, smallest eigenvalue of N_2 (37): {alphas}',
        f'eigenvalues over all configurations: M {low:.5g} to {high:.5g} kg m^2, '
        f'N_1 (34) {bottom:.5g} to {top:.5g}',
        *_bound_lines(report)])


def _bound_lines(report):
    """Return the residual set (43) of a GainReport, and what it is worth, as lines of text."""
    if not math.isfinite(report.residual):
        return ['residual set (43): none, because N_2 is not positive definite; stability is not '
                'guaranteed']
    bottom, top = report.energy_range
    pushed, spread = report.disturbance / report.alpha.min(), math.sqrt(top / bottom)
    return [
        'residual set (43): the norm of all errors together (angles, rates, block torques) ends '
        f'below {report.residual:.4g}.',
        '  Not a prediction: it assumes the largest error of all friction, at once and for ever, '
        'against the weakest',
        f'  damping (D_bar / alpha = {report.disturbance:.4g} / {report.alpha.min():.4g} = '
        f'{pushed:.3g}), and all of that energy in the lightest',
        f'  error (sqrt(lmax / lmin of N_1) = {spread:.3g}). Simulate what to expect: gms_flex '
        'tune, simulate']


def trials_table(trials, robot) -> str:
    """Return simulated figures as text; ``trials`` is mode -> motion -> Trial."""
    rows = []
    for motion in MOTIONS:
        for mode, found in trials.items():
            for j, joint in enumerate(robot.joints):
                rows.append([motion, mode, joint, *_trial_cells(found[motion], j)])
    return align(['motion', 'compensation', 'joint', 'rms error [mrad]', 'largest',
                  'at rest p-p', 'rms torque [N m]'], rows)


def _trial_cells(trial, j):
    if trial.lost:
        return ['lost', '-', '-', '-']
    hold = '-' if trial.hold is None else f'{1e3 * trial.hold[j]:.3g}'
    return [f'{1e3 * math.sqrt(trial.mse[j]):.3g}', f'{1e3 * trial.peak[j]:.3g}', hold,
            f'{trial.torque[j]:.3g}']


def verify_text(found, robot) -> str:
    """Return the summary of a Monte-Carlo, from `uncertainty.summary`, as text."""
    rows = []
    for name, spread in [*found['rms'].items(), ('at rest p-p', found['hold'])]:
        if spread is None:
            continue
        label = f'{name}, rms error' if name in MOTIONS else name
        rows += [[label, joint, *(f'{1e3 * spread[key][j]:.3g}' for key in ('median', 'worst')),
                  str(spread['worst_draw'][j])] for j, joint in enumerate(robot.joints)]
    margins = ', '.join(f'{joint} {gain:.3g} times and {math.degrees(phase):.1f} degrees'
                        for joint, gain, phase in zip(robot.joints, found['gain'],
                                                      found['phase'], strict=True))
    return '\n'.join([
        align(['figure [mrad]', 'joint', 'median', 'worst', 'in draw'], rows),
        f"{found['draws']} robots: {len(found['unstable'])} with an unstable linear loop, "
        f"{len(found['lost'])} lost in simulation", f'least margins: {margins}'])


def as_values(proposal, robot, timing, trials) -> dict:
    """Return a proposal as plain values for JSON."""
    judgement = proposal.judgement
    report = judgement.conditions
    return plain({
        'met': not proposal.unmet, 'unmet': list(proposal.unmet),
        'gains': controller_values(proposal.gains, robot.joints),
        'timing': timing._asdict(), 'conditions': [
            one.__dict__ | {'met': one.met} for one in report.conditions],
        'margins': {joint: one._asdict() for joint, one in zip(
            robot.joints, judgement.joints, strict=True)},
        'delay_margin': judgement.delay, 'stable': judgement.stable,
        'encoder_torque': judgement.jitter.torque,
        'encoder_jitter': judgement.jitter.angle,
        'stuck_decay': judgement.ringing, 'residual_bound': report.residual,
        'held_error': judgement.held,
        'trials': {mode: {motion: one._asdict() for motion, one in found.items()}
                   for mode, found in trials.items()}})


def tuning_figure(robot, gains, timing) -> Figure:
    """Return the response of each joint's stable loop in all poses, the others closed."""
    figure, ((upper,), (lower,)) = panels_of(2, 1, (WIDTH, 4.6), sharex=True)
    # [rad/s]; at half the sample rate the hold takes everything away
    grid = np.geomspace(0.5, 0.95 * np.pi / timing.period, 400)
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
    upper.set_xlim(grid[0], grid[-1])
    upper.legend()
    finished(figure, (upper, lower), f'Loop of each joint, {1.0 / timing.period:.0f} Hz, '
             f'{1e3 * timing.delay:g} ms of delay, in all poses')
    lower.set_xlabel('frequency [rad/s]')
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
