# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Other people's logs: units against closed forms, every kind of mess named with its line."""

from dataclasses import replace
from pathlib import Path
import re

from gms_flex_control.cli.main import main
from gms_flex_control.cli.recordings import suspicions
from gms_flex_control.data.csv_import import estimate_velocity, import_csv
from gms_flex_control.data.reader import joint_names, read_recording
from gms_flex_control.errors import ImportDataError
import numpy as np
import pytest

pytestmark = pytest.mark.fast

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / 'shared' / 'data'
T = np.arange(1000) * 4e-3
Q = 0.7 * np.sin(2 * np.pi * T)
DQ = 0.7 * 2 * np.pi * np.cos(2 * np.pi * T)

PLAIN = """
time: {column: t, unit: s}
joints:
  j1:
    link_position: {column: q, unit: rad}
"""


@pytest.fixture
def load(tmp_path):
    """Return a function that imports columns {name: values} by the text of a map."""
    def do(columns, text=PLAIN, edit=None, **options):
        log, import_map = tmp_path / 'log.csv', tmp_path / 'map.yaml'
        np.savetxt(log, np.column_stack(list(columns.values())), fmt='%.17g', delimiter=',',
                   header=','.join(columns), comments='')
        if edit:
            log.write_text(edit(log.read_text()))
        import_map.write_text(text)
        return import_csv(log, import_map, **options)
    return do


def change_line(number, text):
    """Return an edit that replaces one line of the file, counted from 1."""
    def edit(content):
        lines = content.splitlines()
        lines[number - 1] = text
        return '\n'.join(lines)
    return edit


def test_the_verb_writes_a_bag_that_reads_back_as_the_log(load, tmp_path, capsys):
    direct = load({'t': T, 'q': Q, 'm': Q + 0.01, 'i': np.cos(T), 'r': 1.001 * Q}, PLAIN + """\
    motor_position: {column: m, unit: deg}
    torque: {column: i, unit: N m}
    reference: {column: r, unit: deg}
    motor: m1
  j2: {link_position: {column: r, unit: rad}, torque: {column: i, unit: N m}}
""").recording
    assert main(['import-csv', str(tmp_path / 'log.csv'), '--map', str(tmp_path / 'map.yaml'),
                 '--out', str(tmp_path / 'bag')]) == 0
    assert 'j1 (m1)' in capsys.readouterr().out
    back = read_recording(tmp_path / 'bag', direct.joints, ['m1', ''])
    assert back.joints == direct.joints
    for name in ('time', 'q_link', 'q_motor', 'tau_motor'):
        np.testing.assert_allclose(getattr(back, name), getattr(direct, name), atol=1e-9)
    np.testing.assert_array_equal(back.reference[:, 0], direct.reference[:, 0])


def test_a_joint_whose_motor_alone_has_an_encoder_is_read_as_such(load, tmp_path, capsys):
    """The bag has the motor in the joint's place, beside a joint that is seen on both sides."""
    load({'t': T, 'q': Q, 'm': Q + 0.01, 'i': np.cos(T)}, PLAIN + """\
    motor: m1
    motor_position: {column: m, unit: rad}
    torque: {column: i, unit: N m}
  j2: {motor: m2, motor_position: {column: m, unit: rad}, motor_velocity: {estimate: 0.02},
       torque: {column: i, unit: N m}}
""")
    assert main(['import-csv', str(tmp_path / 'log.csv'), '--map', str(tmp_path / 'map.yaml'),
                 '--out', str(tmp_path / 'bag')]) == 0
    assert 'not recorded' not in capsys.readouterr().out
    assert joint_names(tmp_path / 'bag') == ('j1', 'm1', 'm2')
    back = read_recording(tmp_path / 'bag', ['j1', 'j2'], ['m1', 'm2'])
    np.testing.assert_allclose(back.q_link[:, 0], Q, atol=1e-9)
    np.testing.assert_allclose(back.q_motor, np.stack([Q + 0.01] * 2, axis=1), atol=1e-9)
    np.testing.assert_allclose(back.tau_motor[:, 1], np.cos(T), atol=1e-9)
    assert np.isnan(back.q_link[:, 1]).all() and np.isnan(back.dq_link[:, 1]).all()


