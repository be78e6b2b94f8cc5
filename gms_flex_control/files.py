# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Files appear whole or not at all; YAML is read only as far as it is small and plain."""

from contextlib import contextmanager, suppress
import errno
import os
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import AliasEvent

LARGEST_YAML = 1_000_000  # bytes; parameters, maps and metadata of bags have some thousands


@contextmanager
def atomic_path(path):
    """
    Yield a temporary path beside ``path`` that takes its name when the block succeeds.

    Parameters
    ----------
    path : str or Path
        The file to be written; its folder is made if need be.

    Yields
    ------
    Path
        Write here. On an exception the file is removed and ``path`` stays as it was.

    """
    path = Path(path)
    make_folder(path.parent, path)
    # the suffix stays last: writers such as matplotlib choose the format by it
    temporary = path.with_name(f'.{path.stem}.{os.getpid()}{path.suffix}')
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename is None or Path(error.filename) != temporary:
            raise
        raise OSError(error.errno, f'cannot be written ({error.strerror})',
                      str(path)) from error
    finally:
        with suppress(OSError):  # what could not be made is not there either
            temporary.unlink()


def make_folder(folder, path):
    """
    Make the folder that ``path`` is to be written to, if need be.

    Parameters
    ----------
    folder, path : Path
        The folder, and what an error names.

    Raises
    ------
    OSError
        If it cannot be made: NotADirectoryError where a file is in its way.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise NotADirectoryError(errno.ENOTDIR, f'{error.filename} is a file; name a folder',
                                 str(path)) from error


def read_yaml(path, typ='rt', largest=LARGEST_YAML):
    """
    Read a YAML file that somebody else may have written.

    Parameters
    ----------
    path : str or Path
        The file.
    typ : {'rt', 'safe'}
        With line numbers, or plain Python objects; neither makes anything else.
    largest : int
        Size from which on it is refused [bytes].

    Returns
    -------
    object
        What the file holds.

    Raises
    ------
    OSError
        If it cannot be read or is too large.
    UnicodeDecodeError
        If it is not UTF-8.
    ruamel.yaml.error.YAMLError
        If it is not YAML, nested too deeply, or has aliases: a few lines of those stand for
        more than fits any memory.

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


def write_text(path, text):
    """Write ``text`` (str) to ``path`` whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding='utf-8')
