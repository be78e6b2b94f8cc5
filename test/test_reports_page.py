# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The HTML report: self-contained, escaped, its data equal to what was put in."""

import json
import re

from gms_flex_control.answer import Answer, command, measured
from gms_flex_control.reports.figure_style import COLOURS, finished, stacked_panels
from gms_flex_control.reports.page import ChartSeries, decimate, merge_grids, Report
from html_page import Page
import numpy as np
import pytest

pytestmark = pytest.mark.fast

EVIL = '</script><script>alert(1)</script> & "joint"'


def answer(**changed):
    """Return an answer, named by someone hostile."""
    return Answer(EVIL, (EVIL, 'after', 'noise floor'), (
        measured('error [mrad]', 0.0102, 0.00312, 0.001), measured(EVIL, None, 0.2, np.nan)),
        command('view', 'my bag'))._replace(**changed)


def small_report():
    """Return a report with every kind of block, named by someone hostile."""
    t = np.arange(500) * 2e-3
    figure, (panel,) = stacked_panels(1)
    panel.plot(t, np.sin(t), color=COLOURS[1], label=EVIL)
    panel.plot(t, np.cos(t), 'k--')
    finished(figure, [panel], EVIL)
    return (Report(EVIL, answer(), EVIL)
            .chart(EVIL, t, [ChartSeries(EVIL, np.sin(t)), ChartSeries('b', np.cos(t))],
                   y_label=EVIL)
            .heading(EVIL).text(EVIL).note(EVIL, warning=True)
            .table([EVIL, 'n'], [[EVIL, '1.5'], ['x', '-']], caption=EVIL)
            .figure(figure, caption=EVIL).heading('second'))


def test_every_text_is_escaped_wherever_it_is_put():
    html = small_report().html()
    page = Page(html)
    assert 'alert(1)</script> &' not in html
    assert page.tags.count('script') == 3  # data, uPlot, report.js
    assert page.words.count(EVIL) >= 6
    spec = json.loads(page.data)['charts'][0]
    assert spec['series'][0]['label'] == spec['y_label'] == EVIL


def test_embedded_arrays_equal_the_data():
    t = np.arange(500) * 2e-3
    page = Page(small_report().html())
    chart, arrays = json.loads(page.data)['charts'][0], page.arrays()
    x, (y, other) = arrays[chart['x']], [arrays[line['y']] for line in chart['series']]
    np.testing.assert_array_equal(x, t)
    np.testing.assert_array_equal(y, np.sin(t).astype('f4'))
    np.testing.assert_array_equal(other, np.cos(t).astype('f4'))


def test_the_page_reaches_for_nothing_outside_itself():
    html = small_report().html()
    assert all(url.startswith(('data:', '#')) for url in Page(html).urls)
    assert "default-src 'none'" in html
    own = html.replace('https://github.com/leeoniya/uPlot', '')  # uPlot's own banner comment
    assert not re.search(r'https?://|@import|url\((?!#)', own)


def test_a_page_begins_with_the_answer_and_the_rest_folds():
    """A sentence, one picture, numbers with their floor, a command; then closed details."""
    html = small_report().html()
    answered, folded = html.partition('</main>')[::2]
    parts = ('class="sentence"', 'class="charts"', 'noise floor', 'gms_flex view')
    assert sorted(map(answered.index, parts)) == [answered.index(part) for part in parts]
    assert re.search('10.2</td>.*3.12</td>.*>1</td>.*>-</td>.*>200</td>.*>-</td>', answered)
    assert folded.index('<details><summary>') < folded.index('<nav>') < folded.index('<figure')
    assert '<details' not in Report('r', answer()).html()


def test_writing_is_whole_or_not_at_all(tmp_path):
    path = small_report().write(tmp_path / 'deep' / 'report.html')
    assert path.read_text('utf-8') == small_report().html()
    assert [entry.name for entry in path.parent.iterdir()] == ['report.html']


@pytest.mark.parametrize(('x', 'y', 'role', 'match'), [
    ([0, 1, 1], [0, 0, 0], '', 'must be finite and increase'),
    ([0, np.nan, 1], [0, 0, 0], '', 'must be finite and increase'),
    ([0, 1], [0, 0, 0], '', r'y has shape \(3,\), x \(2,\)'),
    ([0, 1], [0, 0], 'pink', "role 'pink' is not one of")])
