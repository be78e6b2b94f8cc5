# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Figures for print: identification (the paper's Figs. 3 and 4), discrepancy, planned motion."""

from gms_flex_control.discrepancy.describe import angle_scale, torque_scale
from gms_flex_control.reports import figure_style as style
from gms_flex_control.reports.answers import WITH, WITHOUT
from matplotlib.figure import Figure
import numpy as np

DIRECTIONS = ((1.0, 'forward', style.COLOURS[0]), (-1.0, 'backward', style.COLOURS[1]))
_MOST_POINTS = 4000   # of a cloud
_CLEAR = 0.99         # of what is drawn there: the farthest bins are cut
_LOW_PASS, _SLOW = 8.0, 3.0  # of predicted torques, beside measured ones too [Hz]
# one colour for one model in every picture and chart
AFTER, BEFORE, OWN = style.COLOURS[:3]
GIVEN, FLOOR = '0.65', '0.35'


def map_figure(result) -> Figure:
    """Return friction over velocity of a JointResult, fits dashed beyond the data (Fig. 3)."""
    figure, (linear, log) = style.side_by_side(2)
    measured, fit = result.friction_map, result.steady_velocity
    for sign, name, colour in DIRECTIONS:
        for steady, face in ((False, 'none'), (True, colour)):
            rows = (sign * measured.velocity > 0.0) & (measured.steady == steady)
            look = {'color': colour, 'markerfacecolor': face, 'markersize': 2.6,
                    'markeredgewidth': 0.5, 'alpha': 0.8 if steady else 0.45, 'rasterized': True}
            linear.plot(measured.velocity[rows], measured.torque[rows], 'o', **look)
            log.plot(sign * measured.velocity[rows], sign * measured.torque[rows], 'o', **look,
                     label=f'{name}, measured' if steady else None)
        rows, steady = sign * fit > 0.0, sign * measured.velocity[measured.steady]
        speed, torque = sign * fit[rows], sign * result.steady_torque[rows]
        steady = steady[steady > 0.0]
        seen = (speed >= steady.min()) & (speed <= steady.max()) if len(steady) else speed < 0.0
        for line, shown, label in (('--', torque, None), (
                '-', np.where(seen, torque, np.nan), f'{name}, fitted')):
            linear.plot(sign * speed, sign * shown, line, color=colour)
            log.plot(speed, shown, line, color=colour, label=label)
    log.legend(loc='best')
    style.labelled(figure, [linear, log], [
        ('velocity [rad/s]', 'friction torque [N m]'),
        ('speed [rad/s]', 'torque against the motion [N m]')],
        f'{result.joint}: friction over velocity (open: velocity not steady; dashed: no data)')
    log.set_xscale('log')
    return figure


def loops_figure(result) -> Figure:
    """Return hysteresis loops of a JointResult (Fig. 4) and the presliding curve, 95 % band."""
    figure, (loops, curve) = style.side_by_side(2)
    for i, loop in enumerate(result.loops):
        loops.plot(1e3 * loop.displacement, loop.torque, color=style.COLOURS[0], linewidth=0.9,
                   label='measured' if i == 0 else None)
        loops.plot(1e3 * loop.model_displacement, loop.torque, 'k--', linewidth=0.8,
                   label='fitted' if i == 0 else None)
    above = {'loc': 'lower center', 'bbox_to_anchor': (0.5, 1.0)}
    if result.loops:
        loops.legend(**above, ncols=2)
    else:
        _instead(loops, 'no presliding motion in the data')
    x, torque, low, high = result.curve
    if len(x):
        curve.fill_between(1e3 * x, low, high, color=style.COLOURS[0], alpha=0.25, linewidth=0,
                           label='95 % band')
        curve.plot(1e3 * x, torque, color=style.COLOURS[0], label='fitted')
        curve.legend(**above, ncols=3)
    else:
        _instead(curve, 'no presliding curve is identifiable')
    style.labelled(figure, [loops, curve], [
        ('displacement [mrad]', 'friction torque [N m]'),
        ('displacement from rest [mrad]', 'friction torque [N m]')],
        f'{result.joint}: presliding')
    if len(x):
        curve.set_xscale('log')
    return figure


