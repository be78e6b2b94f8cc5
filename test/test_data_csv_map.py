# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Maps for imports: what ships loads, every mistake is named with its line and the way out."""

from pathlib import Path

from gms_flex_control.data.csv_map import load_map
from gms_flex_control.errors import ImportDataError
import pytest

pytestmark = pytest.mark.fast

CONFIG = Path(__file__).resolve().parents[1] / 'config'
GOOD = """time: {column: t, unit: s}
joints:
  j1:
    motor: m1
    link_position: {column: q, unit: deg}
    motor_position: {column: m, unit: counts, counts_per_rev: 4096}
    torque: {column: i, unit: A, torque_constant: 0.1}
"""


def test_a_map_loads_with_its_lines(tmp_path):
    path = tmp_path / 'map.yaml'
    path.write_text(GOOD)
    joint = load_map(path).joints[0]
    assert (joint.name, joint.motor) == ('j1', 'm1')
    assert joint.channels['torque'].line == 7
    assert joint.channels['motor_position'].counts_per_rev == 4096.0


@pytest.mark.parametrize('path', sorted(CONFIG.glob('import_*.yaml')), ids=lambda path: path.stem)
def test_shipped_maps_load(path):
    assert load_map(path).joints


@pytest.mark.parametrize(('old', 'new', 'line', 'match'), [
    ('column: q', 'colum: q', 5, "colum is not a key here; did you mean 'column'"),
    ('link_position', 'link_positon', 5, "did you mean 'link_position'"),
    ('unit: deg', 'unit: degr', 5, "unit 'degr' is not usable here; did you mean 'deg'"),
    ('unit: deg', 'unit: rpm', 5, r'not usable here.*one of rad, mrad, deg'),
    ('unit: deg', 'unit: 7', 5, "unit '?7'? is not usable"),
    (', unit: deg', '', 5, 'lacks unit; one of rad'),
    ('unit: deg', 'unit: deg, sign: 2', 5, 'must be 1 or -1, got 2'),
    ('unit: deg', 'unit: deg, scale: yes please', 5, "must be a number, got 'yes please'"),
    ('unit: deg', 'unit: deg, scale: 0', 5, 'must not be 0'),
    ('unit: deg', 'unit: deg, offset: .nan', 5, 'must be finite'),
    ('unit: deg', 'unit: deg, gear_ratio: -3', 5, 'must be positive, got -3'),
    ('unit: deg', 'unit: deg, unwrap: 1', 5, 'must be true or false'),
    ('unit: deg', 'unit: deg, counts_per_rev: 9', 5, "no meaning with the unit 'deg'"),
    (', counts_per_rev: 4096', '', 6, "unit 'counts' and therefore needs counts_per_rev"),
    ('unit: A, torque_constant: 0.1', 'unit: pwm, full_scale: 100', 7, 'needs voltage'),
    ('torque_constant: 0.1', 'torque_constant: 0.1, back_emf: 1', 7, 'leave it out'),
    ('motor: m1', 'motor: j1', 2, "uses the name 'j1' twice"),
    ('    motor: m1\n', '', 3, 'has motor_position but no motor name; add motor: j1_motor'),
    ('motor_position: {column: m, unit: counts, counts_per_rev: 4096}',
     'motor_velocity: {estimate: 0.1}', 3, 'has no motor_position'),
    ('link_position: {column: q, unit: deg}', 'link_velocity: {column: q, unit: deg/s}', 3,
     'has link_velocity but no link_position'),
    ('    link_position: {column: q, unit: deg}\n    motor_position:', '    reference:', 3,
     'has neither link_position nor motor_position'),
    ('torque: {column: i, unit: A, torque_constant: 0.1}',
     'reference_velocity: {estimate: 0.1}', 7,
     'is to be estimated from reference, which is not mapped'),
    ('torque: {column: i, unit: A, torque_constant: 0.1}', 'link_velocity: {column: v, '
     'unit: rad/s, estimate: 0.1}', 7, 'estimate: <window in s>, not both'),
    ('torque: {column: i, unit: A, torque_constant: 0.1}', 'torque: 3', 7, 'must be a mapping'),
    ('{column: t, unit: s}', '{column: t, rate: 100}', 1, 'either a column or a fixed rate'),
    ('{column: t, unit: s}', '{rate: 0}', 1, 'must be positive, got 0'),
    ('{column: t, unit: s}', '{column: t, not_increasing: skip}', 1, "'refuse' or 'drop'"),
    ('time: {column: t, unit: s}\n', '', 1, "lacks 'time'"),
    ('time:', 'file: {delimiter: ";;"}\ntime:', 1, 'must be one character'),
    ('time:', 'file: {decimal: ","}\ntime:', 1, "differ from the delimiter ','"),
    ('time:', 'file: {header_rows: -1}\ntime:', 1, 'whole number from 0'),
    ('time:', 'resample: fast\ntime:', 1, 'must be a number'),
    ('torque:', 'link_position:', 7, 'not valid YAML'),
    ('motor: m1', 'motor: [m1', 5, 'not valid YAML'),
    ('j1:', '1:', 2, 'joints.1 is not text; put it in quotes')])
def test_a_mistake_in_a_map_is_named_with_its_line(tmp_path, old, new, line, match):
    path = tmp_path / 'map.yaml'
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(ImportDataError, match=match) as caught:
        load_map(path)
    assert f'map.yaml:{line}:' in str(caught.value)


@pytest.mark.parametrize(('text', 'match'), [
    ('', 'must be a mapping with time and joints'), ('- 1', 'must be a mapping'),
    ('time: {rate: 1}\njoints: {}', 'names no joint')])
def test_a_map_without_content_is_refused(tmp_path, text, match):
    (tmp_path / 'map.yaml').write_text(text)
    with pytest.raises(ImportDataError, match=match):
        load_map(tmp_path / 'map.yaml')


def test_a_map_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ImportDataError, match='none.yaml: cannot be read'):
        load_map(tmp_path / 'none.yaml')
    (tmp_path / 'map.yaml').write_bytes(b'\xff\xfe')
    with pytest.raises(ImportDataError, match='is not UTF-8 text'):
        load_map(tmp_path / 'map.yaml')
