# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The plan of the next recording: the hypotheses left, and the motion that separates them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from gms_flex_control.design.motions import candidates
from gms_flex_control.design.separation import Beliefs, predicted, Prediction
from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.schema.files import save_values
import numpy as np

MOST = 4               # hypotheses that are separated at once
_FIRST = 8.0           # length at which motions are compared [s]
_PACES = 1.0, 1.6, 2.5, 4.0  # that are tried until all limits are kept
_SAFE = 1.5            # times the evidence wanted: what is expected scatters


@dataclass(frozen=True, kw_only=True, eq=False)
class NextRecording:
    """The motion to be recorded next."""

    beliefs: Beliefs
    wanted: float             # log odds that every pair is to have afterwards
    best: Prediction          # the motion chosen
    compared: tuple           # of Prediction at one length, the best first
    refused: tuple            # names of motions that would cross a limit

    @property
    def undecided(self) -> list:
        """Return the pairs of hypotheses that the motion does not separate, in words."""
        hypotheses, nats = self.beliefs.hypotheses, self.best.nats
        return [f'{hypotheses[a].words} and {hypotheses[b].words}'
                for a, b in combinations(range(len(hypotheses)), 2)
                if min(nats[a, b], nats[b, a]) < self.wanted]

    def sentence(self) -> str:
        """Return what to record and what it will show."""
        best, hypotheses = self.best, self.beliefs.hypotheses
        words = [one.words for one in hypotheses]
        text = (f'Record {best.duration:.0f} s of {best.candidate.words}: expected to separate '
                f'{", ".join(words[:-1])} and {words[-1]} by a factor of at least '
                f'{np.exp(min(best.least, 50.0)):.3g}')
        if not self.undecided:
            return f'{text}.'
        if len(self.undecided) == len(words) * (len(words) - 1) // 2:
            return (f'No motion within the limits and {best.duration:.0f} s separates '
                    f'{" or ".join(self.undecided)}.')
        return f'{text}; not {" nor ".join(self.undecided)}.'


def surviving(report: Mapping) -> list[frozenset]:
    """
    Return the sets of effects that a result of ``discrepancy`` leaves.

    Parameters
    ----------
    report : dict
        Its report.json.

    Returns
    -------
    list of frozenset of (effect, joint)
        The credible set of models, and the likeliest with each effect in turn replaced by those
        that are indistinguishable from it.

    """
    sets = [frozenset((one['effect'], one['joint']) for one in model['effects'])
            for model in report['credible']]
    likeliest = sets[0] if sets else frozenset()
    for finding in (*report['findings'], *report['minor']):
        key = finding['effect'], finding['joint']
        for other in finding['confusable_with']:
            effect, _, joint = other.partition(' of ')
            if key in likeliest:
                sets.append(likeliest - {key} | {(effect, joint or finding['joint'])})
    return [one for one in dict.fromkeys(sets) if one][:MOST]


def plan_next(beliefs: Beliefs, gains: ControllerParams, limits: Limits, *, period: float,
              odds: float = 99.0, longest: float = 60.0,
              say: Callable[[str], object] = lambda text: None) -> NextRecording:
    """
    Choose the motion that separates the hypotheses fastest.

    Parameters
    ----------
    beliefs : Beliefs
        Two hypotheses at least.
    gains : ControllerParams
        Of the controller that will run.
    limits : Limits
        To keep under every hypothesis, two standard deviations from its fit.
    period : float
        Sample time [s].
    odds : float
        Wanted between every pair afterwards.
    longest : float
        Length of the motion at most [s].
    say : callable
        Called with what is being done.

    Returns
    -------
    NextRecording

    Raises
    ------
    ConfigError
        If every motion would cross a limit.

    """
    wanted, found, refused = float(np.log(odds)), [], []
    gains = replace(gains, torque_limit=np.minimum(gains.torque_limit, limits.torque))
    for kind in zip(*(candidates(limits, beliefs.robot.joints, pace) for pace in _PACES),
                    strict=True):
        say(kind[0].words)
        one = next(filter(None, (predicted(beliefs, candidate, _FIRST, gains, limits,
                                           period=period) for candidate in kind)), None)
        if one is None:
            refused.append(kind[0].name)
        else:
            found.append(one)
    if not found:
        raise ConfigError('every motion would cross a limit with a robot of the hypotheses; '
                          'widen the limits, or look at gains with gms_flex tune')
    found.sort(key=lambda one: -_merit(one.nats, wanted))
    best = found[0]
    pairs = _pairs(best.nats)
    short = pairs[(pairs < _SAFE * wanted) & (pairs > 0.0)]
    lengths = sorted({min(_FIRST * _SAFE * wanted / short.min(), longest), longest}
                     ) if len(short) else []
    for length in lengths:
        say(f'{best.candidate.words}, {length:.0f} s')
        longer = predicted(beliefs, best.candidate, length, gains, limits, period=period)
        if longer is not None and _merit(longer.nats, wanted) > _merit(best.nats, wanted):
            best = longer
        if _pairs(best.nats).min() >= wanted:
            break
    return NextRecording(beliefs=beliefs, wanted=wanted, best=best, compared=tuple(found),
                         refused=tuple(refused))


def _pairs(nats):
    """Return the lesser of both log Bayes factors of each pair."""
    return np.minimum(nats, nats.T)[np.triu_indices(len(nats), 1)]


def _merit(nats, wanted):
    """Return how much of what is wanted of all pairs a motion gives, then by the worst pair."""
    pairs = _pairs(nats)
    return np.sum(np.clip(pairs, 0.0, wanted)) + 1e-3 * pairs.min()


def write_plan(plan: NextRecording, folder: str | Path) -> Path:
    """Write the parameter file of trajectory_node into a folder, and return its path."""
    path = Path(folder) / 'trajectory.yaml'
    path.parent.mkdir(parents=True, exist_ok=True)
    save_values(plan.best.candidate.parameters, path, comment=plan.sentence())
    return path
