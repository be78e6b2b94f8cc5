# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Tracking tables against closed forms and print, waves over an angle, and `analyse` itself."""

import json

from gms_flex_control.cli import recordings
from gms_flex_control.cli.main import build_parser
from gms_flex_control.comparison.tracking import hold_windows, Run, Table4, table4, track
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.signal_analysis import standing_out
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import BagError, ImportDataError
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
    return Run(trajectory, compensation, recording(wave))


def test_mse_of_a_sinusoidal_error_is_half_its_amplitude_squared():
    result = track(sinusoid_run('sinusoid', 'none', [0.1, 0.02]))
    assert result.joints[0].mse == pytest.approx(0.005, rel=1e-12)
    assert result.joints[1].rms == pytest.approx(0.02 / np.sqrt(2), rel=1e-12)
    assert result.joints[1].max_error == pytest.approx(0.02, rel=1e-12)


def test_ratio_is_without_over_with_per_joint_and_mode():
    table = table4([sinusoid_run('sinusoid', 'none', [0.1, 0.1]),
                    sinusoid_run('sinusoid', 'gms', [0.05, 0.01])])
    assert table.ratio('sinusoid', 'gms', 'joint1') == pytest.approx(4.0)
    assert table.ratio('sinusoid', 'gms', 'joint2') == pytest.approx(100.0)


def test_the_answer_compares_the_worst_link_without_and_with():
    """The worst link without compensation need not be the worst one with it."""
    table = table4([sinusoid_run('sinusoid', 'none', [0.05, 0.1]),
                    sinusoid_run('sinusoid', 'gms', [0.02, 0.01])])
    assert table.answer().sentence.startswith(
        'With compensation gms the links follow within 14.1 mrad (rms), without it within '
        '70.7 mrad; ')


@pytest.mark.parametrize(('trajectory', 'joint', 'printed'), [
    ('sinusoid', 'joint1', 6.1), ('sinusoid', 'joint2', 8.4),
    ('polynomial', 'joint1', 31.0), ('polynomial', 'joint2', 9.5)])
def test_paper_ratios_follow_from_its_printed_errors(trajectory, joint, printed):
    table = table4([sinusoid_run(trajectory, 'none', [0.1, 0.1])])
    assert table.paper(trajectory, joint)[2] == pytest.approx(printed, abs=0.05)


def test_missing_combinations_show_as_a_dash_and_null():
    table = table4([sinusoid_run('sinusoid', 'none', [0.1, 0.1]),
                    sinusoid_run('polynomial', 'gms', [0.1, 0.1])])
    header, rows = table.rows()
    cell = dict(zip(header[:5], rows[0][:5], strict=True))
    assert cell == {'trajectory': 'sinusoid', 'joint': 'joint1', 'none': '5.000e-03',
                    'gms': '-', 'ratio': '-'}
    entry = table.as_dict()['table'][2]
    assert (entry['trajectory'], entry['mse']['none'], entry['ratio']['gms']) == (
        'polynomial', None, None)
    json.dumps(table.as_dict(), allow_nan=False)
    assert '6.11' in table.text()


def test_repeats_of_one_experiment_are_averaged():
    table = table4([sinusoid_run('sinusoid', 'none', [0.1, 0.1]),
                    sinusoid_run('sinusoid', 'none', [0.2, 0.2])])
    assert table.mse('sinusoid', 'none', 'joint1') == pytest.approx((0.005 + 0.02) / 2)


def test_another_robot_is_not_compared_with_the_paper():
    run = Run('sinusoid', 'none', recording(np.ones((10, 3)), joints=('a', 'b', 'c')))
    assert table4([run]).paper('sinusoid', 'a') is None


