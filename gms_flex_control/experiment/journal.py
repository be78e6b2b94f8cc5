# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which steps of an experiment are finished, in a small file beside its bag."""

import json
from pathlib import Path
import shutil

from gms_flex_control.errors import BagError, GmsFlexError
from gms_flex_control.files import write_text


class ExperimentError(GmsFlexError):
    """An experiment cannot begin or go on."""


class Journal:
    """
    The finished steps of one plan and what later ones need of them, kept on disk.

    Parameters
    ----------
    bag : str or Path
        The first bag of the experiment; the journal is ``<bag>.journal.json``.
    plan : IdentificationPlan
        What is to be done.
    resume : bool
        Whether to go on with what a journal on disk lacks.

    Raises
    ------
    ExperimentError
        If there is a journal and it is not to be resumed, none to resume, or one of another plan.

    """

    def __init__(self, bag, plan, *, resume=False):
        self._bag, self._plan = Path(bag), plan
        self.path = self._bag.with_name(f'{self._bag.name}.journal.json')
        self.finished, self.bags, self.found = [], [], {}
        if resume:
            self._read()
        elif self.path.exists() or self._bag.exists():
            raise ExperimentError(
                f'{self._bag}: has been recorded already; set identification.resume to true to '
                'go on with what is unfinished, or name another identification.bag')

    def _read(self):
        try:
            content = json.loads(self.path.read_text(encoding='utf-8'))
            fingerprint = content['plan']
            self.finished, self.bags = list(content['finished']), list(content['bags'])
            self.found = {joint: float(torque) for joint, torque in content['found'].items()}
        except OSError as error:
            raise ExperimentError(f'{self.path}: cannot be read ({error.strerror}), so there is '
                                  'nothing to resume; set identification.resume to false '
                                  'to begin') from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ExperimentError(f'{self.path}: is no journal of an experiment; name another '
                                  'identification.bag and begin anew') from error
        if fingerprint != self._plan.fingerprint():
            raise ExperimentError(f'{self.path}: belongs to another plan; resume with the '
                                  'parameters it began with, or name another identification.bag')

    def next_bag(self):
        """Return the name of a bag that does not exist yet (Path), and note it."""
        number, path = 1, self._bag
        while path.exists():
            number += 1
            path = self._bag.with_name(f'{self._bag.name}_{number}')
        self.bags.append(path.name)
        self._write()
        return path

    def finish(self, step):
        """Note that ``step`` (str) is finished."""
        self.finished.append(step)
        self._write()

    def _write(self):
        try:
            write_text(self.path, json.dumps({
                'plan': self._plan.fingerprint(), 'bags': self.bags,
                'steps': len(self._plan.experiments), 'finished': self.finished,
                'found': self.found}, indent=1))
        except OSError as error:
            raise BagError(f'{self.path}: cannot be written ({error.strerror})') from error


def require_space(folder, needed):
    """
    Refuse to begin where the disk is too small.

    Parameters
    ----------
    folder : Path
        Where the recording will be, existing or not.
    needed : float
        Expected size [bytes].

    Raises
    ------
    ExperimentError
        If less is free than that and a tenth more.

    """
    folder = Path(folder).resolve()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < 1.1 * needed:
        raise ExperimentError(f'{folder}: has {free / 1e6:.0f} MB free and the recording needs '
                              f'about {needed / 1e6:.0f} MB; make room or name another '
                              'identification.bag')
