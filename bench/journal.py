# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Outcomes of a bench that are kept: a killed run goes on when started again."""

import hashlib
import json
from pathlib import Path

import gms_flex_control
from gms_flex_control.batches import run_batch
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


def digest_of(values) -> str:
    """Return 16 hexadecimal digits that stand for plain values, distinguished by their repr."""
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]


def run_kept(function, items: dict, args, sources: str, label: str) -> dict:
    """
    Return what ``function``, of a module, makes of many items by their keys: plain values.

    ``args`` of the verb has ``workers`` and ``out``, a folder whose Journal keeps outcomes of the
    same ``sources``. All of it goes through JSON, so that it is the same whether it was kept or
    just found.
    """
    journal = Journal(args.out, sources)
    run_batch(function, {key: item for key, item in items.items() if key not in journal.outcomes},
              args.workers, label, lambda key, value: journal.add({'key': key, 'value': value}))
    return {key: json.loads(json.dumps(journal.outcomes[key]['value'])) for key in items}