@pytest.mark.parametrize(('unit', 'factor'), [
    ('mm', 1e3), ('mrad', 1e3), ('deg', 180 / np.pi), ('mdeg', 180e3 / np.pi),
    ('turn', 0.5 / np.pi)])
def test_position_units(load, unit, factor):
    log = load({'t': T, 'q': Q * factor}, PLAIN.replace('rad', unit))
    np.testing.assert_allclose(log.recording.q_link[:, 0], Q, rtol=1e-13, atol=1e-15)


DUTY, VOLTS = np.sin(T), 7.0 + 0.1 * np.cos(T)
# columns beside the link angle, their lines in the map, the channel and what it has to become
CHANNELS = {
    'encoder of 4096 counts behind a gear of 50, mounted backwards, zero at 100 counts': (
        {'m': 100 - Q * 50 / (2 * np.pi) * 4096}, """motor: m1
    motor_position: {column: m, unit: counts, counts_per_rev: 4096, offset: -100, sign: -1,
                     gear_ratio: 50}""", 'q_motor', Q),
    'current of a motor behind a gear': (
        {'i': Q}, """torque: {column: i, unit: A, torque_constant: 0.12, scale: 0.5,
             gear_ratio: 50}""", 'tau_motor', Q * 0.12 * 0.5 * 50),
    'revolutions per minute': (
        {'v': DQ * 30 / np.pi}, 'link_velocity: {column: v, unit: rpm}', 'dq_link', DQ),
    'pwm of a DC motor': (
        {'v': DQ, 'pwm': 885 * DUTY, 'u': VOLTS, 'on': T < 2},
        """link_velocity: {column: v, unit: rad/s}
    torque: {column: pwm, unit: pwm, full_scale: 885, voltage: u, torque_per_volt: 0.1,
             back_emf: 0.3, enabled: on}""", 'tau_motor',
        np.where(T < 2, 0.1 * (DUTY * VOLTS - 0.3 * DQ), 0.0)),
    'speed and force of a ball screw': (
        {'v': 1e3 * DQ, 'f': T}, """link_velocity: {column: v, unit: mm/s}
    torque: {column: f, unit: N}""", 'dq_link', DQ),
    'back emf behind a gear counts twice': (
        {'v': DQ, 'pwm': 0 * T}, """link_velocity: {column: v, unit: rad/s}
    torque: {column: pwm, unit: pwm, full_scale: 1, voltage: 12.0, torque_per_volt: 0.1,
             back_emf: 0.3, gear_ratio: 10}""", 'tau_motor', -0.1 * 0.3 * 100 * DQ)}


@pytest.mark.parametrize('name', CHANNELS)
def test_a_channel_becomes_si_at_the_joint(load, name):
    columns, lines, channel, expected = CHANNELS[name]
    log = load({'t': T * 1e3, 'q': Q, **columns}, f'{PLAIN}    {lines}\n'.replace(
        'unit: s}', 'unit: ms}'))
    np.testing.assert_allclose(getattr(log.recording, channel)[:, 0], expected, atol=1e-12)
    assert log.recording.period == pytest.approx(4e-3)
    assert log.motors == ('m1' if 'motor: m1' in lines else '',)


def test_uneven_stamps_stay_and_resampling_is_linear(load):
    rng = np.random.default_rng(5)
    t = np.sort(rng.uniform(0, 2, 900))
    t[0] = 0.0
    log = load({'t': t, 'q': 3 * t})
    np.testing.assert_array_equal(log.recording.time, t)
    even = load({'t': t, 'q': 3 * t}, resample=100.0)
    np.testing.assert_allclose(np.diff(even.recording.time), 0.01)
    np.testing.assert_allclose(even.recording.q_link[:, 0], 3 * even.recording.time, atol=1e-12)
    assert 'aliasing' in even.remarks[0]


