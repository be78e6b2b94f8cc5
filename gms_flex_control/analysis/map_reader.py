# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""YAML mappings that know their line and place, so that every mistake can be pointed at."""

import math

from gms_flex_control.analysis import units
from gms_flex_control.errors import did_you_mean, ImportDataError
from gms_flex_control.files import read_yaml
from ruamel.yaml.error import YAMLError

_MISSING = object()


def read_map(path):
    """
    Read a YAML file whose top level is a mapping.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    MapNode

    Raises
    ------
    ImportDataError
        If it cannot be read, is no YAML or no mapping.

    """
    try:
        data = read_yaml(path)
    except OSError as error:
        raise ImportDataError(f'{path}: the map cannot be read ({error.strerror}); '
                              'give an existing file with --map') from error
    except UnicodeDecodeError as error:
        raise ImportDataError(f'{path}: the map is not UTF-8 text (byte {error.start}); '
                              'is it the log itself?') from error
    except YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        where = f':{mark.line + 1}' if mark else ''
        problem = getattr(error, 'problem', None) or str(error)
        raise ImportDataError(f'{path}{where}: the map is no valid YAML '
                              f'({" ".join(problem.split())})') from error
    if not hasattr(data, 'lc') or not hasattr(data, 'keys'):
        raise ImportDataError(f'{path}: the map must be a mapping with time and joints, '
                              f'got {type(data).__name__}')
    return MapNode(data, str(path), '', 1)


class MapNode:
    """
    One mapping of the file.

    Parameters
    ----------
    data : ruamel.yaml.CommentedMap
        Its content.
    path : str
        The file, for messages.
    place : str
        Dotted place in the file, '' at the top.
    first_line : int
        Line the mapping is introduced at.

    """

    def __init__(self, data, path, place, first_line):
        self._data = data
        self._path = path
        self._place = place
        self._line = first_line

    def keys(self):
        """Return the keys in order (list of str)."""
        return [str(key) for key in self._data]

    def line(self, key=None):
        """Return the line of ``key``, of the mapping itself by default."""
        if key in self._data:
            return self._data.lc.key(key)[0] + 1
        return self._line

    def wrong(self, problem, key=None):
        """Return an ImportDataError that names file, line and place."""
        place = '.'.join(filter(None, [self._place, key]))
        return ImportDataError(f'{self._path}:{self.line(key)}: {place or "the map"} {problem}')

    def only(self, *known):
        """Refuse keys other than ``known``."""
        for key in self._data:
            if key not in known:
                raise self.wrong(f'is no key here{did_you_mean(key, known)}', str(key))

    def value(self, key, default=None):
        """Return the plain value of ``key``."""
        return self._data.get(key, default)

    def section(self, key, required=False):
        """Return a nested mapping, None if it is not there."""
        data = self._data.get(key)
        if data is None and key not in self._data and not required:
            return None
        if data is None and key not in self._data:
            raise self.wrong(f'lacks {key!r}')
        if not hasattr(data, 'keys'):
            raise self.wrong(f'must be a mapping, got {data!r}', key)
        return MapNode(data, self._path, '.'.join(filter(None, [self._place, key])),
                       self.line(key))

    def text(self, key, default):
        """Return a string."""
        value = self._data.get(key, default)
        if not isinstance(value, str):
            raise self.wrong(f'must be text, got {value!r}; put it in quotes', key)
        return str(value)

    def flag(self, key):
        """Return a bool, False if it is not there."""
        value = self._data.get(key, False)
        if not isinstance(value, bool):
            raise self.wrong(f'must be true or false, got {value!r}', key)
        return value

    def whole(self, key, default):
        """Return an int that is not negative."""
        value = self._data.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise self.wrong(f'must be a whole number from 0, got {value!r}', key)
        return int(value)

    def number(self, key, default, positive=False):
        """Return a finite float, ``default`` if it is not there."""
        value = self._data.get(key, _MISSING)
        if value is _MISSING:
            return default
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.wrong(f'must be a number, got {value!r}', key)
        if not math.isfinite(value) or (positive and value <= 0):
            raise self.wrong(f'must be {"positive" if positive else "finite"}, got {value}', key)
        return float(value)

    def column(self, key):
        """Return a column name or number, None if it is not there."""
        value = self._data.get(key)
        if value is None and key not in self._data:
            return None
        if isinstance(value, bool) or not isinstance(value, (str, int, float)):
            raise self.wrong(f'must be a column name or number, got {value!r}', key)
        return str(value) if isinstance(value, str) else float(value) if isinstance(
            value, float) else int(value)

    def unit(self, key, known, default=None):
        """Return the canonical name of a unit among ``known``."""
        value = self._data.get(key, default)
        if value is None:
            raise self.wrong(f'lacks {key}; one of {", ".join(known)}')
        name = units.canonical(value)
        if name not in known:
            raise self.wrong(f'{value!r} is not usable here{did_you_mean(name, known)} '
                             f'(one of {", ".join(known)})', key)
        return name
