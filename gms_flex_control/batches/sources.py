# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A hash of the sources that a result depends on: what other sources found is not mixed in."""

import hashlib
from pathlib import Path

import gms_flex_control

ROOT = Path(gms_flex_control.__file__).parent


def fingerprint(parts=('.',), root=ROOT):
    """
    Return a hash of sources, of the package unless said otherwise.

    Parameters
    ----------
    parts : sequence of str
        Folders or modules within ``root``; default all of it.
    root : Path
        Where they stand.

    Returns
    -------
    str
        16 hexadecimal digits.

    """
    digest = hashlib.sha256()
    for part in parts:
        path = root / part
        for source in [path] if path.is_file() else sorted(path.rglob('*.py')):
            digest.update(source.relative_to(root).as_posix().encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def content_of(bag):
    """Return names, sizes and times of a bag's files: another recording is not taken for it."""
    path = Path(bag)
    files = [path] if path.is_file() else sorted(one for one in path.rglob('*') if one.is_file())
    return [(one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in files]


def digest_of(values):
    """Return 16 hexadecimal digits that stand for plain values, told apart by their repr."""
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]