def test_velocity_is_estimated_over_the_stated_window(load):
    log = load({'t': T, 'q': Q}, PLAIN + '    link_velocity: {estimate: 0.04}\n')
    # central difference of a sinusoid: cos scaled by sin(w h) / (w h)
    shrink = np.sinc(2 * 0.02)
    np.testing.assert_allclose(log.recording.dq_link[5:-5, 0], shrink * DQ[5:-5], atol=1e-9)
    assert 'central differences over 40 ms' in log.remarks[0]


def test_an_estimate_uses_at_least_the_neighbouring_samples():
    t = np.array([0.0, 0.1, 0.3, 0.6])
    np.testing.assert_allclose(estimate_velocity(t, t ** 2, 1e-3), [0.1, 0.3, 0.7, 0.9])


@pytest.mark.parametrize(('unit', 'span', 'size'), [
    ('rad, unwrap: true', 2 * np.pi, 1.0), ('rad, unwrap_range: 25.0', 25.0, 1.0),
    ('counts, counts_per_rev: 4096, unwrap_range: 65536.0', 65536.0, 2.0 * np.pi / 4096)])
def test_unwrapping_undoes_the_range_after_which_a_drive_begins_again(load, unit, span, size):
    """Drives report a turn, +-12.5 rad, or 16 bits of counts."""
    turned = 20.0 * T / T[-1] * span
    log = load({'t': T, 'q': (turned + 0.5 * span) % span - 0.5 * span},
               PLAIN.replace('rad', unit))
    np.testing.assert_allclose(log.recording.q_link[:, 0], size * turned, atol=1e-12 * span)


def test_empty_cells_become_nan_and_are_counted(load):
    log = load({'t': T, 'q': Q}, edit=change_line(7, f'{T[5]},'))
    assert np.isnan(log.recording.q_link[5, 0]) and np.isnan(log.recording.q_link).sum() == 1


def test_disordered_time_is_refused_or_dropped_as_asked(load):
    t = T.copy()
    t[10], t[20] = t[9], t[5]
    with pytest.raises(ImportDataError, match=r'log.csv:12: time does not increase, 0.036 s '
                                              r'after 0.036 s \(2 such lines\).*drop'):
        load({'t': t, 'q': Q})
    log = load({'t': t, 'q': Q}, PLAIN.replace('unit: s}', 'unit: s, not_increasing: drop}'))
    assert len(log.recording.time) == 998 and '2 samples' in log.remarks[0]


@pytest.mark.parametrize(('edit', 'match'), [
    (change_line(5, '0.012,abc'), r"log.csv:5: column 'q' holds 'abc', which is not a number"),
    (change_line(5, '0.012;0.3'), r'log.csv:5: has 1 cells where there are 2 columns'),
    (change_line(1001, '3.9'), r'log.csv:1001: .*the file seems cut off'),
    (change_line(5, '0.012,0.3,4'), r'log.csv:5: has 3 cells'),
    (change_line(5, ',0.3'), r'log.csv:5: time column .t. is empty'),
    (change_line(1, 't,theta'), r"has no column 'q', which j1.link_position \(.*map.yaml:5\) "
                                r'requires; known: t, theta'),
    (change_line(1, 'q,q'), r"has no column 't'"),
    (lambda text: text.replace(',', ';'), "has no column 't'.*did you mean 't;q'"),
    (lambda text: 't,q\n', 'has no data below 1 header rows'),
    (lambda text: 't,q\n0,1\n', '1 usable sample'),
    (lambda text: '', r'is empty \(0 bytes\)'),
    (lambda text: text + 'a\0b', 'NUL bytes'),
    (change_line(4, '0.008,"0,5"'), "holds '0,5'.*set file.decimal: ','"),
    (lambda text: text.replace('t,q', 't,q\ns,rad'), 'set file.header_rows: 2'),
    (change_line(2, '12:30:01.5,0.3'), 'give a time of day as seconds')])
