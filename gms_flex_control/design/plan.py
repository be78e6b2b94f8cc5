# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What to record next: the motion that separates the hypotheses left, and rounds of such motions.

A round plans a motion, records it and updates the posterior, that of old and new recordings
together, all hypotheses fitted anew, until one hypothesis is left.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gms_flex_control.data.recording import Recording
from gms_flex_control.design import separation
from gms_flex_control.design.motions import below_break_away, by_hand, candidates
from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.schema.files import save_values
import numpy as np

MOST = 4               # hypotheses that are separated at once
SHORTEST = 5.0         # length at which motions are compared, and of any [s]
_AROUND = 4.0          # before and after each motion: on the way to it, and at rest [s]
_MINUTE = 60.0         # [s]
PACES = tuple(1.25 ** k for k in range(8))  # that are tried until all limits are kept
_ENOUGH = 0.8          # probability of leaving one: the shortest motion with it is recorded
_PROMISING = 0.9       # probability of leaving one in the shortest time: no other is looked for
_SIMULATED = 6         # longer motions that are simulated at most: few keep what they promise
LIKELY = 0.5           # probability from which a motion is said to separate
HOPELESS = 0.02        # probability of leaving one below which nothing more is recorded,
FORESEEN = 2           # once so many motions were: the first recordings foresee badly
ONE_LEFT, BUDGET, INSEPARABLE = 'one_left', 'budget_spent', 'inseparable'


@dataclass(frozen=True, kw_only=True, eq=False)
class NextRecording:
    """The motion to be recorded next."""

    beliefs: separation.Beliefs
    wanted: float             # log odds that leave one of a pair
    best: separation.Prediction  # the motion chosen
    probability: float        # that it leaves one hypothesis, the true one
    compared: tuple           # of Prediction at one length, the best first
    refused: tuple            # names of motions that would cross a limit

    def share(self, one: separation.Prediction) -> float:
        """Return the probability that a motion leaves one hypothesis, the true one."""
        return float(self.beliefs.probabilities @ separation.resolving(
            self.beliefs, one.odds, self.wanted))

    def pace(self, one: separation.Prediction) -> float:
        """Return the expected log Bayes factor of the worst pair in a second [1/s]."""
        gain = (one.odds - self.beliefs.odds) / one.duration
        return float(gain[~np.eye(len(gain), dtype=bool)].min())

    def sentence(self) -> str:
        """Return what to record and what it will show."""
        best, count = self.best, len(self.beliefs.hypotheses)
        lead = [np.delete(row, k).min() for k, row in enumerate(best.odds)]
        ahead = ', '.join(f'{np.exp(min(one, 50.0)):.3g} to 1 if it is {hypothesis.words}'
                          for one, hypothesis in zip(lead, self.beliefs.hypotheses, strict=True))
        return (f'Record {best.duration:.0f} s of {best.candidate.words}: of {count} explanations '
                f'it leaves the true one with a probability of {100.0 * self.probability:.0f} %; '
                f'expected odds are {ahead}.')


def surviving(report: Mapping) -> list[frozenset]:
    """
    Return the sets of (effect, joint) that the report.json of ``discrepancy`` leaves.

    The credible set of models, and the likeliest with each effect in turn replaced by those that
    are indistinguishable from it; not the likeliest without what matters in no prediction.
    """
    sets = [frozenset((one['effect'], one['joint']) for one in model['effects'])
            for model in report['credible']]
    likeliest = sets[0] if sets else frozenset()
    needless = likeliest - {(one['effect'], one['joint']) for one in report['minor']}
    sets = [one for one in sets if one == likeliest or one != needless]
    for finding in (*report['findings'], *report['minor']):
        key = finding['effect'], finding['joint']
        for other in finding['indistinguishable_from']:
            if key in likeliest:
                sets.append(likeliest - {key} | {(other['effect'], other['joint'])})
    return [one for one in dict.fromkeys(sets) if one][:MOST]


def plan_next(beliefs: separation.Beliefs, gains: ControllerParams, limits: Limits, *,
              period: float, odds: float = 99.0, longest: float = 60.0, weight: float = 0.0,
              say: Callable[[str], object] = lambda text: None) -> NextRecording:
    """
    Choose the motion, and its length, that leaves the true hypothesis of two or more soonest.

    The shortest that does so with a probability of `_ENOUGH`; where none does, that with most
    probability in a second, what is around a motion included.

    ``limits`` are kept under every hypothesis, two standard deviations from its fit; ``gains`` and
    ``period`` [s] are of the controller that will run. ``odds`` are wanted between every pair
    afterwards, of a motion no longer than ``longest`` [s]; ``weight`` [kg] is what a person can
    hang at the tip, unless one hangs there already. ConfigError if every motion would cross a
    limit.
    """
    wanted, found, refused = float(np.log(odds)), [], []
    first = min(SHORTEST, longest)
    loop = separation.loop_of(beliefs, clipped(gains, limits), limits, period=period)

    stuck, choice = below_break_away(beliefs.robot), partial(_choice, beliefs, wanted)

    def offered(pace):
        motions = candidates(limits, beliefs.robot.joints, pace, stuck=stuck)
        return motions + (by_hand(motions, weight) if weight and loop.load is None else [])
    for kind in zip(*map(offered, PACES), strict=True):
        say(kind[0].words)
        one = next(filter(None, (separation.predicted(beliefs, candidate, first, loop)
                                 for candidate in kind)), None)
        if one is None:
            refused.append(kind[0].name)
            continue
        found.append(one)
        if choice(one, [first])[1] >= _PROMISING:
            break
    if not found:
        raise ConfigError('every motion would cross a limit with a robot of the hypotheses; '
                          'widen the limits, or look at gains with gms_flex tune')
    lengths = np.arange(first, longest + 0.5)
    found.sort(key=lambda one: choice(one, lengths)[0], reverse=True)

    def predicted(one, length):
        say(f'{one.candidate.words}, {length:.0f} s')
        return one if length == one.duration else separation.predicted(
            beliefs, one.candidate, length, loop)
    best, probability = _longer(found, choice, lengths, predicted)
    return NextRecording(beliefs=beliefs, wanted=wanted, best=best, probability=probability,
                         compared=tuple(found), refused=tuple(refused))


