# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""`gms_flex analyse` and `gms_flex import-csv` from arguments to files."""

import json

from gms_flex_control.cli import recordings
from gms_flex_control.cli.main import build_parser
from gms_flex_control.data.csv_import import import_csv
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.recording import Recording
from gms_flex_control.data.writer import write_recording
from gms_flex_control.errors import BagError, ImportDataError
from gms_flex_control.params.gains import COMPENSATIONS
import numpy as np
import pytest

pytestmark = pytest.mark.fast

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


@pytest.mark.parametrize('mode', COMPENSATIONS)
def test_every_mode_of_the_controller_makes_a_label(mode):
    assert recordings.given_label(f'my_motion_{mode}') == ('my_motion', mode)


@pytest.mark.parametrize('label', ['bogus', 'sinusoid_bogus', '_gms'])
def test_a_label_without_a_known_compensation_is_refused(tmp_path, label):
    with pytest.raises(BagError, match=f'--label {label}: must end .* gms_paper'):
        call('analyse', bag(tmp_path / 'x', 0.1), '--label', label, '--out', tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