def test_samples_without_a_reference_do_not_count():
    reference = np.zeros((1000, 2))
    reference[:400] = np.nan
    result = track(Run('x', 'y', recording(np.full((1000, 2), 0.1), reference)))
    bare = track(Run('x', 'y', recording(np.ones((10, 2)), np.full((10, 2), np.nan))))
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
    joint = track(Run('p', 'gms', recording(error, reference, joints=('j',)))).joints[0]
    assert joint.hold_peak_to_peak == pytest.approx(3e-4)
    assert (joint.hold_start, joint.hold_duration) == pytest.approx((4.0, 5.0))


def test_a_short_stop_is_not_a_hold():
    t = np.arange(2000) * 1e-3
    assert hold_windows(t, np.where(t < 1.2, t, 1.2)) == []


def test_rms_torque_falls_back_on_the_command():
    command = np.full((100, 2), 3.0)
    run = Run('x', 'y', recording(np.zeros((100, 2)), command=command))
    assert track(run).joints[0].rms_torque == pytest.approx(3.0)


def test_a_loop_that_did_not_keep_up_is_told():
    """Every second sample unanswered, those before the controller came aside; and no commands."""
    command = np.zeros((1000, 2))
    command[:200] = command[201::2] = np.nan
    late = Run('sinusoid', 'gms', recording(np.zeros((1000, 2)), command=command))
    table = table4([late, sinusoid_run('sinusoid', 'none', [0.1, 0.1])])
    assert table.runs[0].unanswered == pytest.approx(0.5, abs=0.002)
    finding, = table.findings()
    assert finding.startswith('sinusoid, gms: 50 % of the samples had no command')
    assert finding in table.text() and table.as_dict()['findings'] == [finding]


PERIOD = 4e-3


def motion(rng, seconds=80.0):
    """Return angle and rate (S,) of a motion to and fro."""
    time = np.arange(0.0, seconds, PERIOD)
    angle = 0.3 * np.sin(2 * np.pi * 0.05 * time) + 0.1 * np.sin(
        2 * np.pi * 0.17 * time + rng.uniform(0.0, 2 * np.pi))
    return angle, np.gradient(angle, PERIOD)


@pytest.mark.parametrize('order', [60.0, 200.0, 628.3])
def test_waves_below_the_noise_are_found(order):
    rng = np.random.default_rng(round(order))
    angle, rate = motion(rng)
    torque = 0.2 * np.sin(order * angle + 1.0) + rng.standard_normal(len(angle))
    torque += np.sign(rate) * 3.0  # what friction leaves
    found = standing_out([angle], [torque], [rate], 48.0)
    assert found[0] == pytest.approx(order, abs=0.25 * 2.0 * np.pi / np.ptp(angle))


def test_a_wave_of_several_recordings_is_found():
    rng, takes = np.random.default_rng(5), []
    for _ in range(3):
        angle, rate = motion(rng, 30.0)
        takes.append((angle, 0.2 * np.sin(300.0 * angle) + rng.standard_normal(len(angle)), rate))
    angles, torques, rates = zip(*takes, strict=True)
    assert standing_out(angles, torques, rates, 48.0)[0] == pytest.approx(300.0, abs=3.0)


@pytest.mark.parametrize('seed', range(20))
def test_noise_is_no_wave(seed):
    rng = np.random.default_rng(seed)
    angle, rate = motion(rng)
    assert standing_out([angle], [rng.standard_normal(len(angle))], [rate], 48.0) == ()


def test_a_joint_that_stands_has_none():
    still = np.zeros(1000)
    assert standing_out([still], [still], [still], 48.0) == ()


MAP = """source: a bench
time: {column: t, unit: s}
joints:
  axis1:
    motor: axis1_motor
    link_position: {column: q, unit: deg}
    motor_position: {column: m, unit: deg}
    torque: {column: i, unit: N m}
    reference: {column: r, unit: deg}
  axis2:
    link_position: {column: p, unit: rad}
    torque: {column: i, unit: N m}
    reference: {column: p, unit: rad}
"""


def call(*words):
    """Run a verb as the tool does; return its exit code."""
    args = build_parser().parse_args([str(word) for word in words])
    return args.run(args)


