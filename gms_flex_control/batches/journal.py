# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a batch has done so far, kept by a hash of the sources that its results depend on."""

import hashlib
import json
from pathlib import Path

import gms_flex_control
from gms_flex_control.errors import ConfigError

ROOT = Path(gms_flex_control.__file__).parent


class Journal:
    """
    The outcomes so far, in ``folder`` / outcomes.jsonl; the folder is made if need be.

    Outcomes of other ``sources``, a hash of all they depend on beside their key, are not taken.
    ConfigError is raised if the folder cannot be written.
    """

    def __init__(self, folder, sources):
        self.path, self._sources = Path(folder) / 'outcomes.jsonl', sources
        self.outcomes, self.stale = {}, 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            lines = self.path.read_text('utf-8').splitlines() if self.path.exists() else []
        except OSError as error:
            raise ConfigError(f'--out {folder}: {error.strerror}; name a folder that can be '
                              'written') from error
        for line in lines:
            self._take(line)

    def _take(self, line):
        try:
            outcome = json.loads(line)
            key, sources = outcome['key'], outcome['sources']
        except (ValueError, KeyError, TypeError):
            return  # the line a killed run did not finish
        if sources != self._sources:
            self.stale += 1
            return
        self.outcomes[key] = outcome

    def add(self, outcome) -> None:
        """Keep an outcome (dict with 'key'), on disk at once."""
        outcome = outcome | {'sources': self._sources}
        self.outcomes[outcome['key']] = outcome
        text = json.dumps(outcome, allow_nan=False) + '\n'
        with self.path.open('ab+') as file:
            if file.tell():
                file.seek(-1, 2)
                text = text if file.read(1) == b'\n' else '\n' + text
            file.write(text.encode())


def fingerprint(parts=('.',), root: Path = ROOT) -> str:
    """Return a hash (16 digits) of folders or modules within ``root``, by default all."""
    digest = hashlib.sha256()
    for part in parts:
        path = root / part
        for source in [path] if path.is_file() else sorted(path.rglob('*.py')):
            digest.update(source.relative_to(root).as_posix().encode() + source.read_bytes())
    return digest.hexdigest()[:16]


def content_of(bag) -> list:
    """Return names, sizes and times of a bag's files: another recording is not taken for it."""
    path = Path(bag)
    files = [path] if path.is_file() else sorted(one for one in path.rglob('*') if one.is_file())
    return [(one.name, one.stat().st_size, one.stat().st_mtime_ns) for one in files]


def digest_of(values) -> str:
    """Return 16 hexadecimal digits that stand for plain values, distinguished by their repr."""
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]