def _instead(panel, text):
    panel.text(0.5, 0.5, text, ha='center', transform=panel.transAxes, fontsize=9)


def gap_figure(gap) -> Figure:
    """Return the Gap of each joint: residual torque in motion and free-run error."""
    figure, panels = style.side_by_side(2, height=1.6 + 0.75 * len(gap.joints))
    torque, angle = torque_scale(gap.before), angle_scale(gap.free_before)
    _bars(panels[0], gap.joints, torque, (
        ('as given', gap.before, GIVEN), (WITHOUT, gap.retuned, BEFORE),
        (WITH, gap.after, AFTER), ('noise floor', gap.floor, FLOOR)))
    _bars(panels[1], gap.joints, angle, (
        (WITHOUT, gap.free_before, BEFORE), (WITH, gap.free_after, AFTER),
        ('noise floor', gap.free_floor, FLOOR)))
    style.finished(figure, panels, 'Between model and measurement, on held-out data')
    panels[0].set_xlabel(f'residual torque in motion, rms [{torque.unit}]')
    panels[1].set_xlabel(f'free-run error over 0.5 s, rms [{angle.unit}]')
    for panel in panels:
        panel.tick_params(axis='y', which='both', left=False, right=False)
        panel.set_xlim(left=0.0, right=1.18 * panel.dataLim.xmax or 1.0)
    figure.legend(*panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=4,
                  fontsize=8, frameon=False)
    return figure


def _bars(panel, joints, scale, groups):
    height, at = 0.8 / len(groups), np.arange(len(joints), dtype=float)
    for i, (name, values, colour) in enumerate(groups):
        drawn = panel.barh(at + (i - 0.5 * (len(groups) - 1)) * height,
                           scale.factor * np.nan_to_num(values), 0.9 * height, color=colour,
                           label=name)
        panel.bar_label(drawn, [scale.text(value) for value in values], fontsize=7.5, padding=2)
    panel.set_yticks(at, joints, parse_math=False)
    panel.invert_yaxis()


def evidence_figure(evidence) -> Figure:
    """Return the residual over an effect's own variable: samples, and means with 95 % bands."""
    figure, ((panel,),) = style.panels_of(1, 1, (style.WIDTH, 3.6), layout=None, gridspec_kw={
        'left': 0.1, 'right': 0.99, 'bottom': 0.13, 'top': 0.87})
    keep, scale = style.thinned(len(evidence.x), _MOST_POINTS), torque_scale(evidence.y)
    panel.plot(evidence.x[keep], scale.factor * evidence.y[keep], '.', color=style.COLOURS[4],
               markersize=1.8, alpha=0.35, zorder=1, rasterized=True)
    panel.axhline(0.0, color='0.6', linewidth=0.6)
    for curve, colour, name in ((evidence.before, BEFORE, 'without the effect'),
                                (evidence.after, AFTER, 'with it')):
        _band(panel, curve, colour, scale.factor, label=name)
    panel.plot(evidence.own.x, scale.factor * evidence.own.mean, '--', color=OWN,
               label='the effect itself')
    _limit(panel, evidence, scale.factor)
    panel.legend(loc='best', ncols=3)
    style.labelled(figure, [panel], [(evidence.x_label, f'torque [{scale.unit}]')],
                   f'{evidence.effect} of {evidence.joint}')
    panel.set_title(f'torque {evidence.title}', fontsize=9, parse_math=False)
    return figure


def _band(panel, curve, colour, size, **look):
    low, high = (size * (curve.mean + side * curve.half) for side in (-1.0, 1.0))
    panel.fill_between(curve.x, low, high, color=colour, alpha=0.3, linewidth=0)
    panel.plot(curve.x, size * curve.mean, color=colour, **look)


