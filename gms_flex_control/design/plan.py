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
_FIRST, SHORTEST = 8.0, 4.0  # length at which motions are compared, and of any [s]
_WORTH = 0.8           # of the length compared: a shorter motion saves time
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

    def pairs(self, separated: bool) -> list:
        """Return the pairs of hypotheses that the motion separates, or those that it does not."""
        return [pair for pair, odds in zip(combinations(self.beliefs.hypotheses, 2),
                                           self.best.pairs, strict=True)
                if (odds >= self.wanted) == separated]

    @property
    def undecided(self) -> list:
        """Return the pairs of hypotheses that the motion does not separate, in words."""
        return [f'{one.words} and {other.words}' for one, other in self.pairs(False)]

    def sentence(self) -> str:
        """Return what to record and what it will show."""
        best, separated = self.best, self.pairs(True)
        if not separated:
            return (f'No motion within the limits and {best.duration:.0f} s separates '
                    f'{" or ".join(self.undecided)}.')
        least = np.exp(min(best.pairs[best.pairs >= self.wanted].min(), 50.0))
        if self.undecided:
            what = ', '.join(f'{one.words} from {other.words}' for one, other in separated)
            rest = f', but not {" nor ".join(self.undecided)}'
        else:
            words = [one.words for one in self.beliefs.hypotheses]
            what, rest = f'{", ".join(words[:-1])} and {words[-1]}', ''
        return (f'Record {best.duration:.0f} s of {best.candidate.words}: expected to separate '
                f'{what} by a factor of at least {least:.3g}{rest}.')


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
    first = min(_FIRST, longest)
    gains = clipped(gains, limits)
    for kind in zip(*(candidates(limits, beliefs.robot.joints, pace) for pace in _PACES),
                    strict=True):
        say(kind[0].words)
        one = next(filter(None, (predicted(beliefs, candidate, first, gains, limits,
                                           period=period) for candidate in kind)), None)
        if one is None:
            refused.append(kind[0].name)
        else:
            found.append(one)
            if one.pairs.min() >= wanted and _lengths(beliefs, one, wanted, longest) == [SHORTEST]:
                break  # no motion is shorter
    if not found:
        raise ConfigError('every motion would cross a limit with a robot of the hypotheses; '
                          'widen the limits, or look at gains with gms_flex tune')
    found.sort(key=lambda one: -_merit(one, wanted))
    best = found[0]
    for length in _lengths(beliefs, best, wanted, longest):
        say(f'{best.candidate.words}, {length:.0f} s')
        other = predicted(beliefs, best.candidate, length, gains, limits, period=period)
        if other is None:
            continue
        enough = other.pairs.min() >= wanted
        if enough or (length > best.duration and _merit(other, wanted) > _merit(best, wanted)):
            best = other
        if enough:
            break
    return NextRecording(beliefs=beliefs, wanted=wanted, best=best, compared=tuple(found),
                         refused=tuple(refused))


def clipped(gains: ControllerParams, limits: Limits) -> ControllerParams:
    """Return gains of a controller that asks for no more torque than limits allow."""
    return replace(gains, torque_limit=np.minimum(gains.torque_limit, limits.torque))


def _lengths(beliefs, best, wanted, longest):
    """Return lengths to be tried of the best motion: log odds grow in proportion to time."""
    growth = best.odds - beliefs.odds
    growth = np.where(growth > 0.0, growth, np.nan) / best.duration
    needed = np.maximum(_SAFE * wanted - beliefs.odds, 0.0) / growth
    needed = np.fmax(needed, needed.T)[np.triu_indices(len(needed), 1)]  # of either true [s]
    if best.pairs.min() >= wanted:
        shorter = max(float(np.nanmax(needed)), SHORTEST)
        return [shorter] if shorter < _WORTH * best.duration else []
    needed = needed[needed > best.duration]
    lengths = [*([min(float(needed.min()), longest)] if len(needed) else []), longest]
    return [one for one in dict.fromkeys(lengths) if one > best.duration]


def _merit(prediction, wanted):
    """Return how much of the odds wanted of all pairs a motion gives, then by the worst pair."""
    pairs = prediction.pairs
    return np.sum(np.clip(pairs, -wanted, wanted)) + 1e-3 * pairs.min()


def write_plan(plan: NextRecording, folder: str | Path) -> Path:
    """Write the parameter file of trajectory_node into a folder, and return its path."""
    path = Path(folder) / 'trajectory.yaml'
    path.parent.mkdir(parents=True, exist_ok=True)
    save_values(plan.best.candidate.parameters, path, comment=plan.sentence())
    return path
