# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Pictures of an identification, as the paper's Figs. 3 and 4 and beyond."""

from gms_flex_control.identification.words import floor_shares, short_label
from gms_flex_control.reports.figures import COLOURS, finished, MAX_SAMPLES, WIDTH
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np

DIRECTIONS = ((1.0, 'forward', COLOURS[0]), (-1.0, 'backward', COLOURS[1]))
MOST_LOOPS = 6    # drawn in one picture
_MOST_POINTS = 4000


def side_by_side(count, height=3.2):
    """Return a figure and ``count`` axes beside each other."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, count, squeeze=False)[0]


def _labelled(figure, panels, labels, title):
    finished(figure, panels, title)
    for panel, (x, y) in zip(panels, labels, strict=True):
        panel.set_xlabel(x, parse_math=False)
        panel.set_ylabel(y, parse_math=False)
    return figure


def map_figure(result, reference=None):
    """
    Return friction over velocity with the fitted Stribeck curves (paper, Fig. 3).

    Parameters
    ----------
    result : JointResult
        Of one joint.
    reference : ndarray, shape (V,), optional
        Steady friction known otherwise, at ``result.steady_velocity`` [N m].

    Returns
    -------
    matplotlib.figure.Figure
        Over velocity, and of both directions over the logarithm of speed.

    """
    figure, (linear, log) = side_by_side(2)
    measured, fit = result.friction_map, result.steady_velocity
    for sign, name, colour in DIRECTIONS:
        for steady, face in ((False, 'none'), (True, colour)):
            rows = (sign * measured.velocity > 0.0) & (measured.steady == steady)
            look = {'color': colour, 'markerfacecolor': face, 'markersize': 2.6,
                    'markeredgewidth': 0.5, 'alpha': 0.8 if steady else 0.45}
            linear.plot(measured.velocity[rows], measured.torque[rows], 'o', **look)
            log.plot(sign * measured.velocity[rows], sign * measured.torque[rows], 'o', **look,
                     label=f'{name}, measured' if steady else None)
        rows = sign * fit > 0.0
        for curve, style, label in ((result.steady_torque, '-', f'{name}, fitted'),
                                    (reference, 'k:', None)):
            if curve is not None:
                look = {'color': colour} if label else {}
                linear.plot(fit[rows], curve[rows], style, **look)
                log.plot(sign * fit[rows], sign * curve[rows], style, **look, label=label)
    log.legend(loc='best')
    _labelled(figure, [linear, log], [
        ('velocity [rad/s]', 'friction torque [N m]'),
        ('speed [rad/s]', 'torque against the motion [N m]')],
        f'{result.joint}: friction over velocity (open: velocity not steady)')
    log.set_xscale('log')
    return figure


def loops_figure(result, reference=None):
    """
    Return hysteresis loops (paper, Fig. 4) and the presliding curve with its 95 % band.

    Parameters
    ----------
    result : JointResult
        Of one joint.
    reference : ndarray, shape (D,), optional
        Presliding curve known otherwise, at ``result.curve[0]`` [N m].

    Returns
    -------
    matplotlib.figure.Figure
        Loops, and the curve over the logarithm of displacement.

    """
    figure, (loops, curve) = side_by_side(2)
    for i, loop in enumerate(result.loops[:MOST_LOOPS]):
        loops.plot(1e3 * loop.displacement, loop.torque, color=COLOURS[0], linewidth=0.9,
                   label='measured' if i == 0 else None)
        loops.plot(1e3 * loop.model_displacement, loop.torque, 'k--', linewidth=0.8,
                   label='fitted' if i == 0 else None)
    if result.loops:
        loops.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=2)
    else:
        loops.text(0.5, 0.5, 'no presliding motion in the data', ha='center',
                   transform=loops.transAxes, fontsize=9)
    x, torque, low, high = result.curve
    if len(x):
        curve.fill_between(1e3 * x, low, high, color=COLOURS[0], alpha=0.25, linewidth=0,
                           label='95 % band')
        curve.plot(1e3 * x, torque, color=COLOURS[0], label='fitted')
        if reference is not None:
            curve.plot(1e3 * x, reference, 'k:', label='true')
        curve.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=3)
    _labelled(figure, [loops, curve], [
        ('displacement [mrad]', 'friction torque [N m]'),
        ('displacement from rest [mrad]', 'friction torque [N m]')],
        f'{result.joint}: presliding')
    if len(x):
        curve.set_xscale('log')
    else:
        curve.text(0.5, 0.5, 'no stiffness is identifiable', ha='center',
                   transform=curve.transAxes, fontsize=9)
    return figure


def sliding_figure(trace, joint):
    """
    Return measured and modelled friction of a Trace over time, velocity and residual.

    Parameters
    ----------
    trace : Trace
        Of one joint.
    joint : str
        Its name.

    Returns
    -------
    matplotlib.figure.Figure
        Three panels; held-out time is shaded.

    """
    figure = Figure(figsize=(WIDTH, 5.2), layout='constrained')
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=(2.0, 1.0, 1.0))
    keep = slice(None, None, max(1, int(np.ceil(len(trace.time) / MAX_SAMPLES))))
    time = trace.time[keep]
    panels[0].plot(time, trace.measured[keep], color=COLOURS[5], linewidth=0.8, label='measured')
    panels[0].plot(time, trace.model[keep], 'k', linewidth=1.0, label='model')
    panels[0].legend(loc='upper right', ncols=2)
    panels[1].plot(time, (trace.measured - trace.model)[keep], color=COLOURS[1], linewidth=0.8)
    panels[2].plot(time, trace.velocity[keep], color=COLOURS[2], linewidth=0.9)
    for panel, label in zip(panels, ('friction [N m]', 'residual [N m]', 'velocity [rad/s]'),
                            strict=True):
        panel.set_ylabel(label)
        panel.fill_between(time, 0.0, 1.0, where=trace.held_out[keep], color='0.85', linewidth=0,
                           transform=panel.get_xaxis_transform(), zorder=0)
    return finished(figure, panels,
                    f'{joint}: {short_label(trace.label)} (shaded: held out of the fit)')


def residual_figure(result):
    """Return what the model leaves, over velocity and as a histogram (matplotlib Figure)."""
    figure, (over, share) = side_by_side(2)
    velocity, residual, out = residuals(result)
    for held, colour, name in ((False, COLOURS[5], 'fitted'), (True, COLOURS[1], 'held out')):
        rows = out == held
        step = max(1, rows.sum() // _MOST_POINTS)
        over.plot(velocity[rows][::step], residual[rows][::step], '.', color=colour,
                  markersize=2.0, label=name)
        if rows.any():
            share.hist(residual[rows], bins=60, density=True, histtype='step', color=colour,
                       label=name)
    noise = result.held_out.noise_floor
    if np.isfinite(noise):
        for panel, line in ((over, over.axhline), (share, share.axvline)):
            line(-noise, color='0.3', linestyle=':', linewidth=1.0)
            line(noise, color='0.3', linestyle=':', linewidth=1.0, label='noise floor (rms)')
            panel.margins(x=0)
    over.legend(loc='best', markerscale=3)
    share.xaxis.set_major_locator(MaxNLocator(5))
    return _labelled(figure, [over, share], [
        ('velocity [rad/s]', 'measured − model [N m]'), ('measured − model [N m]', 'density')],
        f'{result.joint}: residual of the friction torque')


def residuals(result):
    """Return velocity, measured less modelled torque and held_out of all traces, (T,) each."""
    if not result.traces:
        return np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)
    velocity, residual, out = (np.concatenate(columns) for columns in zip(*(
        (trace.velocity, trace.measured - trace.model, trace.held_out)
        for trace in result.traces), strict=True))
    good = np.isfinite(velocity) & np.isfinite(residual)
    return velocity[good], residual[good], out[good].astype(bool)


def held_out_figure(results):
    """
    Return the held-out errors of all joints beside Coulomb + viscous alone and the floors.

    Parameters
    ----------
    results : sequence of JointResult
        Of n joints.

    Returns
    -------
    matplotlib.figure.Figure
        Torque in percent of the drive torque, and free-running angle.

    """
    figure, (torque, angle) = side_by_side(2, height=1.5 + 0.75 * len(results))
    errors = [result.held_out for result in results]
    floors = [floor_shares(each) for each in errors]
    _bars(torque, results, (
        ('Coulomb + viscous alone', [100 * each.coulomb_viscous for each in errors], COLOURS[4]),
        ('identified model', [100 * each.relative for each in errors], COLOURS[0]),
        ('repeatability', [100 * repeat for _, repeat in floors], '0.55'),
        ('noise floor', [100 * noise for noise, _ in floors], '0.8')))
    _bars(angle, results, (
        ('Coulomb + viscous alone', [1e3 * each.free_run_coulomb_viscous for each in errors],
         COLOURS[4]),
        ('identified model', [1e3 * each.free_run_rms for each in errors], COLOURS[0])))
    torque.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=2)
    _labelled(figure, [torque, angle], [
        ('torque error [% of drive torque]', ''), ('free-run error [mrad]', '')],
        'Errors on data that took no part in the fit')
    for panel in (torque, angle):
        panel.tick_params(axis='y', which='both', left=False, right=False)
        panel.set_xlim(left=0.0, right=1.18 * panel.dataLim.xmax or 1.0)
    return figure


def _bars(panel, results, groups):
    height = 0.8 / len(groups)
    at = np.arange(len(results), dtype=float)
    for i, (name, values, colour) in enumerate(groups):
        drawn = panel.barh(at + (i - 0.5 * (len(groups) - 1)) * height, np.nan_to_num(values),
                           0.9 * height, color=colour, label=name)
        panel.bar_label(drawn, [f'{value:.3g}' if np.isfinite(value) else 'unknown'
                                for value in values], fontsize=7.5, padding=2)
    panel.set_yticks(at, [result.joint for result in results], parse_math=False)
    panel.invert_yaxis()
