# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Files appear whole or not at all, mistakes in YAML have a line; files of the package."""

from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
import errno
from io import StringIO
import json
import math
import os
from pathlib import Path
import sys
from typing import Any, Self

from gms_flex_control.errors import ConfigError, did_you_mean
import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent

LARGEST_YAML = 1_000_000  # bytes; parameters, maps and metadata of bags have some thousands
# of `written_together`: temporary path -> its final one, and whether the folder was made for it
_together: ContextVar[dict | None] = ContextVar('together', default=None)


@contextmanager
def written_together() -> Generator[None]:
    """
    Let all files that the block writes by `atomic_path` appear when it succeeds, or none.

    A full disk half-way leaves what was there before. Blocks may be nested: the outermost counts.
    """
    if _together.get() is not None:
        yield
        return
    written: dict[Path, tuple[Path, bool]] = {}
    token = _together.set(written)
    try:
        yield
        for temporary, (path, _) in written.items():
            os.replace(temporary, path)
    finally:
        _together.reset(token)
        _remove(written, {temporary.parent for temporary, (_, made) in written.items() if made})


def _remove(temporaries, folders):
    """Remove temporary files that are still there, then folders that are empty."""
    for remove, paths in ((Path.unlink, temporaries), (Path.rmdir, folders)):
        for path in paths:
            with suppress(OSError):  # what could not be made is not there either
                remove(path)


@contextmanager
def atomic_path(path) -> Generator[Path]:
    """
    Yield a temporary path beside ``path`` that takes its name when the block succeeds.

    Of a link it takes the place of what the link leads to; a pipe or a device is written itself.
    """
    path = Path(path)
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    made = not target.parent.exists()
    make_folder(target.parent, path)
    # the suffix stays last: writers such as matplotlib choose the format by it
    temporary = target.with_name(f'.{target.stem}.{os.getpid()}{target.suffix}')
    if path.exists() and not (path.is_file() or path.is_dir()):
        temporary = target = path  # a pipe or a device, which no file may replace
    try:
        yield temporary
        if temporary == target:
            return
        if (together := _together.get()) is None:
            os.replace(temporary, target)
        else:
            together[temporary] = target, made
    except OSError as error:
        # one without a name is of the open file, such as that the disk is full
        if error.filename is not None and Path(error.filename) != temporary:
            raise
        raise OSError(error.errno, f'cannot be written ({error.strerror})', str(path)) from error
    finally:
        if temporary not in (target, *(_together.get() or ())):
            _remove([temporary], [target.parent] * made)


def make_folder(folder, path) -> None:
    """
    Make the folder that ``path`` is to be written to, if need be.

    OSError if it cannot be made: NotADirectoryError, naming ``path``, where a file is in its way.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise NotADirectoryError(errno.ENOTDIR, f'{error.filename} is a file; name a folder',
                                 str(path)) from error


def read_yaml(path, typ='rt', largest=LARGEST_YAML) -> object:
    """
    Return what a YAML file holds that somebody else may have written.

    ``typ`` is 'rt', with line numbers, or 'safe', plain Python objects; neither makes anything
    else. OSError if it cannot be read or is larger than ``largest`` bytes, UnicodeDecodeError if
    it is not UTF-8, YAMLError of ruamel if it is not YAML, nested too deeply, or has aliases: a
    few lines of those stand for more than fits any memory.
    """
    path = Path(path)
    if path.stat().st_size > largest:
        raise OSError(errno.EFBIG, f'larger than {largest} bytes', str(path))
    text = path.read_text(encoding='utf-8')
    try:
        for event in YAML().parse(text) if '*' in text else ():
            if isinstance(event, AliasEvent):
                raise MarkedYAMLError(problem='aliases (*name) are not allowed: write it out',
                                      problem_mark=event.start_mark)
        return YAML(typ=typ).load(text)
    except RecursionError:
        raise MarkedYAMLError(problem='nested too deeply') from None


def checked_yaml(path, error: type, typ='rt') -> object:
    """Return what `read_yaml` does; an ``error`` in one sentence if that cannot be."""
    try:
        return read_yaml(path, typ)
    except OSError as cause:
        raise error(f'{path}: cannot be read ({cause.strerror})') from cause
    except UnicodeDecodeError as cause:
        raise error(f'{path}: is not UTF-8 text (byte {cause.start})') from cause
    except YAMLError as cause:
        mark = getattr(cause, 'problem_mark', None)
        line = f':{mark.line + 1}' if mark else ''
        problem = getattr(cause, 'problem', None) or str(cause)
        raise error(f'{path}{line}: is not valid YAML ({" ".join(problem.split())})') from cause


def write_text(path, text) -> None:
    """Write ``text`` (str) to ``path`` whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding='utf-8')


def as_yaml(data, *, inline_lists=False) -> str:
    """Return plain data as YAML text, no line of it wrapped and no value an alias."""
    yaml, text = YAML(), StringIO()
    yaml.default_flow_style, yaml.width = None if inline_lists else False, LARGEST_YAML
    yaml.representer.ignore_aliases = lambda _: True
    yaml.dump(data, text)
    return text.getvalue()


def plain(value, words: Callable = str) -> Any:
    """Return data as JSON knows it, None for what is not finite, ``words`` applied to texts."""
    if isinstance(value, dict):
        return {key: plain(item, words) for key, item in value.items()}
    if hasattr(value, 'tolist'):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item, words) for item in value]
    if isinstance(value, str):
        return words(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_json(value) -> str:
    """Return `plain` data as strict JSON text."""
    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False)


def write_json(path, value) -> None:
    """Write `as_json` to ``path``, whole or not at all."""
    write_text(path, as_json(value) + '\n')


PACKAGE = 'gms_flex_control'


def share_path() -> Path:
    """
    Return the folder that holds ``package.xml``, ``config/`` and ``launch/``.

    The source tree where the package runs from one (pip's editable installation and ``colcon build
    --symlink-install`` do), else ``share/gms_flex_control`` of the prefix it was installed to.
    ConfigError if the package was copied without its files.
    """
    candidates = list(_candidates())
    for path in candidates:
        if (path / 'package.xml').is_file() and (path / 'config').is_dir():
            return path
    searched = ', '.join(map(str, dict.fromkeys(candidates)))
    raise ConfigError(f'the config folder of {PACKAGE} is in none of {searched}; '
                      'install the package with pip or colcon, or name the file to read')


def robot_file() -> Path:
    """Return the default robot file, ``config/robot.yaml`` of the package."""
    return share_path() / 'config' / 'robot.yaml'


def controller_file() -> Path:
    """Return the default controller file, ``config/controller.yaml`` of the package."""
    return share_path() / 'config' / 'controller.yaml'


def _candidates():
    source = Path(__file__).resolve().parents[1]
    yield source
    # <prefix>/lib/python3.x/site-packages for pip, --user, --prefix and colcon alike
    if len(source.parents) > 2:
        yield source.parents[2] / 'share' / PACKAGE
    for prefix in [sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]:
        if prefix:
            yield Path(prefix) / 'share' / PACKAGE


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
                raise self.wrong('is not text; put it in quotes', str(key))
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
                raise self.wrong(f'is not a key here{did_you_mean(key, known)}', str(key))

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
    """Return the YamlMap of a file, empty or a mapping; ``error`` if neither, or unreadable."""
    data = checked_yaml(path, error)
    data = CommentedMap() if data is None else data
    if not hasattr(data, 'lc') or not hasattr(data, 'keys'):
        raise error(f'{path}: must be a mapping, got {type(data).__name__}')
    return YamlMap(data, str(path), error)
