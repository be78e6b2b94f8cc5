# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Pictures of a discrepancy: the gap, the evidence of each effect, maps of the residual."""

from gms_flex_control.discrepancy.describe import angle_scale, torque_scale
from gms_flex_control.reports.figures import COLOURS, finished, WIDTH
from gms_flex_control.reports.identification_figures import side_by_side
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

_MOST_POINTS = 4000
_COLUMNS = 4          # of panels over each variable
_CLEAR = 0.99         # of what is drawn there: the farthest bins are cut
# one colour for one model in every picture and chart
GIVEN, BEFORE, AFTER, FLOOR = '0.65', COLOURS[1], COLOURS[0], '0.35'
OWN = COLOURS[2]
WITHOUT, WITH = 'without effects', 'with effects'


def gap_figure(gap):
    """
    Return the gap between model and measurement on data held out, joint by joint.

    Parameters
    ----------
    gap : Gap
        Of n joints.

    Returns
    -------
    matplotlib.figure.Figure
        Residual torque in motion and free-run error.

    """
    figure, panels = side_by_side(2, height=1.6 + 0.75 * len(gap.joints))
    torque = torque_scale(gap.before)
    angle = angle_scale(gap.free_before)
    _bars(panels[0], gap.joints, torque, (
        ('as given', gap.before, GIVEN), (WITHOUT, gap.retuned, BEFORE),
        (WITH, gap.after, AFTER),
        ('noise floor', gap.floor, FLOOR)))
    _bars(panels[1], gap.joints, angle, (
        (WITHOUT, gap.free_before, BEFORE),
        (WITH, gap.free_after, AFTER),
        ('noise floor', gap.free_floor, FLOOR)))
    finished(figure, panels, 'Between model and measurement, on held-out data')
    panels[0].set_xlabel(f'residual torque in motion, rms [{torque.unit}]')
    panels[1].set_xlabel(f'free-run error over 0.5 s, rms [{angle.unit}]')
    for panel in panels:
        panel.tick_params(axis='y', which='both', left=False, right=False)
        panel.set_xlim(left=0.0, right=1.18 * panel.dataLim.xmax or 1.0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=4, fontsize=8,
                  frameon=False)
    return figure


def _bars(panel, joints, scale, groups):
    height, at = 0.8 / len(groups), np.arange(len(joints), dtype=float)
    for i, (name, values, colour) in enumerate(groups):
        drawn = panel.barh(at + (i - 0.5 * (len(groups) - 1)) * height,
                           scale.factor * np.nan_to_num(values), 0.9 * height, color=colour,
                           label=name)
        panel.bar_label(drawn, [scale.text(value) for value in values], fontsize=7.5,
                        padding=2)
    panel.set_yticks(at, joints, parse_math=False)
    panel.invert_yaxis()


