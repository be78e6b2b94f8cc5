# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Tracking tables against closed forms and print, `analyse` and the folder it leaves."""

import json
import struct

from gms_flex_control.cli.main import build_parser
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import BagError
from gms_flex_control.reports import recordings_page
from gms_flex_control.tuning.tracking import Table4, table4, track, TrackingRun
import numpy as np
import pytest

pytestmark = pytest.mark.fast


def recording(error, reference=0.0, joints=('joint1', 'joint2'), **changes):
    """Return a recording at 1 kHz whose link angle is reference + error, shapes (T, n)."""
    error = np.asarray(error, dtype=float)
    reference = np.broadcast_to(reference, error.shape)
    return Recording(joints=joints, time=np.arange(len(error)) * 1e-3, source='synthetic',
                     q_link=reference + error, reference=np.stack(5 * [reference], axis=1),
                     **changes)


def sinusoid_run(trajectory, compensation, amplitudes):
    """Return a run whose error is a sinusoid over whole periods: MSE = amplitude^2 / 2."""
    t = np.arange(4000) * 1e-3
    wave = np.sin(2 * np.pi * t)[:, None] * np.asarray(amplitudes)
    return TrackingRun(trajectory, compensation, recording(wave))


def test_mse_of_a_sinusoidal_error_is_half_its_amplitude_squared():
    result = track(sinusoid_run('sinusoid', 'none', [0.1, 0.02]))
    assert result.joints[0].mse == pytest.approx(0.005, rel=1e-12)
    assert result.joints[1].rms == pytest.approx(0.02 / np.sqrt(2), rel=1e-12)
    assert result.joints[1].max_error == pytest.approx(0.02, rel=1e-12)


@pytest.mark.parametrize(('trajectory', 'joint', 'printed'), [
    ('sinusoid', 'joint1', 6.1), ('sinusoid', 'joint2', 8.4),
    ('polynomial', 'joint1', 31.0), ('polynomial', 'joint2', 9.5)])
def test_paper_ratios_follow_from_its_printed_errors(trajectory, joint, printed):
    table = table4([sinusoid_run(trajectory, 'none', [0.1, 0.1])])
    assert table.paper(trajectory, joint)[2] == pytest.approx(printed, abs=0.05)


def test_repeats_of_one_experiment_are_averaged():
    table = table4([sinusoid_run('sinusoid', 'none', [0.1, 0.1]),
                    sinusoid_run('sinusoid', 'none', [0.2, 0.2])])
    assert table.mse('sinusoid', 'none', 'joint1') == pytest.approx((0.005 + 0.02) / 2)


def test_samples_without_a_reference_do_not_count():
    reference = np.zeros((1000, 2))
    reference[:400] = np.nan
    result = track(TrackingRun('x', 'y', recording(np.full((1000, 2), 0.1), reference)))
    bare = track(TrackingRun('x', 'y', recording(np.ones((10, 2)), np.full((10, 2), np.nan))))
    assert result.joints[0].samples == 600
    assert result.joints[0].mse == pytest.approx(0.01) and np.isnan(bare.joints[0].mse)
    assert "'-'" in repr(Table4((bare,)).rows())


def test_holding_still_is_judged_after_settling_over_the_last_five_seconds():
    t = np.arange(9001) * 1e-3
    reference = np.where(t < 1.0, t, 1.0)[:, None]  # moves 1 s, holds 8 s
    error = np.zeros((9001, 1))
    error[(t > 1) & (t < 4)] = 0.5                  # still settling, not judged
    error[(t > 5) & (t < 6)] = 2e-4
    error[(t > 7) & (t < 8)] = -1e-4
    joint = track(TrackingRun('p', 'gms', recording(error, reference, joints=('j',)))).joints[0]
    assert joint.hold_peak_to_peak == pytest.approx(3e-4)


def test_a_loop_that_did_not_keep_up_is_reported():
    """Every second sample unanswered, those before the controller came aside; and no commands."""
    command = np.zeros((1000, 2))
    command[:200] = command[201::2] = np.nan
    late = TrackingRun('sinusoid', 'gms', recording(np.zeros((1000, 2)), command=command))
    table = table4([late, sinusoid_run('sinusoid', 'none', [0.1, 0.1])])
    assert table.runs[0].unanswered == pytest.approx(0.5, abs=0.002)
    finding, = table.findings()
    assert finding.startswith('sinusoid, gms: 50 % of the samples had no command')
    assert finding in table.text() and table.as_dict()['findings'] == [finding]


def call(*words):
    """Run a verb as the tool does; return its exit code."""
    args = build_parser().parse_args([str(word) for word in words])
    return args.run(args)


def bag(path, amplitude, **options):
    """Write a bag whose error is a constant ``amplitude`` [rad]."""
    write_recording(path, Recording(
        joints=('joint1', 'joint2'), time=np.arange(400) * 1e-3, q_link=amplitude, command=1.0,
        reference=0.0, source='test'), **options)
    return path


def test_bags_become_table_report_and_pictures(tmp_path, capsys):
    bags = [bag(tmp_path / 'sinusoid_none', 0.1), bag(tmp_path / 'sinusoid_gms', 0.02)]
    assert call('analyse', *bags, '--out', tmp_path / 'out') == 0
    assert '25.0' in capsys.readouterr().out
    assert {path.name for path in (tmp_path / 'out').iterdir()} == {
        'table4.json', 'report.html', 'errors_sinusoid.png', 'tracking_sinusoid_none.png',
        'tracking_sinusoid_gms.png'}
    assert call('analyse', *bags, '--out', tmp_path / 'out', '--json') == 0
    table = json.loads(capsys.readouterr().out)
    assert table == json.loads((tmp_path / 'out' / 'table4.json').read_text())
    assert table['table'][0]['ratio']['gms'] == pytest.approx(25)


def test_repeats_are_said_to_be_averaged_and_bags_without_reference_named(tmp_path, capsys):
    bags = [bag(tmp_path / name, 0.1 + 0.01 * k) for k, name in enumerate(
        ('a', 'b', 'sinusoid_none'))]
    write_recording(tmp_path / 'bare', Recording(
        joints=('joint1', 'joint2'), time=np.arange(400) * 1e-3, q_link=0.1, source='test'))
    labels = [f'--label=sinusoid_{mode}' for mode in ('gms', 'gms', 'none', 'gms_paper')]
    with pytest.warns(UserWarning, match='bare: no sample has both a link angle and a reference'):
        assert call('analyse', *bags, tmp_path / 'bare', '--out', tmp_path / 'out', *labels) == 0
    assert capsys.readouterr().out.count('NOTE: sinusoid, gms: mean of 2 bags') == 1
    with pytest.raises(BagError, match='bare: no sample has both a link angle and a reference'):
        call('analyse', tmp_path / 'bare', '--out', tmp_path / 'none')
    assert not (tmp_path / 'none').exists()


def test_every_bag_needs_its_label(tmp_path):
    bags = [bag(tmp_path / 'a', 0.1), bag(tmp_path / 'b', 0.1)]
    with pytest.raises(BagError, match='--label was given 1 times for 2 bags'):
        call('analyse', *bags, '--out', tmp_path / 'out', '--label', 'x_none')


@pytest.mark.parametrize('label', ['bogus', 'sinusoid_bogus', '_gms'])
def test_a_label_without_a_known_compensation_is_refused(tmp_path, label):
    with pytest.raises(BagError, match=f'--label {label}: must end .* gms_paper'):
        call('analyse', bag(tmp_path / 'x', 0.1), '--label', label, '--out', tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


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
