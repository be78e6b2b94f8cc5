# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What a comparison of a model with recordings ended with, as plain values."""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple, Self

from gms_flex_control.effects.registry import find
from gms_flex_control.params.robot import EffectSpec
import numpy as np

# verdicts
COMPLETE = 'complete'         # nothing that matters is missing
FOUND = 'effects_found'       # effects that matter are named and added; more may be missing
UNEXPLAINED = 'unexplained'   # something is missing; no effect explains it, or no model with the
#                               effect that is named predicts as well: then nothing is added
BAD_DATA = 'bad_data'         # the recordings are at fault: nothing was searched


class Value(NamedTuple):
    """One parameter of an effect that was found."""

    name: str
    unit: str
    value: float
    low: float      # of its 95 % interval
    high: float


class Residual(NamedTuple):
    """Held-out residual of each joint, rms [N m]."""

    before: np.ndarray  # (n,)
    after: np.ndarray   # (n,)


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """One effect the model lacked."""

    effect: str             # catalogue name
    joint: str              # 'arm' for the whole arm
    values: tuple           # of Value, its parameters
    main: bool              # whether it matters in practice; small ones are listed apart
    torque: float           # what it contributes, rms over the fitted motion [N m]
    share: float            # of what known parameters cannot explain, left without it
    score: float            # 2 log evidence that it adds, all else re-tuned
    probability: float      # of all models that hold it
    held_out: object        # Gain of the log likelihood of blocks that were left out
    runner_up: str | None   # the next best explanation in its place, 'effect of joint'
    runner_up_score: float  # ``score`` times the share of it that this one would explain
    indistinguishable_from: tuple  # of (effect, joint), which explain nearly as much here
    discriminated_by: str   # experiment that separates it from those and the runner-up, or ''
    evidence: str           # one sentence
    residual: Residual      # without it and with it
    full_rate: bool = False  # seen at every sample, as its residual

    @property
    def key(self) -> tuple[str, str]:
        """Return (effect, joint)."""
        return self.effect, self.joint

    @property
    def parameters(self) -> dict[str, float]:
        """Return the values by name, dict of str to float."""
        return {value.name: value.value for value in self.values}

    @property
    def spec(self) -> EffectSpec:
        """Return the effect with its values, as a robot has it."""
        return EffectSpec(name=self.effect, joint=self.joint,
                          values=tuple(value.value for value in self.values))


@dataclass(frozen=True, kw_only=True, eq=False)
class Gap:
    """
    Distance between model and measurement on data that took no part in the fit.

    Residual torque in motion, ``rest_`` at rest (which decides nothing; NaN where a link never
    stands), rms [N m]; ``free_`` is the error of half a second of free simulation, rms [rad], NaN
    where no half second was read without a hole. All of shape (n,).
    """

    joints: tuple             # of str
    before: np.ndarray        # of the model as given
    retuned: np.ndarray       # without effects, known parameters re-tuned as in `after`
    after: np.ndarray         # with the effects found
    floor: np.ndarray         # of a null simulation; NaN where that runs away
    rest_before: np.ndarray   # re-tuned
    rest_after: np.ndarray
    free_before: np.ndarray   # re-tuned
    free_after: np.ndarray
    free_floor: np.ndarray
    closed_loop: object = None  # ClosedLoop, where it was asked for

    @property
    def energy_ratio(self) -> float:
        """Return the squared residual above the floor, after over re-tuned, of all joints."""
        noise = np.nan_to_num(self.floor) ** 2
        before, after = (float(np.sum(np.maximum(one ** 2 - noise, 0.0)))
                         for one in (self.retuned, self.after))
        ratio = after / before if before > 0.0 else 1.0
        return ratio if np.isfinite(ratio) else 1.0

    def is_above_floor(self, times) -> bool:
        """Return whether the square of what is left of a joint is ``times`` that of its floor."""
        return bool(np.any(self.after ** 2 > times * np.nan_to_num(self.floor) ** 2))

    def of_joints(self, names) -> 'Gap':
        """Return the Gap of some joints, of all where others are named, as the arm is."""
        at = np.isin(self.joints, list(names))
        if not set(names).issubset(self.joints) or not at.any():
            return self
        return replace(self, joints=tuple(np.array(self.joints)[at].tolist()), **{
            field.name: getattr(self, field.name)[at] for field in fields(self)
            if isinstance(getattr(self, field.name), np.ndarray)})


