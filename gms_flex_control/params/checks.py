# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Checks every parameter class shares; each failure names the field, the value and the way out."""

from dataclasses import fields

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.key import keys_of
import numpy as np


def freeze_arrays(instance, *, skip=()) -> None:
    """Replace the array fields of a frozen dataclass by read-only float arrays."""
    for field in fields(instance):
        if field.name in skip:
            continue
        try:
            value = np.array(getattr(instance, field.name), dtype=float)
        except (TypeError, ValueError) as error:
            raise ParameterError(
                f'{field.name} must be numbers, got {getattr(instance, field.name)!r}') from error
        value.setflags(write=False)
        object.__setattr__(instance, field.name, value)


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
