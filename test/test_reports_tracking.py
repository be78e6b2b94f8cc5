# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The folder `gms_flex analyse` leaves behind: table, page and pictures."""

import json
import struct

from gms_flex_control.data.recording import Recording
from gms_flex_control.reports import recordings_page
from gms_flex_control.tuning.tracking import TrackingRun
import numpy as np
import pytest


def run(trajectory, compensation, error=0.01, reference=0.0, samples=2000, stamp=1e-3):
    """Return a run of two joints with a constant error [rad]."""
    return TrackingRun(trajectory, compensation, Recording(
        joints=('joint1', '<b>$_'), time=np.arange(samples) * stamp, q_link=error, tau_motor=1.0,
        reference=reference, source=f'bags/{trajectory}_{compensation}'))


def test_table_page_and_pictures_are_written(tmp_path):
    runs = [run('sinusoid', 'none', 0.1), run('sinusoid', 'gms', 0.01, stamp=0.9e-3)]
    table = recordings_page.write_tracking_report(runs, tmp_path / 'out')
    written = json.loads((tmp_path / 'out' / 'table4.json').read_text())
    assert written == table.as_dict()
    assert written['table'][0]['ratio']['gms'] == pytest.approx(100)
    names = sorted(path.name for path in (tmp_path / 'out').iterdir())
    assert names == ['errors_sinusoid.png', 'report.html', 'table4.json',
                     'tracking_sinusoid_gms.png', 'tracking_sinusoid_none.png']
    data = (tmp_path / 'out' / 'errors_sinusoid.png').read_bytes()
    assert data[:8] == b'\x89PNG\r\n\x1a\n'
    width, height = struct.unpack('>II', data[16:24])
    assert width > 900 and height > 500
    html = (tmp_path / 'out' / 'report.html').read_text()
    assert html.count('class="chart"') == 2 + 2 * 2 * 2  # errors, angle, torque: no evidence twice
    answered = html.partition('<details>')[0]
    assert answered.count('class="chart"') == 1 and '<td class=number>100</td>' in answered
    assert '<b>$_' not in html


def test_a_recording_without_reference_is_summarised_all_the_same(tmp_path):
    recordings_page.write_tracking_report([run('log', '', reference=np.nan)], tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ['report.html', 'table4.json']
    assert json.loads((tmp_path / 'table4.json').read_text())['table'][0]['mse'] == {'': None}


def test_pictures_of_repeats_and_strange_names_do_not_collide(tmp_path):
    recordings_page.write_tracking_report([run('a/../b', 'x'), run('a/../b', 'x')], tmp_path)
    assert sorted(path.name for path in tmp_path.glob('*.png')) == [
        'errors_a_.._b.png', 'tracking_a_.._b_x.png', 'tracking_a_.._b_x_2.png']