def test_a_broken_file_is_refused_with_its_line(load, edit, match):
    with pytest.raises(ImportDataError, match=match):
        load({'t': T, 'q': Q}, edit=edit)


def test_unreadable_files_are_named(tmp_path):
    (tmp_path / 'map.yaml').write_text(PLAIN)
    with pytest.raises(ImportDataError, match='none.csv: cannot be read'):
        import_csv(tmp_path / 'none.csv', tmp_path / 'map.yaml')
    (tmp_path / 'latin.csv').write_bytes(b't,q\n0,1\xb0\n')
    with pytest.raises(ImportDataError, match='is not UTF-8 text .byte 7 is 0xb0'):
        import_csv(tmp_path / 'latin.csv', tmp_path / 'map.yaml')


MOVED = PLAIN + '    torque: {column: tau, unit: N m}\n'
LONG = np.arange(6000) * 2e-3
SWING = 0.3 * np.sin(2 * np.pi * LONG / 3)
SPEED = np.gradient(SWING, LONG)


@pytest.mark.parametrize(('position', 'torque', 'way_out'), [
    ('mm', 'N m', 'gear_ratio: 2 pi over the lead'), ('rad', 'N', 'scale: the lever arm')])
def test_an_angle_beside_a_force_is_called_so(load, position, torque, way_out):
    log = load({'t': LONG, 'q': SWING, 'tau': SPEED},
               MOVED.replace('rad', position).replace('N m', torque))
    assert way_out in log.remarks[-1]


def test_an_arm_with_currents_and_no_torque_constant_stays_in_ampere(load):
    currents = {'tau': SPEED, 'milli': 1e3 * np.cos(LONG)}
    log = load({'t': LONG, 'q': SWING, **currents}, MOVED.replace('N m', 'A') + (
        '  j2: {link_position: {column: q, unit: rad}, torque: {column: milli, unit: mA}}\n'))
    np.testing.assert_allclose(log.recording.tau_motor, np.stack([SPEED, np.cos(LONG)], axis=1),
                               atol=1e-12)
    assert log.remarks[0].startswith('no torque_constant for j1, j2')
    assert 'a current stays a current [A]' in log.remarks[0]


BY_NUMBER = """
time: {rate: 250}
joints: {j1: {link_position: {column: 2, unit: rad}}}
"""


@pytest.mark.parametrize(('head', 'edit'), [
    ('', None), ('', lambda text: text.replace('t,q', 't,q,,').replace('\n', ',,\n')),
    ('', lambda text: text.replace('t,q', 't,q,,')),
    ('', lambda text: '\ufeff' + text.replace('t,q', '"t","q"').replace('\n', '\r\n')),
    ('file: {header_rows: 2}', lambda text: text.replace('t,q', 't,q\ns,rad')),
    ('file: {header_rows: 2}', lambda text: '% export of 3 May\n' + text.replace('t,q', '% t,q')),
    ('file: {delimiter: tab}', lambda text: text.replace(',', '\t')),
    ("file: {delimiter: space, comment: '%'}",
     lambda text: '% from the bench\n' + text.replace(',', '   ')),
    ("file: {delimiter: ';', decimal: ',', header_rows: 2}",
     lambda text: '\ufeffMessung 7\n' + text.replace(',', ';').replace('.', ','))])
def test_usual_shapes_of_export_are_read(load, head, edit):
    log = load({'t': T + 17.0, 'q': Q}, head + PLAIN, edit=edit)
    np.testing.assert_array_equal(log.recording.q_link[:, 0], Q)
    np.testing.assert_array_equal(log.recording.time, (T + 17.0) - 17.0)
    assert np.isnan(log.recording.dq_link).all() and log.motors == ('',)