class Noise(NamedTuple):
    """Torque noise of one equation that the recording holds and encoders do not make."""

    joint: str
    equation: str      # 'motor', which is the noise of the drive, or 'link'
    per_sample: float  # of the white part, standard deviation per sample [N m]
    rms: float         # of all of it behind the low-pass, in motion [N m]
    colour: str        # 'white', 'slow' or 'fast', by the octaves in which it is largest


class Signature(NamedTuple):
    """Where something is left that no effect explains."""

    share: float       # of what known parameters cannot explain
    equation: str      # 'link' or 'motor'
    joint: str
    variable: str      # what it depends on most; '' where on none alone
    sentence: str
    joints: tuple = ()  # of str: all of which no effect explains more than it leaves

    def is_of(self, finding) -> bool:
        """Return whether a Finding of its joint depends on the same: it then only resembles."""
        return finding.joint == self.joint and find(finding.effect).evidence in self.variable


class LearnedTerm(NamedTuple):
    """A term without a name that was learned, see learning.py."""

    effect: str          # of effects.learned
    joint: str
    formula: str         # what it looks like, in words
    error: float         # of these, over rms of its curve; NaN where it is no curve
    freedom: float       # effective parameters
    held_out: object     # Gain on blocks left out


class Tried(NamedTuple):
    """One hypothesis of the first scan."""

    effect: str
    joint: str
    score: float    # decrease of the cost when nothing else is there
    bounded: bool   # within the bounds of its parameters, found for the best; else left aside


class Credible(NamedTuple):
    """One model of the set that holds 95 % of the probability."""

    effects: tuple      # of (effect, joint)
    probability: float


class Behind(NamedTuple):
    """The search behind what is reported, for figures."""

    likelihood: object  # Likelihood of the recordings
    before: object      # Fitted: known parameters re-tuned
    after: object       # Fitted: with all effects found
    written: object     # Fitted: the model as returned
    retuned_alone: Gap  # after known parameters are re-tuned and nothing else


class Searched(NamedTuple):
    """What the search for effects came by."""

    models: tuple = ()     # of Credible, the likeliest first
    tried: tuple = ()      # of Tried, the first scan
    seconds: float = 0.0   # time it took


class Recorded(NamedTuple):
    """What is said of the recordings themselves."""

    sources: tuple = ()      # of str
    currents: bool = False   # in amperes, the robot's torques as well
    faults: tuple = ()       # of str, what is wrong with them
    differences: tuple = ()  # of str: what is particular about one, beyond its prior
    noise: tuple = ()        # of Noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrepancy:
    """Everything that is reported about a model and its recordings."""

    verdict: str              # COMPLETE, FOUND, UNEXPLAINED or BAD_DATA
    findings: tuple = ()      # of Finding that matter: those in ``robot`` first, the largest first
    minor: tuple = ()         # of Finding that are small
    stand_ins: tuple = ()     # of EffectSpec in ``robot`` that only resemble what is missing
    identified_beside: tuple = ()  # of EffectSpec beside which friction was identified anew
    unexplained: Signature | None = None  # what is left, where it matters
    learned: tuple = ()       # of LearnedTerm of ``robot``, where that was asked for
    gap: Gap | None = None    # None where the data are bad
    robot: object = None      # RobotParams: re-tuned, with what improves prediction
    retuned: tuple = ()       # of (known parameter, joint, relative change)
    searched: Searched = Searched()
    data: Recorded = Recorded()
    words: str = ''           # one paragraph
    details: str = ''         # what of it the answer of the command line leaves out
    behind: Behind | None = None  # the search, for figures

    def saying(self, *sentences) -> Self:
        """Return the Discrepancy with further sentences, of which none is in the answer."""
        return replace(self, words=' '.join(filter(None, (self.words, *sentences))),
                       details=' '.join(filter(None, (self.details, *sentences))))

    @property
    def is_open(self) -> bool:
        """Return whether something is missing that no effect in ``robot`` explains."""
        return self.verdict == UNEXPLAINED or self.unexplained is not None

    @property
    def added(self) -> tuple:
        """Return findings that matter and are in ``robot``."""
        return tuple(one for one in self.findings if any(
            one.key == spec.key for spec in self.robot.effects))

    @property
    def not_added(self) -> tuple:
        """Return findings that matter, but no model with them predicts everything as well."""
        added = self.added
        return tuple(one for one in self.findings if one not in added)

    @property
    def named(self) -> tuple:
        """Return all findings, those that matter first."""
        return (*self.findings, *self.minor)
