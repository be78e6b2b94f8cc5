# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The map of an import: which column of a foreign log is which quantity of which joint.

    value = sign * scale * unit * (column + offset)

then divided by ``gear_ratio`` (position, velocity) or multiplied by it (torque) where the
column was measured on the fast side of a gear. Every mistake is named with its line.
"""

from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.errors import ImportDataError
from gms_flex_control.file_io import read_map

_TURN = 2 * math.pi
# unit -> factor to SI; None: needs more than a factor (see import_map)
LENGTH = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}  # of a linear axis: m stands for rad, N for N m
SPEED = {'m/s': 1.0, 'mm/s': 1e-3, 'mm/min': 1e-3 / 60, 'm/min': 1 / 60}
FORCE = {'N': 1.0, 'mN': 1e-3, 'kN': 1e3}
POSITION = {'rad': 1.0, 'mrad': 1e-3, 'deg': _TURN / 360, 'mdeg': _TURN / 360e3,
            'turn': _TURN, 'counts': None, **LENGTH}
VELOCITY = {'rad/s': 1.0, 'mrad/s': 1e-3, 'deg/s': _TURN / 360, 'mdeg/s': _TURN / 360e3,
            'rpm': _TURN / 60, 'turn/s': _TURN, 'counts/s': None, **SPEED}
TORQUE = {'N m': 1.0, 'mN m': 1e-3, 'kN m': 1e3, 'N cm': 1e-2, 'A': None, 'mA': None,
          'pwm': None, **FORCE}
TIME = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
UNITS = {'position': POSITION, 'velocity': VELOCITY, 'torque': TORQUE, 'time': TIME}


# channel -> quantity
CHANNELS = {
    'link_position': 'position', 'link_velocity': 'velocity', 'motor_position': 'position',
    'motor_velocity': 'velocity', 'torque': 'torque', 'command': 'torque',
    'reference': 'position', 'reference_velocity': 'velocity'}
POSITION_OF = {'link_velocity': 'link_position', 'motor_velocity': 'motor_position',
               'reference_velocity': 'reference'}
DELIMITERS = {'tab': '\t', 'space': ' ', 'comma': ',', 'semicolon': ';'}

# how each key of a channel is read
_READ = {'column': 'column', 'sign': 'number', 'scale': 'number', 'offset': 'number',
         'gear_ratio': 'positive', 'unwrap': 'flag', 'unwrap_range': 'positive',
         'counts_per_rev': 'positive',
         'estimate': 'positive', 'full_scale': 'positive', 'voltage': 'column',
         'torque_per_volt': 'positive', 'back_emf': 'number', 'enabled': 'column',
         'torque_constant': 'positive'}
_COMMON = ('column', 'unit', 'sign', 'scale', 'offset', 'gear_ratio')
_KEYS = {'position': (*_COMMON, 'unwrap', 'unwrap_range', 'counts_per_rev'),
         'velocity': (*_COMMON, 'estimate', 'counts_per_rev'),
         'torque': (*_COMMON, 'full_scale', 'voltage', 'torque_per_volt', 'back_emf',
                    'torque_constant', 'enabled')}


class FileFormat(NamedTuple):
    """How the text is laid out."""

    delimiter: str = ','
    header_rows: int = 1  # the last of them names the columns
    decimal: str = '.'
    comment: str = ''     # lines that begin with it are skipped


class TimeColumn(NamedTuple):
    """Where time comes from: a column or a fixed rate."""

    column: str | int | None = None
    unit: str = 's'
    rate: float | None = None     # [Hz]
    drop_disorder: bool = False   # leave out samples that do not advance
    line: int = 0


class Pwm(NamedTuple):
    """What makes a torque of the duty of a drive."""

    full_scale: float | None = None
    voltage: str | float | None = None    # a column or volts
    torque_per_volt: float | None = None  # [N m/V]
    back_emf: float = 0.0                 # [V s/rad]


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One quantity of one joint."""

    name: str
    quantity: str
    line: int
    column: str | int | None = None
    unit: str = ''
    sign: float = 1.0
    scale: float = 1.0
    offset: float = 0.0
    gear_ratio: float = 1.0
    counts_per_rev: float | None = None
    unwrap: bool = False  # it begins again after a turn,
    unwrap_range: float | None = None  # or after so much, as the column has it
    estimate: float | None = None  # window of central differences [s]
    pwm: Pwm = Pwm()
    torque_constant: float | None = None  # [N m/A]; None: the torque stays in A
    enabled: str | int | None = None  # a column that is 0 while the drive gives no torque


class JointColumns(NamedTuple):
    """One joint: its motor's name in the bag ('' if rigid) and its channels by name."""

    name: str
    motor: str
    channels: dict

    @property
    def angle(self) -> 'Channel':
        """Return the channel of its link angle, of its motor angle where nobody sees the link."""
        return self.channels.get('link_position') or self.channels['motor_position']


@dataclass(frozen=True, kw_only=True)
class ImportMap:
    """A whole map, checked."""

    path: str
    time: TimeColumn
    joints: tuple
    file: FileFormat = field(default_factory=FileFormat)
    source: str = ''
    resample: float | None = None  # [Hz]


