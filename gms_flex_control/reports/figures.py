# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Pictures like the paper's Figs. 6 to 10, for print: matplotlib without a display."""

from io import StringIO
import re

from gms_flex_control.analysis.table4 import PAPER_WITHOUT
from gms_flex_control.analysis.tracking import link_error
from gms_flex_control.files import atomic_path
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import AutoMinorLocator
import numpy as np

# Okabe and Ito: told apart with any colour vision; the line styles differ as well
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')
STYLES = ('-', '--', '-.', ':')
NAMES = {'none': 'without compensation', 'gms_paper': "with the paper's observer (gms_paper)",
         'gms': 'with the improved observer (gms)', 'stribeck': 'with a static Stribeck curve',
         'lugre': 'with a LuGre model', 'gms_desired': 'with GMS of the desired motion',
         'gms_adaptive': 'with adaptive GMS',
         'disturbance_observer': 'with a disturbance observer'}
# what a page draws these in, light or dark: variables of report.css
_OF_PAGE = {colour.lower(): f'var(--c{i})' for i, colour in enumerate(COLOURS)} | {
    '#000000': 'var(--ink)', '#ffffff': 'none', '#e6e6e6': 'var(--grid)',
    **dict.fromkeys(('#d9d9d9', '#cccccc'), 'var(--rule)'),
    **dict.fromkeys(('#4d4d4d', '#595959'), 'var(--ink)'),
    **dict.fromkeys(('#8c8c8c', '#999999'), 'var(--muted)')}
_SVG = {'svg.fonttype': 'none', 'svg.hashsalt': 'gms_flex'}  # text stays text; the same each time
# of an SVG file, what one in a page need not have: names of no use, blanks, its own style
_IN_PAGE = (('<metadata>.*?</metadata>|<defs><style.*?</defs>', ''),
            (r'<g id="[\w.]+?_\d+">', '<g>'), (' xmlns(:xlink)?="[^"]*"', ''),
            ('xlink:href', 'href'), (r'>\s+<', '><'), (r'\s+', ' '))
WIDTH = 7.0  # inch
MAX_SAMPLES = 20_000


def compensation_name(compensation):
    """Return the words for a compensation mode, the mode itself if it has none."""
    return NAMES.get(compensation, compensation)


def trajectory_name(trajectory):
    """Return the name of a trajectory as a title; names that are not ours stay as they are."""
    return trajectory.capitalize() if trajectory in PAPER_WITHOUT else trajectory


def compensation_index(compensation):
    """Return the colour index of a mode: the same in every picture and chart."""
    return {'none': 1, 'gms_paper': 2, 'gms': 0}.get(compensation, 3)


def tracking_figure(run):
    """
    Return reference and measured link angle per joint (paper, Figs. 6 to 9).

    Parameters
    ----------
    run : Run
        Of n joints.

    Returns
    -------
    matplotlib.figure.Figure
        n panels one above the other.

    """
    recording = run.recording
    figure, panels = stacked_panels(recording.n_joints)
    keep = _thin(recording.time)
    for i, panel in enumerate(panels):
        panel.plot(recording.time[keep], recording.q_link[keep, i], color=COLOURS[0],
                   label='measured')
        panel.plot(recording.time[keep], recording.reference[keep, 0, i], 'k--', linewidth=1.0,
                   label='reference')
        panel.set_ylabel(f'{recording.joints[i]} [rad]', parse_math=False)
    panels[0].legend(loc='upper right', ncols=2)
    return finished(figure, panels,
                    f'{trajectory_name(run.trajectory)}: {compensation_name(run.compensation)}')


def error_figure(runs, trajectory):
    """
    Return the position errors of all runs of one trajectory, overlaid (paper, Fig. 10).

    Parameters
    ----------
    runs : sequence of Run
        Those of other trajectories are left out.
    trajectory : str
        Its name.

    Returns
    -------
    matplotlib.figure.Figure
        One panel per joint, errors in mrad.

    """
    chosen = [run for run in runs if run.trajectory == trajectory]
    joints = list(dict.fromkeys(name for run in chosen for name in run.recording.joints))
    figure, panels = stacked_panels(len(joints))
    for panel, joint in zip(panels, joints, strict=True):
        panel.axhline(0.0, color='0.6', linewidth=0.6)
        for run in chosen:
            if joint in run.recording.joints:
                _plot_error(panel, run, run.recording.joints.index(joint))
        panel.set_ylabel(f'{joint} [mrad]', parse_math=False)
    panels[0].legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=2)
    return finished(figure, panels, f'{trajectory_name(trajectory)}: position error')


def _plot_error(panel, run, i):
    recording, index = run.recording, compensation_index(run.compensation)
    keep = _thin(recording.time)
    panel.plot(recording.time[keep], 1e3 * link_error(recording)[keep, i],
               STYLES[{1: 0, 2: 2, 0: 0}.get(index, 1)], color=COLOURS[index],
               label=compensation_name(run.compensation))


def file_stem(text):
    """Return a text, such as the name of a joint, as part of the name of a file."""
    return re.sub(r'[^A-Za-z0-9_-]+', '_', text)


def save_figure(figure, path, words=str):
    """
    Write a figure whole or not at all; the suffix chooses the format.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        What to write.
    path : str or Path
        For instance a .png or .pdf.
    words : callable
        Applied to labels and titles, such as one that changes units.

    """
    for text in figure.findobj(Text):
        text.set_text(words(text.get_text()))
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def svg(figure, words=str):
    """
    Return a figure as an SVG element whose colours are those of the page around it.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        What to draw; its clouds of points are best rasterised.
    words : callable
        As of `save_figure`.

    Returns
    -------
    str
        HTML.

    """
    for text in figure.findobj(Text):
        text.set_text(words(text.get_text()))
    file = StringIO()
    with rc_context(_SVG):
        figure.savefig(file, format='svg', metadata={'Date': None})
    element = file.getvalue().partition('<svg')[2]
    for pattern, by in _IN_PAGE:
        element = re.sub(pattern, by, element, flags=re.DOTALL)
    return '<svg' + re.sub('#[0-9a-f]{6}\\b', lambda found: _OF_PAGE.get(
        found.group(), found.group()), element)


def stacked_panels(count):
    """Return a figure and ``count`` axes one above the other, with a common abscissa."""
    figure = Figure(figsize=(WIDTH, 0.8 + 1.75 * count), layout='constrained')
    FigureCanvasAgg(figure)
    panels = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    return figure, panels


def finished(figure, panels, title):
    """Return the figure of `stacked_panels` with title, grid, ticks and time label."""
    figure.suptitle(title, fontsize=11, parse_math=False)
    for panel in panels:
        panel.grid(color='0.9', linewidth=0.6)
        panel.set_axisbelow(True)
        panel.margins(x=0)
        panel.xaxis.set_minor_locator(AutoMinorLocator())
        panel.tick_params(which='both', direction='in', top=True, right=True, labelsize=9)
        legend = panel.get_legend()
        if legend is not None:
            for text in legend.get_texts():
                text.set_fontsize(8.5)
            legend.set_frame_on(False)
        for line in panel.get_lines():
            line.set_linewidth(min(line.get_linewidth(), 1.3))
    panels[-1].set_xlabel('time [s]')
    return figure


def _thin(time):
    """Return the samples to draw: a picture shows no more."""
    return slice(None, None, max(1, int(np.ceil(len(time) / MAX_SAMPLES))))