def _limit(panel, evidence, size):
    """Show the curves and nearly all samples, not the farthest ones."""
    low, high = size * np.quantile(evidence.y, (0.01, 0.99))
    for curve in (evidence.before, evidence.after, evidence.own):
        low = min(low, size * np.min(curve.mean - curve.half, initial=0.0))
        high = max(high, size * np.max(curve.mean + curve.half, initial=0.0))
    margin = 0.15 * (high - low) or 1.0
    panel.set_ylim(low - margin, high + 1.5 * margin)


def maps_figure(maps, joint) -> Figure:
    """Return Maps of a joint's residual, before in the upper row and after in the lower one."""
    # margins in inch: a layout engine takes half the time of the whole report
    left, between = 0.58, 0.66
    width = (style.WIDTH - left - 0.05 - between * (len(maps) - 1)) / len(maps)
    figure, panels = style.panels_of(
        2, len(maps), (style.WIDTH, 4.8), layout=None, sharex='col', sharey='col',
        gridspec_kw={'left': left / style.WIDTH, 'right': 1.0 - 0.05 / style.WIDTH,
                     'top': 0.86, 'bottom': 0.2, 'wspace': between / width, 'hspace': 0.09})
    scale = torque_scale([np.nan_to_num(one.before).ravel().max(initial=0.0) for one in maps])
    largest = scale.factor * max(_usual(values) for one in maps
                                 for values in (one.before, one.after)) or 1.0
    for one, (upper, lower) in zip(maps, panels.T, strict=True):
        for panel, values in ((upper, one.before), (lower, one.after)):
            drawn = panel.pcolormesh(one.x_edges, one.y_edges, scale.factor * values.T,
                                     cmap='RdBu_r', vmin=-largest, vmax=largest, rasterized=True)
            panel.set_facecolor('0.85')
            panel.tick_params(labelsize=8)
            panel.ticklabel_format(scilimits=(-2, 4))
            panel.set_ylabel(one.y_label, fontsize=8, labelpad=1)
        upper.set_title(one.title, fontsize=9)
        lower.set_xlabel(one.x_label, fontsize=8)
    figure.colorbar(drawn, cax=figure.add_axes((0.26, 0.07, 0.55, 0.018)),
                    orientation='horizontal').ax.tick_params(labelsize=8)
    figure.suptitle(f'{joint}: missing torque [{scale.unit}]\n{WITHOUT} (above), {WITH} (below)',
                    fontsize=10, parse_math=False)
    return figure


def _usual(values):
    """Return the size of all but the largest of what is neither unknown nor chance; else 0."""
    sizes = np.abs(values)[np.abs(values) > 0.0]
    return float(np.quantile(sizes, 0.98)) if sizes.size else 0.0


def over_figure(found) -> Figure:
    """Return the residual of one joint and equation over each variable (Over), 95 % bands."""
    figure, (panels,) = style.panels_of(1, len(found), (9.0, 2.9), layout=None, sharey=True)
    scale = torque_scale(np.concatenate([one.before.mean for one in found]))
    farthest = np.concatenate([np.abs(curve.mean) + curve.half
                               for one in found for curve in (one.before, one.after)])
    limit = 1.1 * scale.factor * np.quantile(farthest, _CLEAR) if len(farthest) else 1.0
    for one, panel in zip(found, panels, strict=True):
        panel.axhline(0.0, color='0.6', linewidth=0.6)
        for curve, colour in ((one.before, BEFORE), (one.after, AFTER)):
            _band(panel, curve, colour, scale.factor, linewidth=1.0)
        panel.set_xlabel(one.variable, fontsize=8, labelpad=1)
        panel.tick_params(labelsize=7)
        panel.locator_params(axis='x', nbins=5)
        panel.ticklabel_format(axis='x', scilimits=(-2, 4))
        panel.xaxis.get_offset_text().set_fontsize(7)
        panel.set_ylim(-(limit or 1.0), limit or 1.0)
    panels[0].set_ylabel(f'[{scale.unit}]', fontsize=8)
    figure.suptitle(f'{found[0].joint}: torque missing in the {found[0].equation} equation, means '
                    f'with 95 % bands,\n{WITHOUT} (orange), {WITH} (blue)', fontsize=10,
                    parse_math=False)
    figure.subplots_adjust(left=0.07, right=0.985, bottom=0.16, top=0.72, wspace=0.08)
    return figure


