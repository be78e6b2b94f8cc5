# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Which hidden robots are tried."""

from pathlib import Path
from typing import NamedTuple

from bench import journal
from bench.hidden_robots.cases import in_turn
from bench.hidden_robots.populations import POPULATIONS
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import ConfigError

# what an answer depends on, in the package and here
_SOURCES = ('analysis', 'compiled.py', 'control', 'data', 'discrepancy', 'dynamics',
            'effects', 'friction', 'identification', 'params', 'records.py', 'simulation',
            'trajectory')
_OWN = ('cases.py', 'judgement.py', 'kernels', 'motions.py', 'mujoco_plant.py', 'outcome.py',
        'outsiders.py', 'peers.py', 'plants.py', 'populations.py', 'sizes.py', 'truth.py')


class Job(NamedTuple):
    """One hidden robot to be tried; see cases.make_case."""

    kind: str
    seed: int
    population: str = 'home'
    plant: str | None = None
    duration: float = 60.0

    @property
    def key(self):
        """Return a name of its own, str."""
        population = '' if self.population == 'home' else f'/{self.population}'
        return (f'{self.kind}/{POPULATIONS[self.population].motion}/{self.plant or "drawn"}/'
                f'{self.duration:g}/{self.seed}{population}')

    @property
    def can_be_seen(self):
        """Return whether its robots can have the main effect, and whether it shows on them."""
        row, name = POPULATIONS[self.population], in_turn(self.seed)
        return self.kind in ('clean', 'outside') or (
            name not in row.without and (row.links_seen or not find(name).needs_link_encoder))


# the seeds of the figures in docs/hidden_effects.md: kind, population, how many seeds from 0 on
SETS = {
    'full': (('single', 'home', 333), ('clean', 'home', 60), ('double', 'home', 60),
             ('outside', 'home', 44), ('clutter', 'home', 108), ('deleted', 'home', 72),
             ('single', 'paper_sinusoid', 54), ('single', 'paper_polynomial', 54)),
    'quick': (('single', 'home', 36), ('clean', 'home', 6), ('double', 'home', 6),
              ('outside', 'home', 11), ('clutter', 'home', 12), ('deleted', 'home', 9),
              ('single', 'paper_sinusoid', 6), ('single', 'paper_polynomial', 6)),
}


def jobs_of(name, share=1.0):
    """
    Return the Jobs of a set, kinds mixed evenly so that a part of a run has all of them.

    A ``share`` of it from its beginning. ConfigError if there is no such set or no such share.
    """
    if name not in SETS:
        raise ConfigError(f'set {name!r} is unknown; known: {", ".join(SETS)}')
    if not 0.0 < share <= 1.0:
        raise ConfigError(f'share {share:g} must be more than 0, at most 1')
    placed = [((seed + 0.5) / count, Job(kind, seed, population))
              for kind, population, count in SETS[name] for seed in range(count)]
    jobs = [job for _, job in sorted(placed, key=lambda one: one[0])]
    return jobs[:max(round(share * len(jobs)), 1)]


def fingerprint():
    """Return a hash (str) of the sources an answer depends on."""
    return (journal.fingerprint(_SOURCES)
            + journal.fingerprint(_OWN, Path(__file__).parent))