def _choice(beliefs, wanted, one, lengths):
    """Return (worth, the more the better; probability, length) of the best of lengths."""
    found = []
    for length in lengths:
        share = beliefs.probabilities @ separation.resolving(
            beliefs, one.after(length, beliefs.odds), wanted)
        pace = 1.0 / (length + _AROUND + _MINUTE * one.candidate.minutes)
        found.append(((share >= _ENOUGH, pace if share >= _ENOUGH else share * pace),
                      float(share), float(length)))
    return max(found)


def _longer(found, choice, lengths, predicted):
    """Return the best Prediction, and its probability, of motions as they are or longer."""
    best = max(found, key=lambda one: choice(one, lengths[:1])[0])
    worth, ahead, simulated = choice(best, lengths[:1]), list(found), 0
    while ahead and simulated < _SIMULATED:  # what a longer motion is worth is simulated
        one = max(ahead, key=lambda one: choice(one, lengths)[0])
        promised, _, length = choice(one, lengths)
        if promised <= worth[0]:
            break
        ahead.remove(one)
        simulated += 1
        longer = predicted(one, length)
        if longer is not None:
            ahead.append(longer)  # which foresees a still longer one better
            if choice(longer, [length])[0] > worth[0]:
                best, worth = longer, choice(longer, [length])
    return best, worth[1]


def clipped(gains: ControllerParams, limits: Limits) -> ControllerParams:
    """Return gains of a controller that asks for no more torque than limits allow."""
    return replace(gains, torque_limit=np.minimum(gains.torque_limit, limits.torque))


def write_plan(plan: NextRecording, folder: str | Path) -> Path:
    """Write the parameter file of trajectory_node into a folder, and return its path."""
    path = Path(folder) / 'trajectory.yaml'
    save_values(plan.best.candidate.parameters, path, comment=plan.sentence())
    return path


class Round(NamedTuple):
    """One motion that was designed and recorded."""

    plan: NextRecording
    recording: Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Separation:
    """What planning and recording in turn ended with."""

    verdict: str          # ONE_LEFT, BUDGET or INSEPARABLE
    beliefs: separation.Beliefs  # all hypotheses, along all recordings
    wanted: float         # log odds
    rounds: tuple         # of Round
    budget: float         # of robot time [s]
    plan: NextRecording | None = None  # the last, where it separates nothing

    @property
    def spent(self) -> float:
        """Return the robot time of the rounds [s]."""
        return float(sum(one.plan.best.duration for one in self.rounds))

    @property
    def left(self) -> tuple:
        """Return the hypotheses that are within the odds of the likeliest."""
        return self.beliefs.left(self.wanted).hypotheses

    def sentence(self) -> str:
        """Return what is left, and why it ended."""
        names = ' or '.join(one.words for one in self.left)
        share, spent = self.beliefs.probabilities[0], f'{self.spent:.0f} s of robot time'
        if self.verdict == ONE_LEFT:
            return (f'{names} is left, with a probability of {100.0 * share:.4g} % among '
                    f'{len(self.beliefs.hypotheses)} explanations, after {spent}.')
        if self.verdict == BUDGET:
            return (f'{spent} of {self.budget:g} s are spent and {names} are left; '
                    'raise --budget, or add a recording of another kind.')
        return (f'No motion within the limits separates {names}; they predict the same torque. '
                f'{spent[0].upper()}{spent[1:]} is spent.')


def separate(recordings: Sequence[Recording], robot: RobotParams, sets: Sequence[Collection],
             gains: ControllerParams, limits: Limits,
             drive: Callable[[NextRecording, int], Recording], *, period: float,
             odds: float = 99.0, budget: float = 60.0, longest: float = 60.0,
             weight: float = 0.0,
             say: Callable[[str], object] = lambda text: None) -> Separation:
    """Plan, drive and update until one hypothesis is left, or nothing more can be done."""
    recordings, rounds, wanted = list(recordings), [], float(np.log(odds))
    while True:
        say(f'explanations along {len(recordings)} recordings')
        beliefs = separation.beliefs_of(recordings, robot, sets)

        def ended(verdict, plan=None, beliefs=beliefs):
            return Separation(verdict=verdict, beliefs=beliefs, wanted=wanted, plan=plan,
                              rounds=tuple(rounds), budget=budget)

        left = beliefs.left(wanted)
        room = budget - sum(one.plan.best.duration for one in rounds)
        if len(left.hypotheses) == 1:
            return ended(ONE_LEFT)
        if room < SHORTEST:
            return ended(BUDGET)
        plan = plan_next(left, gains, limits, period=period, odds=odds,
                         longest=min(longest, room), weight=weight, say=say)
        if plan.probability < HOPELESS and len(rounds) >= FORESEEN:
            return ended(INSEPARABLE, plan)
        say(plan.sentence())
        recording = drive(plan, len(rounds) + 1)
        rounds.append(Round(plan, recording))
        recordings.append(recording)
