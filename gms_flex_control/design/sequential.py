# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Sequential design: plan a motion, record it, update the posterior, until one hypothesis is left.

The posterior is that of old and new recordings together, all hypotheses fitted anew.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from gms_flex_control.data.recording import Recording
from gms_flex_control.design.plan import NextRecording, plan_next, SHORTEST
from gms_flex_control.design.separation import Beliefs, beliefs_of
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
import numpy as np

HOPELESS = 0.02  # probability of leaving one below which nothing more is recorded,
FORESEEN = 2     # once so many motions were: the first recordings foresee badly
ONE_LEFT, BUDGET, INSEPARABLE = 'one_left', 'budget_spent', 'inseparable'


class Round(NamedTuple):
    """One motion that was designed and recorded."""

    plan: NextRecording
    recording: Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Separation:
    """What planning and recording in turn ended with."""

    verdict: str          # ONE_LEFT, BUDGET or INSEPARABLE
    beliefs: Beliefs      # all hypotheses, along all recordings
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
    """
    Plan, drive and update until one hypothesis is left, or nothing more can be done.

    Parameters
    ----------
    recordings : sequence of Recording
        So far.
    robot : RobotParams
        As believed before them.
    sets : sequence of collection of (effect, joint)
        The hypotheses.
    gains, limits, period, odds, longest, weight, say
        As of `plan_next`.
    drive : callable
        Plan and its number, from 1, to the Recording of what the robot did.
    budget : float
        Robot time in all [s].

    Returns
    -------
    Separation

    """
    recordings, rounds, wanted = list(recordings), [], float(np.log(odds))
    while True:
        say(f'explanations along {len(recordings)} recordings')
        beliefs = beliefs_of(recordings, robot, sets)

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