def load_map(path) -> ImportMap:
    """Return the ImportMap of a YAML file (config/import_kr300.yaml); ImportDataError if wrong."""
    try:
        top = read_map(path, ImportDataError)
    except ImportDataError as error:
        if not Path(path).is_file() or (Path(path).suffix in ('.yaml', '.yml')
                                        and 'must be a mapping' not in str(error)):
            raise
        raise ImportDataError(f'{error}: it is not an import map; were file and --map exchanged?'
                              ) from error
    if not top.keys():
        raise top.wrong('must be a mapping with time and joints')
    top.only('source', 'file', 'time', 'joints', 'resample')
    joints = top.section('joints', required=True)
    if not joints.keys():
        raise joints.wrong('names no joint; add one, such as joint1: {link_position: {...}}')
    result = ImportMap(
        path=str(path), source=top.value('source', 'text', ''), file=_file(top.section('file')),
        time=_time(top.section('time', required=True)),
        joints=tuple(_joint(joints.section(name), name) for name in joints.keys()),
        resample=top.value('resample', 'positive'))
    names = [name for joint in result.joints for name in (joint.name, joint.motor) if name]
    for name in names:
        if names.count(name) > 1:
            raise joints.wrong(f'uses the name {name!r} twice; a joint and its motor need '
                               'names of their own')
    return result


def _file(node):
    if node is None:
        return FileFormat()
    node.only('delimiter', 'header_rows', 'decimal', 'comment')
    delimiter = node.value('delimiter', 'text', ',')
    delimiter = DELIMITERS.get(delimiter, delimiter)
    if len(delimiter) != 1:
        raise node.wrong(f'must be one character or one of {", ".join(DELIMITERS)}, '
                         f'got {delimiter!r}', 'delimiter')
    decimal = node.value('decimal', 'text', '.')
    if decimal not in ('.', ',') or decimal == delimiter:
        raise node.wrong(f"must be '.' or ',' and differ from the delimiter {delimiter!r}, "
                         f'got {decimal!r}', 'decimal')
    return FileFormat(delimiter, node.value('header_rows', 'whole', 1), decimal,
                      node.value('comment', 'text', ''))


def _time(node):
    node.only('column', 'unit', 'rate', 'not_increasing')
    column, rate = node.value('column', 'column'), node.value('rate', 'positive')
    if (column is None) == (rate is None):
        raise node.wrong('needs either a column or a fixed rate [Hz], not both')
    disorder = node.value('not_increasing', 'text', 'refuse')
    if disorder not in ('refuse', 'drop'):
        raise node.wrong(f"must be 'refuse' or 'drop', got {disorder!r}", 'not_increasing')
    unit = node.choice('unit', TIME, 's' if column is None else None)
    return TimeColumn(column, unit, rate, disorder == 'drop', node.line())


def _joint(node, name):
    node.only('motor', *CHANNELS)
    channels = {key: _channel(node, key) for key in node.keys() if key != 'motor'}
    if not {'link_position', 'motor_position'} & set(channels):
        raise node.wrong('has neither link_position nor motor_position; a rigid joint has its '
                         'encoder as link_position, without motor')
    if 'link_velocity' in channels and 'link_position' not in channels:
        raise node.wrong('has link_velocity but no link_position; leave it out, or map both')
    motor = node.value('motor', 'text', '')
    used = [key for key in channels if key.startswith('motor_')]
    if used and not motor:
        raise node.wrong(f'has {used[0]} but no motor name; add motor: {name}_motor')
    if motor and 'motor_position' not in channels:
        raise node.wrong(f'names the motor {motor!r} but has no motor_position; map it, or '
                         'leave motor out for a rigid joint')
    for key, channel in channels.items():
        if channel.estimate is not None and POSITION_OF[key] not in channels:
            raise node.wrong(f'is to be estimated from {POSITION_OF[key]}, which is not mapped',
                             key)
    return JointColumns(name, motor, channels)


def _channel(joint, key):
    quantity = CHANNELS[key]
    node = joint.section(key)
    node.only(*_KEYS[quantity])
    values = {name: node.value(name, _READ[name], Pwm._field_defaults.get(
        name, getattr(Channel, name, None))) for name in _KEYS[quantity] if name != 'unit'}
    if quantity == 'torque':
        values['pwm'] = Pwm(*(values.pop(name) for name in Pwm._fields))
    if 'unit' in node.keys() or 'estimate' not in node.keys():
        values['unit'] = node.choice('unit', UNITS[quantity])
    channel = Channel(name=key, quantity=quantity, line=joint.line(key), **values)
    _check(node, channel)
    return channel


def _check(node, channel):
    if abs(channel.sign) != 1:
        raise node.wrong(f'must be 1 or -1, got {channel.sign:g}; use scale for a factor', 'sign')
    if (channel.column is None) == (channel.estimate is None):
        raise node.wrong('needs a column' + (
            ' or estimate: <window in s>, not both' if channel.quantity == 'velocity' else ''))
    needs = {'counts': ['counts_per_rev'], 'counts/s': ['counts_per_rev'],
             'pwm': ['full_scale', 'voltage', 'torque_per_volt']}
    for key in needs.get(channel.unit, []):
        if getattr(channel.pwm if channel.unit == 'pwm' else channel, key) is None:
            raise node.wrong(f'has the unit {channel.unit!r} and therefore needs {key}')
    special = {'counts_per_rev', 'torque_constant', 'full_scale', 'voltage', 'torque_per_volt'}
    allowed = ['torque_constant'] if channel.unit in ('A', 'mA') else needs.get(channel.unit, [])
    for key in special.intersection(node.keys()).difference(allowed):
        raise node.wrong(f'has no meaning with the unit {channel.unit!r}; leave it out', key)
    if channel.pwm.back_emf and channel.unit != 'pwm':
        raise node.wrong(f'has no meaning with the unit {channel.unit!r}; leave it out',
                         'back_emf')
    if channel.scale == 0:
        raise node.wrong('must not be 0', 'scale')
