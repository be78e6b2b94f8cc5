# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What one parameter of a node or file is, and whether values fit it."""

from dataclasses import dataclass, field, fields, replace
from functools import cache
import math
from typing import Any

from gms_flex_control.errors import ConfigError, nearest, ParameterError
import numpy as np

REQUIRED = object()
_NO_UNIT = '', '1'
LARGEST_STATE = 1e6  # beyond it an angle or velocity is a fault, though finite [rad, rad/s]
LARGEST = 1e9  # likewise a torque, a mass, or what else a robot has, in SI units
SMALLEST = 1e-12  # of what must be above zero
_NAMES = {'double': 'a number', 'integer': 'a whole number', 'string': 'a text',
          'boolean': 'true or false', 'double_array': 'a list of numbers',
          'string_array': 'a list of texts'}


@dataclass(frozen=True)
class Key:
    """One parameter."""

    name: str            # full, such as gains.joint1.kd_link
    description: str
    unit: str = ''
    default: Any = REQUIRED     # REQUIRED if a file must give it
    lower: float = -math.inf    # closed range of numbers
    upper: float = math.inf
    kind: str = ''       # its ROS type, double_array or the like; '' is that of the default
    choices: tuple = ()  # of a string; empty if any
    live: bool = False   # whether it may change while the node runs
    unless: tuple = ()   # name and value of another beside which it has a default: that

    def __post_init__(self):
        object.__setattr__(self, 'kind', self.kind or _kind_of(self.default))

    def default_beside(self, given: dict) -> Any:
        """Return the default beside the values ``given`` (dict), REQUIRED if it has none."""
        if self.unless and given.get(self.unless[0]) == self.unless[1]:
            return self.unless[2]
        return self.default


def _kind_of(default):
    """Return the ROS type of a default; a number where it has none."""
    if isinstance(default, tuple):
        return f'{_kind_of(default[0])}_array' if default else 'string_array'
    return {bool: 'boolean', int: 'integer', str: 'string'}.get(type(default), 'double')


def number(description: str, unit: str = '', preset=REQUIRED, lower=-math.inf, upper=math.inf,
           *, kind='', live=False, unless=(), **of_field) -> Any:
    """Return a dataclass field that carries the Key of its parameter, see `keys_of`."""
    return field(metadata={'key': Key('', description, unit, preset, lower, upper, kind=kind,
                                      live=live, unless=unless)}, **of_field)


@cache
def keys_of(params: type) -> tuple[Key, ...]:
    """Return the keys of a dataclass whose fields were made by `number`, in their order."""
    return tuple(replace(one.metadata['key'], name=one.name) for one in fields(params)
                 if one.metadata)


def below(prefix: str, keys) -> tuple[Key, ...]:
    """Return keys with ``prefix`` and a dot before their names."""
    return tuple(replace(key, name=f'{prefix}.{key.name}') for key in keys)


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _typed(kind, value):
    """Return ``value`` as its Python type, or None where it is of another type."""
    if kind == 'double' and _is_number(value):
        try:
            return float(value)
        except OverflowError:  # a whole number beyond all doubles
            return math.inf if value > 0 else -math.inf
    if kind == 'integer' and isinstance(value, int) and not isinstance(value, bool):
        return int(value)
    if kind == 'boolean' and isinstance(value, bool):
        return value
    if kind == 'string' and isinstance(value, str):
        return str(value)
    if not kind.endswith('_array') or isinstance(value, (str, bytes)):
        return None
    try:
        items = tuple(_typed(kind.removesuffix('_array'), item) for item in value)
    except TypeError:
        return None
    return None if None in items else items


def checked(key: Key, value) -> Any:
    """Return a value as the type of its key: float, int, str, bool, or a tuple of float or str."""
    typed = _typed(key.kind, value)
    if typed is None:
        unit = f' [{key.unit}]' if key.unit not in _NO_UNIT else ''
        raise ConfigError(f'{key.name} must be {_NAMES[key.kind]}{unit}, got {value!r}')
    if key.choices and typed not in key.choices:
        raise ConfigError(f"{key.name} must be one of {', '.join(key.choices)}, got {typed!r}"
                          f'{nearest(typed, key.choices)}')
    if key.kind in ('double', 'integer', 'double_array'):
        for number in typed if key.kind == 'double_array' else (typed,):
            _check_range(key, number)
    return typed


def _check_range(key, number):
    infinite_allowed = key.name.startswith('arm.') and key.name.endswith('.stiffness')
    if math.isnan(number) or (math.isinf(number) and not infinite_allowed):
        raise ConfigError(f'{key.name} must be finite, got {number}')
    if not key.lower <= number <= key.upper:
        unit = f' {key.unit}' if key.unit not in _NO_UNIT else ''
        raise ConfigError(f'{key.name} must be {range_in_words(key)}{unit}, got {number:g}')


def range_in_words(key: Key) -> str:
    """Return what numbers a key allows, without the unit (str)."""
    least = 'above 0' if key.lower == SMALLEST else f'at least {key.lower:g}'
    if not math.isfinite(key.upper):
        return least
    return (f'{least}, at most {key.upper:g}' if key.lower == SMALLEST else
            f'from {key.lower:g} to {key.upper:g}')


def freeze_arrays(instance, *, skip=()) -> None:
    """Replace the array fields of a frozen dataclass by read-only float arrays."""
    for one in fields(instance):
        if one.name in skip:
            continue
        try:
            value = np.array(getattr(instance, one.name), dtype=float)
        except (TypeError, ValueError) as error:
            raise ParameterError(
                f'{one.name} must be numbers, got {getattr(instance, one.name)!r}') from error
        value.setflags(write=False)
        object.__setattr__(instance, one.name, value)


def of_joints(params, columns, **others) -> Any:
    """Return the parameters of some joints (list of int) in that order, ``others`` replaced."""
    return replace(params, **{key.name: getattr(params, key.name)[columns]
                              for key in keys_of(type(params))}, **others)


def require_shape(name: str, value: np.ndarray, shape: tuple) -> None:
    """Raise ParameterError unless ``value`` has ``shape``."""
    if value.shape != shape:
        raise ParameterError(f'{name} must have shape {shape} (one entry per joint), '
                             f'got shape {value.shape}')


def require_finite(name: str, value, *, above=None, at_least=None) -> None:
    """Raise ParameterError unless all entries are finite and within the open or closed bound."""
    if not np.all(np.isfinite(value)):
        raise ParameterError(f'{name} must be finite, got {value}')
    if above is not None and not np.all(value > above):
        raise ParameterError(f'{name} must be above {above:g}, got {value}')
    if at_least is not None and not np.all(value >= at_least):
        raise ParameterError(f'{name} must be at least {at_least:g}, got {value}')


def require_ranges(instance, shape: tuple, prefix: str = '') -> None:
    """Raise ParameterError unless all fields with a Key have ``shape``, and a sign it allows."""
    for key in keys_of(type(instance)):
        name, value = prefix + key.name, getattr(instance, key.name)
        require_shape(name, value, shape)
        require_finite(name, value, above=0.0 if key.lower > 0.0 else None,
                       at_least=0.0 if key.lower == 0.0 else None)
