# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Pictures of an identification for print, as the paper's Figs. 3 and 4."""

from gms_flex_control.reports.figures import COLOURS, finished, WIDTH
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

DIRECTIONS = ((1.0, 'forward', COLOURS[0]), (-1.0, 'backward', COLOURS[1]))
MOST_LOOPS = 6    # drawn in one picture


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


def residuals(result):
    """Return velocity, measured less modelled torque and held_out of all traces, (T,) each."""
    if not result.traces:
        return np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)
    velocity, residual, out = (np.concatenate(columns) for columns in zip(*(
        (trace.velocity, trace.measured - trace.model, trace.held_out)
        for trace in result.traces), strict=True))
    good = np.isfinite(velocity) & np.isfinite(residual)
    return velocity[good], residual[good], out[good].astype(bool)
