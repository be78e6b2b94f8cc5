# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Finished trials of a recovery in a file, one a line, so that a long run can be gone on with."""

import json
from pathlib import Path

from gms_flex_control.errors import IdentificationError
from gms_flex_control.files import write_text
from gms_flex_control.identification.recovery import Trial
from gms_flex_control.identification.result import Estimate, Interval


class TrialJournal:
    """
    The trials of one setting, kept on disk.

    Parameters
    ----------
    path : str or Path
        The file; made with the first trial.
    settings : dict
        What the trials are about, of plain values.

    Raises
    ------
    IdentificationError
        If the file is of other settings, or no journal.

    """

    def __init__(self, path, settings):
        self._path, self._settings = Path(path), settings
        self.trials = {}
        if self._path.exists():
            self._read()

    def _read(self):
        try:
            lines = self._path.read_text(encoding='utf-8').split('\n')
            settings = json.loads(lines[0])
            # what follows the last newline was cut off
            trials = [_trial_of(json.loads(line)) for line in lines[1:-1]]
        except OSError as error:
            raise IdentificationError(
                f'{self._path}: cannot be read ({error.strerror})') from error
        except (ValueError, KeyError, TypeError) as error:
            raise IdentificationError(f'{self._path}: is no journal of gms_flex recover; name '
                                      'another file') from error
        if settings != self._settings:
            raise IdentificationError(f'{self._path}: belongs to trials with other settings; give '
                                      'the options it began with, or name another file')
        self.trials = {trial.seed: trial for trial in trials}

    def add(self, trial):
        """Note a Trial."""
        self.trials[trial.seed] = trial
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            lines = [self._settings, *map(_record_of, self.trials.values())]
            write_text(self._path, ''.join(f'{json.dumps(line)}\n' for line in lines))
        except OSError as error:
            raise IdentificationError(
                f'{self._path}: cannot be written ({error.strerror})') from error


def _record_of(trial):
    return {**trial._asdict(), 'estimates': [(*estimate, true) for estimate, true
                                             in trial.estimates]}


def _trial_of(record):
    pairs = []
    for *fields, true in record['estimates']:
        estimate = Estimate(*fields)
        pairs.append((estimate._replace(
            interval=Interval(*estimate.interval), bootstrap=Interval(*estimate.bootstrap),
            flags=tuple(estimate.flags)), true))
    return Trial(**{**record, 'estimates': tuple(pairs), 'blocks': tuple(record['blocks']),
                    'curve': tuple(record['curve'])})
