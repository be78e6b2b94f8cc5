# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Table 4 against closed forms and the paper's printed numbers."""

import json

from gms_flex_control.comparison.tracking import hold_windows, Run, Table4, table4, track
from gms_flex_control.data.recording import Recording
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
