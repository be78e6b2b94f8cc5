# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""One value against its key: type, range, choice."""

import math

from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError
from gms_flex_control.params.robot import WHOLE_ARM
from gms_flex_control.params.uncertainty import KINDS, LEAST, MOST
from gms_flex_control.schema.key import Key, SMALLEST
from gms_flex_control.schema.keys import all_keys

_NAMES = {'double': 'a number', 'integer': 'a whole number', 'string': 'a text',
          'boolean': 'true or false', 'double_array': 'a list of numbers',
          'string_array': 'a list of texts'}

_PER_JOINT = ('arm', 'friction', 'gains', 'identification', 'limits', 'mapping', 'trajectory')


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


def checked(key, value):
    """
    Return a value as the type of its key.

    Parameters
    ----------
    key : Key
        What is expected.
    value : object
        As read; whole numbers are taken for doubles.

    Returns
    -------
    object
        float, int, str, bool, or a tuple of float or str.

    Raises
    ------
    ConfigError
        If type, range or choice does not fit; the sentence begins with the key.

    """
    typed = _typed(key.kind, value)
    if typed is None:
        raise ConfigError(f'{key.name} must be {_NAMES[key.kind]}'
                          f'{f" [{key.unit}]" if key.unit else ""}, got {value!r}')
    if key.choices and typed not in key.choices:
        raise ConfigError(f"{key.name} must be one of {', '.join(key.choices)}, got {typed!r}"
                          f'{did_you_mean(typed, key.choices)}')
    if key.kind in ('double', 'integer', 'double_array'):
        for number in typed if key.kind == 'double_array' else (typed,):
            _check_range(key, number)
    return typed


def _check_range(key, number):
    infinite_allowed = key.name.startswith('arm.') and key.name.endswith('.stiffness')
    if math.isnan(number) or (math.isinf(number) and not infinite_allowed):
        raise ConfigError(f'{key.name} must be finite, got {number}')
    if not key.lower <= number <= key.upper:
        raise ConfigError(f'{key.name} must be {range_in_words(key)}'
                          f'{f" {key.unit}" if key.unit else ""}, got {number:g}')


def range_in_words(key):
    """Return what numbers a key allows, without the unit (str)."""
    if math.isfinite(key.upper):
        return f'from {key.lower:g} to {key.upper:g}'
    return 'above 0' if key.lower == SMALLEST else f'at least {key.lower:g}'


def effect_key(name, joints):
    """
    Return the key of an effect's parameter, ``effects.<joint>.<effect>.<parameter>``.

    Parameters
    ----------
    name : str
        Full key.
    joints : sequence of str
        Link names.

    Returns
    -------
    Key

    Raises
    ------
    ConfigError
        If joint, effect or parameter is unknown; the sentence names the nearest.

    """
    parts = name.split('.')
    if len(parts) != 4:
        raise ConfigError(f'{name} must have the form effects.<joint>.<effect>.<parameter>')
    _, joint, effect, parameter = parts
    _require_place(name, joint, joints)
    try:
        kind = registry.find(effect)
    except ParameterError as error:
        raise ConfigError(f'{name}: {error}') from error
    if kind.whole_arm != (joint == WHOLE_ARM):
        place = f'effects.{WHOLE_ARM}' if kind.whole_arm else 'effects.<joint>'
        raise ConfigError(f'{name}: {effect} belongs under {place}')
    known = {entry.name: entry for entry in kind.parameters}
    if parameter not in known:
        raise ConfigError(f'{name}: {effect} has no parameter {parameter!r}'
                          f'{did_you_mean(parameter, known)}')
    entry = known[parameter]
    return Key(name, 'double', entry.description, entry.unit, lower=entry.lower,
               upper=entry.upper)


def _require_place(name, joint, joints):
    """Raise ConfigError if a key's joint is none of the robot's, nor the whole arm."""
    if joint not in (*joints, WHOLE_ARM):
        raise ConfigError(f'{name}: unknown joint {joint!r}'
                          f'{did_you_mean(joint, (*joints, WHOLE_ARM))}')


def uncertainty_key(name, joints):
    """
    Return the key of a standard deviation, ``uncertainty.<joint>.<kind>``.

    Parameters
    ----------
    name : str
        Full key.
    joints : sequence of str
        Link names.

    Returns
    -------
    Key

    Raises
    ------
    ConfigError
        If joint or kind is unknown; the sentence names the nearest.

    """
    parts = name.split('.')
    if len(parts) != 3:
        raise ConfigError(f'{name} must have the form uncertainty.<joint>.<kind>')
    _, joint, kind = parts
    _require_place(name, joint, joints)
    if kind not in KINDS:
        raise ConfigError(f'{name}: unknown kind of parameter {kind!r}'
                          f'{did_you_mean(kind, KINDS)}; known: {", ".join(KINDS)}')
    return Key(name, 'double', f'relative standard deviation: {KINDS[kind].description}', '1',
               lower=LEAST, upper=MOST)


def known_keys(names, joints):
    """
    Return the key of every name.

    Parameters
    ----------
    names : iterable of str
        As found in a file.
    joints : sequence of str
        Link names.

    Returns
    -------
    dict of str to Key

    Raises
    ------
    ConfigError
        At the first unknown name, with the nearest known one.

    """
    known = all_keys(joints)
    keys = {}
    for name in names:
        if name.startswith('effects.'):
            keys[name] = effect_key(name, joints)
        elif name.startswith('uncertainty.'):
            keys[name] = uncertainty_key(name, joints)
        elif name in known:
            keys[name] = known[name]
        else:
            raise ConfigError(f'{name} is not a known parameter{_nearest(name, known, joints)}')
    return keys


def _nearest(name, known, joints):
    parts = name.split('.')
    if len(parts) > 2 and parts[0] in _PER_JOINT and parts[1] not in joints:
        return f'; unknown joint {parts[1]!r}{did_you_mean(parts[1], joints)}'
    return did_you_mean(name, [key for key in known if key.count('.') == name.count('.')])