def test_a_chart_that_cannot_be_drawn_is_refused(x, y, role, match):
    with pytest.raises(ValueError, match=match):
        Report('r', answer()).chart('c', x, [ChartSeries('s', y, role=role)])


def test_series_on_different_stamps_meet_on_their_union():
    grid, (a, b) = merge_grids([0.0, 2.0], [('a', None, [0.0, 4.0]),
                                            ('b', [1.0, 3.0], [10.0, np.nan])])
    np.testing.assert_array_equal(grid, [0, 1, 2, 3])
    np.testing.assert_array_equal(a, [0, 2, 4, np.nan])
    np.testing.assert_array_equal(b, [np.nan, 10, np.nan, np.nan])


def test_decimation_keeps_every_peak_in_order():
    rng = np.random.default_rng(3)
    x, y = np.arange(10007.0), rng.standard_normal(10007)
    y[5000:5200] = np.nan
    y[1234], y[1240] = 50.0, -50.0
    gx, (gy,) = decimate(x, [y], 400)
    assert len(gx) == len(gy) == 400 and np.all(np.diff(gx) > 0)
    assert (np.nanmax(gy), np.nanmin(gy)) == (50.0, -50.0)
    assert np.argmax(gy == 50.0) < np.argmax(gy == -50.0)
    assert np.isnan(gy[201:207]).any()


LEFT_BELOW = """Array.from(document.querySelectorAll('.chart'), (chart) => {
    const edge = chart.getBoundingClientRect(), inner = (what) => Array.from(
      chart.querySelectorAll(what), (part) => part.getBoundingClientRect());
    return {plot: inner('.u-over')[0].height, below: edge.bottom - inner('.uplot')[0].bottom,
            right: edge.right - Math.max(...inner('.u-series > *').map((one) => one.right))};
  })"""


@pytest.fixture
def crowded(browser, tmp_path):
    """Open a report with two charts of eight curves with long names each; return the browser."""
    t = np.arange(500) * 2e-3
    lines = [ChartSeries(f'disturbance observer number {k}', np.sin(t + k)) for k in range(8)]
    page = Report('crowded', answer()).chart('one', t, lines, y_label='rad').chart(
        'two', t, [*lines[1:], ChartSeries('longer_than_a_telephone_is_wide_' * 3, t)])
    browser.errors.clear()

    def opened(width):
        browser.screen(width, 900)
        browser.visit(page.write(tmp_path / 'report.html').as_uri())
        browser.until("document.querySelectorAll('.u-legend').length === 2")
        return browser

    yield opened
    assert browser.errors == []


@pytest.mark.parametrize('width', [1280, 400])
def test_a_chart_with_many_names_keeps_its_plot_and_its_card(crowded, width):
    for chart in crowded(width).ask(LEFT_BELOW):
        assert chart['plot'] > 150.0
        assert chart['below'] > 0.0 and chart['right'] > 0.0


def test_details_are_drawn_when_they_open_and_paper_shows_them(browser, tmp_path):
    """On a telephone in the dark, with a table that is wider than it."""
    t = np.arange(500) * 2e-3
    figure, (panel,) = stacked_panels(1)
    panel.plot(t, np.sin(t), color=COLOURS[1], linewidth=1.3)
    page = (Report('r', answer(sentence='s')).chart('first', t, [ChartSeries('a', t)]).heading('h')
            .chart('second', t, [ChartSeries('a', t)]).table(['wide'] * 30, [['cell'] * 30])
            .figure(figure, 'c'))
    browser.errors.clear()
    browser.screen(400, 860, dark=True)
    browser.visit(page.write(tmp_path / 'report.html').as_uri())
    drawn = "document.querySelectorAll('.u-legend').length"
    browser.until(f'{drawn} === 1')
    browser.ask("dispatchEvent(new Event('beforeprint'))")
    assert browser.ask(f"{drawn} === 2 && document.querySelector('details').open")
    assert browser.ask('document.documentElement.scrollWidth') == 400
    assert 'rgb(255, 138, 61)' in browser.ask(  # --c1 of report.css in the dark
        "Array.from(document.querySelectorAll('figure path'), "
        '(one) => getComputedStyle(one).stroke)')
    browser.ask("dispatchEvent(new Event('afterprint'))")
    assert not browser.ask("document.querySelector('details').open")
    assert browser.errors == []
