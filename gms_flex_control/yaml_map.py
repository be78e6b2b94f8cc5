# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A mapping of a YAML file that somebody wrote: every mistake is named with its line."""

import math
from typing import Any, Self

from gms_flex_control.errors import did_you_mean
from gms_flex_control.file_io import checked_yaml
import numpy as np
from ruamel.yaml.comments import CommentedMap


def _any(_):
    return True


# kinds of values: types and their words, what a value of them must be and its words
_KINDS = {'text': (str, 'text in quotes', _any, ''), 'flag': (bool, 'true or false', _any, ''),
          'column': ((str, int, float), 'a column name or number', _any, ''),
          'whole': (int, 'a whole number from 0', lambda value: value >= 0,
                    'a whole number from 0'),
          'number': ((int, float), 'a number', math.isfinite, 'finite'),
          'positive': ((int, float), 'a number', lambda value: 0.0 < value < math.inf, 'positive')}


class YamlMap:
    """One mapping, which knows the line and dotted place of each key; mistakes are ``error``."""

    def __init__(self, data, path, error: type, place='', first_line=1):
        self._data = data
        self._path = path
        self._error = error
        self._place = place
        self._line = first_line

    def keys(self) -> list[str]:
        """Return the keys in order (list of str)."""
        for key in self._data:
            if not isinstance(key, str):
                raise self.wrong('is no text; put it in quotes', str(key))
        return [str(key) for key in self._data]

    def line(self, key=None) -> int:
        """Return the line of ``key``, of the mapping itself by default."""
        if key in self._data:
            return self._data.lc.key(key)[0] + 1
        return self._line

    def wrong(self, problem, key=None) -> Exception:
        """Return an error that names file, line and place."""
        place = '.'.join(filter(None, [self._place, key]))
        return self._error(f'{self._path}:{self.line(key)}: {place or "the map"} {problem}')

    def only(self, *known) -> None:
        """Refuse keys other than ``known``."""
        for key in self._data:
            if key not in known:
                raise self.wrong(f'is no key here{did_you_mean(key, known)}', str(key))

    def section(self, key, required=False, example='') -> Self | None:
        """Return a nested mapping, such as ``example``; None if it is not there."""
        if key not in self._data:
            if required:
                raise self.wrong(f'lacks {key!r}')
            return None
        data = self._data[key]
        if not hasattr(data, 'keys'):
            such = f' such as {example}' if example else ''
            raise self.wrong(f'must be a mapping{such}, got {data!r}', key)
        return YamlMap(data, self._path, self._error,
                       '.'.join(filter(None, [self._place, key])), self.line(key))

    def value(self, key, kind=None, default=None) -> Any:
        """Return the value of ``key``, of a kind of _KINDS, ``default`` if it is not there."""
        if key not in self._data or kind is None:
            return self._data.get(key, default)
        value, (types, words, fits, fitting) = self._data[key], _KINDS[kind]
        if not isinstance(value, types) or isinstance(value, bool) and types is not bool:
            raise self.wrong(f'must be {words}, got {value!r}', key)
        if not fits(value):
            raise self.wrong(f'must be {fitting}, got {value}', key)
        return next((plain(value) for plain in (str, float) if isinstance(value, plain)), value)

    def numbers(self, key, default) -> np.ndarray:
        """Return finite numbers, as many as ``default`` (N,), which they are if not there."""
        values = self._data.get(key, default)
        good = isinstance(values, (list, tuple)) and len(values) == len(default) and all(
            isinstance(one, (int, float)) and not isinstance(one, bool) and math.isfinite(one)
            for one in values)
        if not good:
            raise self.wrong(f'must be {len(default)} numbers, got {values!r}', key)
        return np.array(values, dtype=float)

    def choice(self, key, known, default=None) -> str:
        """Return one of ``known``, such as units."""
        value = self._data.get(key, default)
        if value is None:
            raise self.wrong(f'lacks {key}; one of {", ".join(known)}')
        if value not in known:
            raise self.wrong(f'{value!r} is not usable here{did_you_mean(value, known)} '
                             f'(one of {", ".join(known)})', key)
        return value


def read_map(path, error: type) -> YamlMap:
    """
    Return the YamlMap of a file whose top level is a mapping; of an empty file without keys.

    An ``error`` if it cannot be read, is no YAML or no mapping.
    """
    data = checked_yaml(path, error)
    data = CommentedMap() if data is None else data
    if not hasattr(data, 'lc') or not hasattr(data, 'keys'):
        raise error(f'{path}: must be a mapping, got {type(data).__name__}')
    return YamlMap(data, str(path), error)
