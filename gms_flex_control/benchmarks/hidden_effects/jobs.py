# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Which hidden robots are tried."""

from typing import NamedTuple

from gms_flex_control.batches import sources
from gms_flex_control.discrepancy.unseen_links import is_lost
from gms_flex_control.errors import ConfigError
from gms_flex_control.hidden.cases import in_turn

# what an answer depends on
_SOURCES = ('analysis', 'benchmarks/hidden_effects/judgement.py',
            'benchmarks/hidden_effects/outcome.py', 'benchmarks/hidden_effects/peers.py',
            'blas.py', 'compiled.py', 'control', 'discrepancy', 'dynamics', 'effects', 'friction',
            'hidden', 'identification', 'params', 'recording.py', 'records.py', 'simulation',
            'trajectory')


class Job(NamedTuple):
    """One hidden robot to be tried; see hidden.cases.make_case and SENSORS."""

    kind: str
    seed: int
    motion: str = 'rich'
    plant: str | None = None
    duration: float = 60.0
    sensors: str = 'both'
    gravity: bool = False

    @property
    def key(self):
        """Return a name of its own, str."""
        sensors = '' if self.sensors == 'both' else f'/{self.sensors}'
        gravity = '/gravity' if self.gravity else ''
        return (f'{self.kind}/{self.motion}/{self.plant or "drawn"}/{self.duration:g}/'
                f'{self.seed}{sensors}{gravity}')

    @property
    def can_be_seen(self):
        """Return whether the main effect shows with these sensors at all."""
        return (self.sensors == 'both' or self.kind in ('clean', 'outside')
                or not is_lost(in_turn(self.seed)))


# the seeds of the figures in docs/hidden_effects.md: kind, motion, how many seeds from 0 on
SETS = {
    'full': (('single', 'rich', 333), ('clean', 'rich', 60), ('double', 'rich', 60),
             ('outside', 'rich', 44), ('clutter', 'rich', 108), ('deleted', 'rich', 72),
             ('single', 'sinusoid', 54), ('single', 'polynomial', 54)),
    'quick': (('single', 'rich', 36), ('clean', 'rich', 6), ('double', 'rich', 6),
              ('outside', 'rich', 11), ('clutter', 'rich', 12), ('deleted', 'rich', 9),
              ('single', 'sinusoid', 6), ('single', 'polynomial', 6)),
}


def jobs_of(name, share=1.0):
    """
    Return the jobs of a set, kinds mixed evenly so that a part of a run tells of all of them.

    Parameters
    ----------
    name : str
        One of `SETS`.
    share : float
        How much of the set, from its beginning.

    Returns
    -------
    list of Job

    Raises
    ------
    ConfigError
        If there is no such set or no such share.

    """
    if name not in SETS:
        raise ConfigError(f'set {name!r} is unknown; known: {", ".join(SETS)}')
    if not 0.0 < share <= 1.0:
        raise ConfigError(f'share {share:g} must be more than 0, at most 1')
    placed = [((seed + 0.5) / count, Job(kind, seed, motion))
              for kind, motion, count in SETS[name] for seed in range(count)]
    jobs = [job for _, job in sorted(placed, key=lambda one: one[0])]
    return jobs[:max(round(share * len(jobs)), 1)]


def fingerprint():
    """Return a hash (str) of the sources an answer depends on."""
    return sources.fingerprint(_SOURCES)