@pytest.fixture
def log(tmp_path):
    """Write a log and its map; return their paths."""
    t = np.arange(200) * 5e-3
    q = 30 * np.sin(t)
    columns = np.column_stack([t, q, q + 0.01, np.cos(t), q * 1.001, np.cos(2 * t)])
    np.savetxt(tmp_path / 'log.csv', columns, fmt='%.17g', delimiter=',', header='t,q,m,i,r,p',
               comments='')
    (tmp_path / 'map.yaml').write_text(MAP)
    return tmp_path / 'log.csv', tmp_path / 'map.yaml'


def bag(path, amplitude, **options):
    """Write a bag whose error is a constant ``amplitude`` [rad]."""
    write_recording(path, Recording(
        joints=('joint1', 'joint2'), time=np.arange(400) * 1e-3, q_link=amplitude, command=1.0,
        reference=0.0, source='test'), **options)
    return path


def test_an_imported_bag_reads_back_as_the_recording(log, tmp_path, capsys):
    assert call('import-csv', log[0], '--map', log[1], '--out', tmp_path / 'bag') == 0
    assert 'axis1 (axis1_motor)' in capsys.readouterr().out
    direct, back = import_csv(*log).recording, read_recording(tmp_path / 'bag')
    assert back.joints == direct.joints
    for name in ('time', 'q_link', 'q_motor', 'tau_motor'):
        np.testing.assert_allclose(getattr(back, name), getattr(direct, name), atol=1e-9)
    np.testing.assert_array_equal(back.reference[:, 0], direct.reference[:, 0])


def test_findings_as_json(log, tmp_path, capsys):
    assert call('import-csv', log[0], '--map', log[1], '--out', tmp_path / 'bag',
                '--resample', 100, '--json') == 0
    result = json.loads(capsys.readouterr().out)
    assert result['motors'] == ['axis1_motor', ''] and result['samples'] == 100
    assert 'resampled' in result['remarks'][0]


def test_a_shipped_map_is_found_by_its_name():
    assert recordings.find_map('import_kr300.yaml').is_file()
    assert str(recordings.find_map('no_such_map.yaml')) == 'no_such_map.yaml'


def test_nothing_is_left_behind_by_a_refused_import(log, tmp_path):
    with pytest.raises(ImportDataError, match='resample must be a positive rate'):
        call('import-csv', log[0], '--map', log[1], '--out', tmp_path / 'bag', '--resample', 0)
    assert not (tmp_path / 'bag').exists()


def test_labels_come_from_metadata_then_from_the_name(tmp_path):
    bag(tmp_path / 'run7', 0.1, custom={'trajectory': 'sinusoid', 'compensation': 'none'})
    bag(tmp_path / 'polynomial_gms_paper', 0.1)
    assert recordings.bag_label(tmp_path / 'run7') == ('sinusoid', 'none')
    assert recordings.bag_label(tmp_path / 'polynomial_gms_paper') == ('polynomial', 'gms_paper')
    assert recordings.bag_label(tmp_path / 'anything') == ('anything', 'unlabelled')


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


def test_labels_on_the_command_line(tmp_path, capsys):
    bags = [bag(tmp_path / 'a', 0.1), bag(tmp_path / 'b', 0.1)]
    assert call('analyse', *bags, '--out', tmp_path / 'out', '--label', 'x_none', '--label',
                'x_gms') == 0
    assert '1.00' in capsys.readouterr().out
    with pytest.raises(BagError, match='--label was given 1 times for 2 bags'):
        call('analyse', *bags, '--out', tmp_path / 'out', '--label', 'x_none')


@pytest.mark.parametrize('label', ['bogus', 'sinusoid_bogus', '_gms'])
def test_a_label_without_a_known_compensation_is_refused(tmp_path, label):
    with pytest.raises(BagError, match=f'--label {label}: must end .* gms_paper'):
        call('analyse', bag(tmp_path / 'x', 0.1), '--label', label, '--out', tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
