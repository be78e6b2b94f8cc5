# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""How figures look: colours, panels, files and SVG for the page; matplotlib without display."""

from io import StringIO
from pathlib import Path
import re

from gms_flex_control.file_io import atomic_path
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
import numpy as np

# Okabe and Ito: distinct with any colour vision; the line styles differ as well
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')
STYLES = ('-', '--', '-.', ':')
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
_DPI = 150   # of PNGs


def panels_of(rows, columns, size, layout='constrained', **options) -> tuple:
    """Return a figure of a size (width, height) [inch] and its axes (rows, columns)."""
    figure = Figure(figsize=size, layout=layout)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def stacked_panels(count) -> tuple:
    """Return a figure and ``count`` axes one above the other, with a common abscissa."""
    figure, panels = panels_of(count, 1, (WIDTH, 0.8 + 1.75 * count), sharex=True)
    return figure, panels[:, 0]


def side_by_side(count, height=3.2) -> tuple:
    """Return a figure and ``count`` axes beside each other."""
    figure, panels = panels_of(1, count, (WIDTH, height))
    return figure, panels[0]


def finished(figure, panels, title) -> Figure:
    """Return the figure with title, grid, ticks and a time label under the last panel."""
    figure.suptitle(title, fontsize=11, parse_math=False)
    for panel in panels:
        panel.grid(color='0.9', linewidth=0.6)
        panel.set_axisbelow(True)
        panel.margins(x=0)
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


def labelled(figure, panels, labels, title) -> Figure:
    """Return the figure `finished`, its panels labelled with (x, y)."""
    finished(figure, panels, title)
    for panel, (x, y) in zip(panels, labels, strict=True):
        panel.set_xlabel(x, parse_math=False)
        panel.set_ylabel(y, parse_math=False)
    return figure


def thinned(length, most=20_000) -> slice:
    """Return which of so many samples are drawn: a picture shows no more."""
    return slice(None, None, max(1, int(np.ceil(length / most))))


def file_stem(text) -> str:
    """Return a text, such as the name of a joint, as part of the name of a file."""
    return re.sub(r'[^A-Za-z0-9._-]+', '_', text).strip('_')


def free_path(folder, text, used) -> Path:
    """Return the path of a PNG named after a text, none of the set ``used``, and add it there."""
    stem, count = file_stem(text), 1
    path = folder / f'{stem}.png'
    while path in used:
        count += 1
        path = folder / f'{stem}_{count}.png'
    used.add(path)
    return path


def save_figure(figure, path, words=str) -> None:
    """Write a PNG whole or not at all; ``words`` is applied to labels, such as other units."""
    _translate(figure, words)
    own = figure.dpi
    figure.set_dpi(_DPI)
    with atomic_path(path) as temporary:
        FigureCanvasAgg(figure).print_png(temporary)  # savefig draws once more, for the layout
    figure.set_dpi(own)
    figure.set_layout_engine(None)  # drawn again, it keeps its layout


def svg(figure, words=str) -> str:
    """Return a figure as an SVG element in the colours of the page around it."""
    _translate(figure, words)
    file = StringIO()
    with rc_context(_SVG):
        figure.savefig(file, format='svg', metadata={'Date': None})
    element = file.getvalue().partition('<svg')[2]
    for pattern, by in _IN_PAGE:
        element = re.sub(pattern, by, element, flags=re.DOTALL)
    return '<svg' + re.sub('#[0-9a-f]{6}\\b', lambda found: _OF_PAGE.get(
        found.group(), found.group()), element)


def _translate(figure, words):
    for text in figure.findobj(Text) if words is not str else ():  # as slow as drawing
        text.set_text(words(text.get_text()))
