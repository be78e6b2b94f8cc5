# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which hidden robots are tried, and the journal a killed run goes on from."""

import hashlib
import json
from pathlib import Path
from typing import NamedTuple

import gms_flex_control
from gms_flex_control.errors import ConfigError

_ROOT = Path(gms_flex_control.__file__).parent
# what an answer depends on
_SOURCES = ('discrepancy', 'effects', 'friction', 'dynamics', 'hidden', 'simulation')


class Job(NamedTuple):
    """One hidden robot to be tried; see hidden.cases.make_case."""

    kind: str
    seed: int
    motion: str = 'rich'
    plant: str | None = None
    duration: float = 60.0

    @property
    def key(self):
        """Return a name of its own, str."""
        return (f'{self.kind}/{self.motion}/{self.plant or "drawn"}/{self.duration:g}/'
                f'{self.seed}')


# the seeds of the figures in docs/discrepancy.md: kind, motion, how many seeds from 0 on
SETS = {
    'full': (('single', 'rich', 333), ('clean', 'rich', 60), ('double', 'rich', 60),
             ('outside', 'rich', 44), ('clutter', 'rich', 108), ('deleted', 'rich', 72),
             ('single', 'sinusoid', 54), ('single', 'polynomial', 54)),
    'quick': (('single', 'rich', 36), ('clean', 'rich', 6), ('double', 'rich', 6),
              ('outside', 'rich', 11), ('clutter', 'rich', 12), ('deleted', 'rich', 9),
              ('single', 'sinusoid', 6), ('single', 'polynomial', 6)),
}


def jobs_of(name):
    """
    Return the jobs of a set, kinds mixed evenly so that a part of a run tells of all of them.

    Parameters
    ----------
    name : str
        One of `SETS`.

    Returns
    -------
    list of Job

    """
    if name not in SETS:
        raise ConfigError(f'set {name!r} is unknown; known: {", ".join(SETS)}')
    placed = [((seed + 0.5) / count, Job(kind, seed, motion))
              for kind, motion, count in SETS[name] for seed in range(count)]
    return [job for _, job in sorted(placed, key=lambda one: one[0])]


def fingerprint():
    """Return a hash (str) of the sources an answer depends on."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for source in sorted((_ROOT / folder).rglob('*.py')):
            digest.update(source.relative_to(_ROOT).as_posix().encode() + source.read_bytes())
    return digest.hexdigest()[:16]


class Journal:
    """
    The outcomes so far, one JSON object a line, in a folder.

    Parameters
    ----------
    folder : Path
        ``outcomes.jsonl`` lies in it; made if need be.
    sources : str
        `fingerprint` of this run: outcomes of other sources are not taken.

    Raises
    ------
    ConfigError
        If the folder cannot be written.

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

    def add(self, outcome):
        """Keep an outcome (dict with 'key'), on disk at once."""
        outcome = outcome | {'sources': self._sources}
        self.outcomes[outcome['key']] = outcome
        text = json.dumps(outcome, allow_nan=False) + '\n'
        with self.path.open('a', encoding='utf-8') as file:
            if file.tell() and not self._ends_with_newline():
                text = '\n' + text
            file.write(text)

    def _ends_with_newline(self):
        with self.path.open('rb') as file:
            file.seek(-1, 2)
            return file.read(1) == b'\n'
