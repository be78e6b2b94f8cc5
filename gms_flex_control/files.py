# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Files appear whole or not at all."""

from contextlib import contextmanager
import os
from pathlib import Path


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
    path.parent.mkdir(parents=True, exist_ok=True)
    # the suffix stays last: writers such as matplotlib choose the format by it
    temporary = path.with_name(f'.{path.stem}.{os.getpid()}{path.suffix}')
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path, text):
    """Write ``text`` (str) to ``path`` whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding='utf-8')
