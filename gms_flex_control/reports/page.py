# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
One HTML file with text, tables, pictures and interactive charts; it needs no network.

Charts are drawn by uPlot (vendor/) from base64 arrays in the file itself; ``report.js`` adds
pan, zoom, cursors shared by a group of charts, and min/max decimation.
"""

import base64
from html import escape
from importlib.resources import files
from itertools import groupby
import json
from pathlib import Path
import re
from typing import Any, NamedTuple, Self

from gms_flex_control.answer import unbroken
from gms_flex_control.file_io import write_text
import numpy as np

ROLES = ('reference', 'c0', 'c1', 'c2', 'c3', 'c4', 'c5', 'c6')
MAX_POINTS = 200_000  # per series; longer ones are written as extremes per bucket
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
_OPTION, _WHOLE = re.compile(r'--[\w-]+'), r'<span>\g<0></span>'  # does not break at its '-'
HINT = ('Drag to pan, wheel or shift-drag to zoom, double-click to reset; click a name in the '
        'legend to hide it. Charts of one group move together.')


class ChartSeries(NamedTuple):
    """One line of a chart."""

    label: str
    y: Any              # array_like, shape (T,); NaN leaves a gap
    x: Any = None       # array_like, shape (T,), if not the chart's
    role: str = ''      # a colour of ROLES; '' takes the next one
    dashed: bool = False
    hidden: bool = False  # off until clicked in the legend


class Report:
    """
    Collect blocks in order and write them as one file.

    The page begins with an Answer; what is added before the first heading is its picture, and
    open; the first heading and all after it fold under 'Details'. ``words`` is applied to every
    text, such as a change of units. Calls of all methods but ``html`` and ``write`` chain. Text
    is escaped here: pass it as it is.
    """

    def __init__(self, title, answer, subtitle='', words=str):
        self._title = words(title)
        self._answer = answer
        self._subtitle = words(subtitle)
        self._words = words
        self._blocks = []  # (kind, html)
        self._headings = []
        self._arrays = {}  # encoded array -> index, so that a shared time axis is stored once
        self._charts = []

    def heading(self, text, level=2) -> Self:
        """Add a heading of level 2 (listed at the top of the page) or 3."""
        anchor = f'h{len(self._blocks)}'
        if level == 2:
            self._headings.append((anchor, self._words(text)))
        return self._add('heading', f'<h{level} id="{anchor}">{self._escaped(text)}</h{level}>')

    def text(self, text) -> Self:
        """Add a paragraph."""
        return self._add('text', f'<p>{self._escaped(text)}</p>')

    def note(self, text, warning=False) -> Self:
        """Add a paragraph that is set off; ``warning`` colours it."""
        kind = 'note warning' if warning else 'note'
        return self._add('text', f'<p class="{kind}">{self._escaped(text)}</p>')

    def table(self, header, rows, caption='') -> Self:
        """Add a table of cells (written with ``str``), its caption above it."""
        caption = f'<p class="caption">{self._escaped(caption)}</p>' if caption else ''
        return self._add('table', caption + self._table(header, rows, 'data'))

    def _table(self, header, rows, kind):
        cells = [[self._escaped(str(cell)) for cell in row] for row in rows]
        header = [self._escaped(str(cell)) for cell in header]
        numeric = [all(_is_number(row[i]) for row in cells) for i in range(len(header))]
        lines = [_row('th', header, numeric), *(_row('td', row, numeric) for row in cells)]
        return (f'<div class="scroll"><table class="{kind}"><thead>{lines[0]}</thead>'
                f'<tbody>{"".join(lines[1:])}</tbody></table></div>')

    def figure(self, figure, caption='') -> Self:
        """Add a matplotlib figure as SVG in the colours of the page; the caption describes it."""
        from gms_flex_control.reports.figure_style import svg  # matplotlib takes 0.3 s
        caption = self._escaped(caption)
        return self._add('figure', f'<figure role="img" aria-label="{caption}">'
                         f'{svg(figure, self._words)}<figcaption>{caption}</figcaption></figure>')

    def chart(self, title, time, series, y_label='', group='time') -> Self:
        """
        Add an interactive chart of ChartSeries over an increasing ``time`` (T,) [s].

        Charts of one ``group`` share cursor, pan and zoom. Those without a number are left out,
        and a chart without series. ValueError if lengths differ, time does not increase or is not
        finite, or a role is unknown.
        """
        series = [item for item in series if np.isfinite(item.y).any()]
        if not series:
            return self
        grid, values = merge_grids(time, [(item.label, item.x, item.y) for item in series])
        shown = decimate(grid, values, MAX_POINTS)
        if len(shown[0]) < len(grid):
            title += f' (extremes of every {2 * len(grid) / len(shown[0]):.0f} samples)'
        lines = []
        for i, (item, y) in enumerate(zip(series, shown[1], strict=True)):
            lines.append({'label': self._words(item.label), 'y': self._store(y, '<f4'),
                          'role': _role(item, i), 'dashed': item.dashed, 'hidden': item.hidden})
        self._charts.append({'x': self._store(shown[0], '<f8'), 'series': lines,
                             'x_label': 'time [s]', 'y_label': self._words(y_label),
                             'group': group})
        return self._add('chart', _chart_html(len(self._charts) - 1, self._words(title)))

    def html(self) -> str:
        """Return the whole page (str)."""
        folder = files('gms_flex_control.reports')
        style = (folder / 'vendor' / 'uPlot.min.css').read_text('utf-8') + (
            folder / 'report.css').read_text('utf-8')
        parts = [
            '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<title>{escape(self._title)}</title><style>{style}</style></head><body>',
            f'<h1>{escape(self._title)}</h1>',
            f'<p class="subtitle">{escape(self._subtitle)}</p>' if self._subtitle else '',
            *self._opening(), *self._details()]
        return '\n'.join([*parts, *self._scripts(folder), '</body></html>\n'])

    def write(self, path) -> Path:
        """Write the page to ``path``, whole or not at all, and return the path."""
        write_text(path, self.html())
        return Path(path)

    def _scripts(self, folder):
        if not self._charts:
            return []
        payload = {'arrays': list(self._arrays), 'charts': self._charts}
        # '<' would let a label end the script element
        data = json.dumps(payload, separators=(',', ':')).replace('<', '\\u003c')
        return ['<noscript><p class="note warning">The charts need JavaScript.</p></noscript>',
                f'<script type="application/json" id="report-data">{data}</script>',
                *(f'<script>{(folder / name).read_text("utf-8")}</script>'
                  for name in ('vendor/uPlot.iife.min.js', 'report.js'))]

    def _opening(self):
        """Return the answer: sentence, picture, numbers, and what to run next."""
        answer, first = self._answer, self._first_heading()
        return [f'<main><p class="sentence">{self._escaped(answer.sentence)}</p>',
                *_grouped(self._blocks[:first]),
                self._table(answer.header, answer.numbers, 'data numbers') if answer.numbers
                else '',
                f'<p class="next">Next: <code>{_OPTION.sub(_WHOLE, escape(answer.command))}</code>'
                '</p></main>']

    def _details(self):
        """Return what folds, with its table of contents; nothing without a heading."""
        folded = self._blocks[self._first_heading():]
        if not folded:
            return []
        links = ''.join(f'<a href="#{anchor}">{escape(text)}</a>'
                        for anchor, text in self._headings)
        return ['<details><summary>Details</summary>', f'<nav>{links}</nav>',
                f'<p class="hint">{HINT}</p>' if self._charts else '', *_grouped(folded),
                '</details>']

    def _first_heading(self):
        kinds = [kind for kind, _ in self._blocks]
        return kinds.index('heading') if 'heading' in kinds else len(kinds)

    def _escaped(self, text):
        return escape(unbroken(self._words(text)))

    def _store(self, values, dtype):
        data = base64.b64encode(np.ascontiguousarray(values, dtype=dtype).tobytes()).decode()
        return self._arrays.setdefault((dtype[1:], data), len(self._arrays))

    def _add(self, kind, block):
        self._blocks.append((kind, block))
        return self


def _grouped(blocks):
    """Yield blocks, neighbouring charts and figures set side by side."""
    wrapper = {'chart': 'charts', 'figure': 'figures'}
    for kind, group in groupby(blocks, lambda block: block[0]):
        inner = ''.join(block for _, block in group)
        yield f'<div class="{wrapper[kind]}">{inner}</div>' if kind in wrapper else inner


def _role(item, i):
    role = item.role or ROLES[1 + i % (len(ROLES) - 1)]
    if role not in ROLES:
        raise ValueError(f'series {item.label!r}: role {role!r} is not one of {ROLES}')
    return role


def _chart_html(index, title):
    buttons = ''.join(
        f'<button type="button" data-act="{act}" title="{hint}"{pressed}>{label}</button>'
        for act, label, hint, pressed in (
            ('box', 'Box', 'Drag draws a zoom box (as shift-drag does)', ' aria-pressed="false"'),
            ('large', 'Large', 'Full width', ' aria-pressed="false"'),
            ('reset', 'Reset', 'Show everything (double-click, key 0)', '')))
    return (f'<section class="chart" id="chart-{index}"><header><h3>{escape(title)}</h3>'
            f'{buttons}</header><div class="plot"></div></section>')


def _row(tag, cells, numeric):
    return '<tr>' + ''.join(
        f'<{tag}{" class=number" if right else ""}>{cell}</{tag}>'
        for cell, right in zip(cells, numeric, strict=True)) + '</tr>'


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return text in ('-', '')
    return True


def merge_grids(x, lines) -> tuple:
    """Put ``lines`` (label, own abscissa or None for ``x``, y) on the union of their abscissae."""
    pairs = []
    for label, own, y in lines:
        abscissa = _increasing(x if own is None else own, label)
        y = np.asarray(y, dtype=float)
        if y.shape != abscissa.shape:
            raise ValueError(f'series {label!r}: y has shape {y.shape}, x {abscissa.shape}')
        pairs.append((abscissa, y))
    grid = pairs[0][0]
    for abscissa, _ in pairs[1:]:
        if not np.array_equal(abscissa, grid):
            grid = np.union1d(grid, abscissa)
    return grid, [y if abscissa is grid or np.array_equal(abscissa, grid) else
                  np.interp(grid, abscissa, y, left=np.nan, right=np.nan)
                  for abscissa, y in pairs]


def decimate(x, values, limit) -> tuple:
    """Return x (N,) and lines (N,) as at most ``limit`` points that keep every peak."""
    if len(x) <= limit:
        return x, list(values)
    edges = np.linspace(0, len(x), limit // 2 + 1).astype(int)
    first, last = edges[:-1], edges[1:] - 1
    return np.column_stack([x[first], x[last]]).ravel(), [_extremes(y, edges) for y in values]


def _extremes(y, edges):
    finite = np.isfinite(y)
    low = np.minimum.reduceat(np.where(finite, y, np.inf), edges[:-1])
    high = np.maximum.reduceat(np.where(finite, y, -np.inf), edges[:-1])
    # which of the two comes first: compare the position of each in its bucket
    bucket = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    position = np.arange(len(y))
    size = len(y)
    at_low = np.minimum.reduceat(np.where(y == low[bucket], position, size), edges[:-1])
    at_high = np.minimum.reduceat(np.where(y == high[bucket], position, size), edges[:-1])
    pair = np.where((at_low <= at_high)[:, None], np.column_stack([low, high]),
                    np.column_stack([high, low]))
    pair[~np.isfinite(pair)] = np.nan
    return pair.ravel()


def _increasing(x, label):
    x = np.asarray(x, dtype=float)
    if x.ndim != 1 or not x.size or not np.all(np.isfinite(x)) or np.any(np.diff(x) <= 0):
        raise ValueError(f'series {label!r}: the abscissa must be finite and increase '
                         f'(shape {x.shape}); plot a loop as a figure instead')
    return x