@pytest.mark.parametrize('text', [PLAIN, BY_NUMBER])
def test_a_forgotten_header_setting_does_not_cost_the_first_sample(load, text):
    def bare(content):
        return content.split('\n', 1)[1]
    with pytest.raises(ImportDataError, match='has numbers where .* set file.header_rows: 0'):
        load({'t': T, 'q': Q}, text, edit=bare)
    log = load({'t': T, 'q': Q}, 'file: {header_rows: 0}' + BY_NUMBER, edit=bare)
    np.testing.assert_array_equal(log.recording.q_link[:, 0], Q)
    np.testing.assert_allclose(log.recording.time, T)


@pytest.mark.parametrize(('factor', 'torque', 'unit', 'said'), [
    (1.0, 1.0, 'rad', []), (1.0, 0.0, 'rad', ['the torque of j1 is always 0']),
    (90.0, 1.0, 'rad', ['j1 turns to 63 rad, 10 turns; are these degrees?']),
    (90.0, 1.0, 'deg', []), (1e4, 1.0, 'rad', [])])
def test_columns_that_look_like_others_are_suspicious(
        tmp_path, capsys, factor, torque, unit, said):
    log, import_map = tmp_path / 'log.csv', tmp_path / 'map.yaml'
    np.savetxt(log, np.column_stack([T, factor * Q, torque * DQ]), delimiter=',', header='t,q,u',
               comments='')
    import_map.write_text(PLAIN.replace('rad}', f'{unit}}}') + (
        '    torque: {column: u, unit: N m}\n'))
    assert main(['import-csv', str(log), '--map', str(import_map), '--out',
                 str(tmp_path / 'bag')]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines()
             if 'suspicious: ' in line and ('always 0' in line or 'turns' in line)]
    assert len(lines) == len(said)
    assert all(words in line for words, line in zip(said, lines, strict=True))


TURNING = PLAIN + '    link_velocity: {column: v, unit: rad/s}\n'


@pytest.mark.parametrize(('text', 'factor', 'doubted'), [
    (TURNING, 1.0, False), (TURNING, np.pi / 180.0, True), (PLAIN, 1.0, True),
    (PLAIN + '    link_velocity: {estimate: 0.02}\n', 1.0, True)])
def test_turns_that_a_measured_velocity_confirms_are_not_degrees(
        tmp_path, capsys, text, factor, doubted):
    """A pendulum that turns over; its velocity in rad/s, or computed from the angle as it is."""
    log, import_map = tmp_path / 'log.csv', tmp_path / 'map.yaml'
    np.savetxt(log, np.column_stack([T, 90.0 * Q, factor * 90.0 * DQ]), delimiter=',',
               header='t,q,v', comments='')
    import_map.write_text(text)
    assert main(['import-csv', str(log), '--map', str(import_map), '--out',
                 str(tmp_path / 'bag')]) == 0
    assert ('are these degrees?' in capsys.readouterr().out) == doubted


REAL = [('kr300/rec_A.csv', 'import_kr300.yaml'), ('kr300/rec_B.csv', 'import_kr300.yaml')] + [
    (f'bam_xl330/{motion}_{gain}.csv', 'import_bam_xl330.yaml') for gain in ('kp100', 'kp400')
    for motion in ('lift_and_drop', 'sin_sin', 'sin_time_square', 'up_and_down')]


@pytest.mark.parametrize(('name', 'import_map'), REAL)
def test_real_recordings_are_suspicious_only_with_their_torque_reversed(name, import_map):
    if not (path := DATA / name).is_file():
        pytest.skip(f'{path} is not on this machine')
    right = import_csv(path, ROOT / 'config' / import_map).recording
    wrong = suspicions(replace(right, tau_motor=-right.tau_motor))
    # where gravity and friction are not separable without the robot, it is only not understood
    of_torque = re.compile('torques? of axis|torques? of joint')
    assert [any(map(of_torque.search, texts)) for texts in (suspicions(right), wrong)] == [
        False, True]