def next_figure(plan) -> Figure:
    """Return a NextRecording: reference, and torques of each explanation less the first's."""
    runs, hypotheses = plan.best.runs, plan.beliefs.hypotheses
    joints = plan.beliefs.robot.joints
    figure, panels = style.stacked_panels(len(joints) + 1)
    rate = 1.0 / np.median(np.diff(runs[0].time))
    for j, joint in enumerate(joints):
        panels[0].plot(runs[0].time, runs[0].reference[:, 0, j],
                       style.STYLES[j % len(style.STYLES)], linewidth=0.9, label=joint,
                       color=style.COLOURS[j % len(style.COLOURS)])
        for k, (run, one) in enumerate(zip(runs[1:], hypotheses[1:], strict=True)):
            panels[j + 1].plot(run.time, 1e3 * _below(
                _LOW_PASS, run.command[:, j] - runs[0].command[:, j], rate),
                               color=style.COLOURS[(k + 1) % len(style.COLOURS)], linewidth=0.8,
                               label=one.words)
        panels[j + 1].set_ylabel(f'{joint} [mN m]')
    panels[0].set_ylabel('reference [rad]')
    for panel in panels[:2]:
        panel.legend()
    return style.finished(figure, panels, 'Reference, and predicted torque less that with '
                          f'{hypotheses[0].words}, below {_LOW_PASS:g} Hz')


def separated_figure(found) -> Figure:
    """Return a Separation: torque predicted by each explanation, and measured, last round."""
    beliefs, last = found.beliefs, len(found.beliefs.likelihood.motions) - 1
    shown, joints = beliefs.hypotheses[:4], beliefs.robot.joints
    left = [beliefs.likelihood.torque(one.model)[last] for one in shown]
    time = beliefs.likelihood.whitenings[last].time
    still = beliefs.likelihood.groups.at_rest[last]
    left = [_below(_SLOW, one, 1.0 / (time[1] - time[0])) for one in left]
    for one in left:
        one[np.tile(still, 2)] = np.nan
    figure, panels = style.stacked_panels(len(joints))
    for j, (joint, panel) in enumerate(zip(joints, panels, strict=True)):
        c = max((j, j + len(joints)), key=lambda c: sum(
            np.nansum((one[:, c] - left[0][:, c]) ** 2) for one in left))
        for k, (torque, one) in enumerate(zip(left, shown, strict=True)):
            panel.plot(time, 1e3 * (torque[:, c] - left[0][:, c]),
                       style.STYLES[k % len(style.STYLES)], label=one.words, linewidth=1.0,
                       color=style.COLOURS[k % len(style.COLOURS)])
        panel.plot(time, -1e3 * left[0][:, c], color='0.2', linewidth=0.6, label='measured')
        panel.set_ylabel(f'{joint}, {"link" if c < len(joints) else "motor"} [mN m]')
    panels[0].legend()
    return style.finished(figure, panels, 'Predicted torque less that with '
                          f'{shown[0].words}, below {_SLOW:g} Hz')


def _below(frequency, signal, rate):
    """Return what of a signal (T, ...) of a sample rate [Hz] is below a frequency, no later."""
    from scipy.signal import butter, sosfiltfilt  # takes 0.4 s
    return sosfiltfilt(butter(2, frequency, fs=rate, output='sos'), signal, axis=0)