def evidence_figure(evidence):
    """
    Return the residual over an effect's own variable, without it and with it.

    Parameters
    ----------
    evidence : Evidence
        Of one effect.

    Returns
    -------
    matplotlib.figure.Figure
        Samples, binned means with 95 % bands, and what the effect itself contributes.

    """
    figure = Figure(figsize=(WIDTH, 3.6), layout='constrained')
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    step, scale = max(1, len(evidence.x) // _MOST_POINTS), torque_scale(evidence.y)
    size = scale.factor
    panel.plot(evidence.x[::step], size * evidence.y[::step], '.', color=COLOURS[4],
               markersize=1.8, alpha=0.35, zorder=1)
    panel.axhline(0.0, color='0.6', linewidth=0.6)
    for curve, colour, name in ((evidence.before, BEFORE, 'without the effect'),
                                (evidence.after, AFTER, 'with it')):
        panel.fill_between(curve.x, size * (curve.mean - curve.half),
                           size * (curve.mean + curve.half), color=colour, alpha=0.3, linewidth=0)
        panel.plot(curve.x, size * curve.mean, color=colour, label=name)
    panel.plot(evidence.own.x, size * evidence.own.mean, '--', color=OWN,
               label='the effect itself')
    _within(panel, evidence, size)
    panel.legend(loc='best', ncols=3)
    finished(figure, [panel], f'{evidence.effect} of {evidence.joint}')
    panel.set_title(f'torque {evidence.title}', fontsize=9, parse_math=False)
    panel.set_xlabel(evidence.x_label, parse_math=False)
    panel.set_ylabel(f'torque [{scale.unit}]')
    return figure


def _within(panel, evidence, size):
    """Show the curves and nearly all samples, not the farthest ones."""
    low, high = size * np.quantile(evidence.y, (0.01, 0.99))
    for curve in (evidence.before, evidence.after, evidence.own):
        low = min(low, size * np.min(curve.mean - curve.half, initial=0.0))
        high = max(high, size * np.max(curve.mean + curve.half, initial=0.0))
    margin = 0.15 * (high - low) or 1.0
    panel.set_ylim(low - margin, high + 1.5 * margin)


def maps_figure(maps, joint):
    """
    Return maps of a joint's residual, before in the upper row and after in the lower one.

    Parameters
    ----------
    maps : sequence of Map
        One per column.
    joint : str
        Its name.

    Returns
    -------
    matplotlib.figure.Figure

    """
    figure = Figure(figsize=(WIDTH, 4.8), layout='constrained')
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, len(maps), squeeze=False, sharex='col', sharey='col')
    scale = torque_scale([np.nan_to_num(one.before).ravel().max(initial=0.0) for one in maps])
    largest = scale.factor * max(_usual(values) for one in maps
                                 for values in (one.before, one.after)) or 1.0
    for one, (upper, lower) in zip(maps, panels.T, strict=True):
        for panel, values in ((upper, one.before), (lower, one.after)):
            drawn = panel.pcolormesh(one.x_edges, one.y_edges, scale.factor * values.T,
                                     cmap='RdBu_r', vmin=-largest, vmax=largest, rasterized=True)
            panel.set_facecolor('0.85')
            panel.tick_params(labelsize=8)
            panel.set_ylabel(one.y_label, fontsize=8)
        upper.set_title(one.title, fontsize=9)
        lower.set_xlabel(one.x_label, fontsize=8)
    figure.colorbar(drawn, ax=panels, location='bottom', shrink=0.6, aspect=40).ax.tick_params(
        labelsize=8)
    figure.suptitle(f'{joint}: missing torque [{scale.unit}]\n{WITHOUT} (above), {WITH} (below)',
                    fontsize=10, parse_math=False)
    return figure


def _usual(values):
    """Return the size of all but the largest of what is neither unknown nor chance; else 0."""
    sizes = np.abs(values)[np.abs(values) > 0.0]
    return float(np.quantile(sizes, 0.98)) if sizes.size else 0.0


def over_figure(found):
    """
    Return the residual of one equation over each variable, with 95 % bands.

    Parameters
    ----------
    found : sequence of Over
        Of one joint and equation.

    Returns
    -------
    matplotlib.figure.Figure

    """
    rows = -(-len(found) // _COLUMNS)
    figure = Figure(figsize=(9.0, 2.0 * rows + 0.9))
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, _COLUMNS, squeeze=False, sharey=True)
    scale = torque_scale(np.concatenate([one.before.mean for one in found]))
    farthest = np.concatenate([np.abs(curve.mean) + curve.half
                               for one in found for curve in (one.before, one.after)])
    limit = 1.1 * scale.factor * np.quantile(farthest, _CLEAR) if len(farthest) else 1.0
    for one, panel in zip(found, panels.flat, strict=False):
        panel.axhline(0.0, color='0.6', linewidth=0.6)
        for curve, colour in ((one.before, BEFORE), (one.after, AFTER)):
            low, high = (scale.factor * (curve.mean + side * curve.half) for side in (-1.0, 1.0))
            panel.fill_between(curve.x, low, high, color=colour, alpha=0.3, linewidth=0)
            panel.plot(curve.x, scale.factor * curve.mean, color=colour, linewidth=1.0)
        panel.set_xlabel(one.variable, fontsize=8, labelpad=1)
        panel.tick_params(labelsize=7)
        panel.locator_params(axis='x', nbins=5)
        panel.ticklabel_format(axis='x', scilimits=(-2, 4), useMathText=True)
        panel.xaxis.get_offset_text().set_fontsize(7)
        panel.set_ylim(-(limit or 1.0), limit or 1.0)
    for panel in panels.flat[len(found):]:
        panel.set_axis_off()
    for panel in panels[:, 0]:
        panel.set_ylabel(f'[{scale.unit}]', fontsize=8)
    figure.suptitle(f'{found[0].joint}: torque missing in the {found[0].equation} equation, means '
                    f'with 95 % bands,\n{WITHOUT} (orange), {WITH} (blue)', fontsize=10,
                    parse_math=False)
    figure.subplots_adjust(left=0.07, right=0.985, bottom=0.16 / rows, top=1.0 - 0.8 / (
        2.0 * rows + 0.9), hspace=0.62, wspace=0.08)
    return figure
