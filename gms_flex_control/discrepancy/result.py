# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a comparison of a model with recordings ended with, as plain values."""

from dataclasses import dataclass
from typing import NamedTuple

from gms_flex_control.effects.registry import find
import numpy as np

COMPLETE, FOUND, UNEXPLAINED, BAD_DATA = 'complete', 'effects_found', 'unexplained', 'bad_data'


class Value(NamedTuple):
    """One parameter of an effect that was found."""

    name: str
    unit: str
    value: float
    low: float      # of its 95 % interval
    high: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """
    One effect the model lacked.

    Parameters
    ----------
    effect, joint : str
        Catalogue name, and where; 'arm' for the whole arm.
    values : tuple of Value
        Its parameters.
    main : bool
        Whether it matters, in practice or beside the others; small ones are listed apart.
    torque : float
        What it contributes, rms over the fitted motion [N m].
    share : float
        Of what known parameters cannot explain, what would be left without it.
    score : float
        2 log evidence that it adds, all else re-tuned.
    probability : float
        Of all models that hold it.
    held_out : Gain
        What it adds to the log likelihood of blocks of time that were left out.
    runner_up : str or None
        The next best explanation in its place, 'effect of joint'.
    runner_up_score : float
        ``score`` times the share of it that this one would explain.
    confusable_with : tuple of str
        Effects these data tell apart only weakly, or not.
    tells_apart : str
        Motion that would tell it from those and the runner-up; '' where there is none.
    evidence : str
        One sentence.
    rms_before, rms_after : ndarray, shape (n,)
        Held-out residual of each joint without it and with it [N m].

    """

    effect: str
    joint: str
    values: tuple
    main: bool
    torque: float
    share: float
    score: float
    probability: float
    held_out: object
    runner_up: str | None
    runner_up_score: float
    confusable_with: tuple
    tells_apart: str
    evidence: str
    rms_before: np.ndarray
    rms_after: np.ndarray

    @property
    def key(self):
        """Return (effect, joint)."""
        return self.effect, self.joint

    @property
    def parameters(self):
        """Return the values by name, dict of str to float."""
        return {value.name: value.value for value in self.values}


@dataclass(frozen=True, kw_only=True, eq=False)
class Gap:
    """
    Distance between model and measurement on data that took no part in the fit.

    Parameters
    ----------
    joints : tuple of str
        Names.
    before, retuned, after, floor : ndarray, shape (n,)
        Residual torque in motion, rms [N m]: of the model as given, with known parameters
        re-tuned, with the effects found, and of a null simulation.
    rest_before, rest_after : ndarray, shape (n,)
        Likewise while the link stands, re-tuned and with the effects found, which decides
        nothing; NaN where it never stands.
    free_before, free_after, free_floor : ndarray, shape (n,)
        Free-run error: angle between half a second of free simulation and the measurement, rms
        [rad]; before is re-tuned; NaN where no half second was read without a hole.
    energy_ratio : float
        Squared residual above the floor, after over re-tuned, all joints together.
    closed_loop : ClosedLoop or None
        The closed loop of the recordings simulated anew; None where it was not asked for.

    """

    joints: tuple
    before: np.ndarray
    retuned: np.ndarray
    after: np.ndarray
    floor: np.ndarray
    rest_before: np.ndarray
    rest_after: np.ndarray
    free_before: np.ndarray
    free_after: np.ndarray
    free_floor: np.ndarray
    energy_ratio: float
    closed_loop: object = None


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

    def is_of(self, finding):
        """
        Return whether it depends on what a Finding of the joint depends on.

        The finding then has another shape than what is there, which it only resembles.
        """
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrepancy:
    """
    Everything that is reported about a model and its recordings.

    Parameters
    ----------
    verdict : str
        'complete', 'effects_found', 'unexplained' or 'bad_data'.
    findings, minor : tuple of Finding
        Effects that matter, the largest first; then those that change no verdict: small ones,
        and ones that ``robot`` lacks since it predicts better without.
    stand_ins : tuple of EffectSpec
        Effects in ``robot`` that only resemble what is missing: prediction is better with them,
        but a free function of one variable explains more.
    models : tuple of Credible
        The sets of effects that hold 95 % of the probability, the likeliest first.
    noise : tuple of Noise
        Torque noise of the recordings.
    unexplained : Signature or None
        What is left, where it matters.
    learned : tuple of LearnedTerm
        Terms of ``robot`` that were learned for it, where that was asked for.
    gap : Gap or None
        None where the data are bad.
    robot : RobotParams or None
        With known parameters re-tuned, all findings, and what else improves prediction.
    retuned : tuple of (str, str, float)
        Known parameter, joint and relative change.
    recordings : tuple of str
        What is particular about one of them beyond its prior: an encoder zero, torque, time.
    tried : tuple of Tried
        The first scan.
    faults : tuple of str
        What is wrong with the data.
    sources : tuple of str
        The recordings.
    seconds : float
        Time it took.
    words : str
        One paragraph.
    behind : Behind or None
        The search behind it, for figures.

    """

    verdict: str
    findings: tuple = ()
    minor: tuple = ()
    stand_ins: tuple = ()
    models: tuple = ()
    noise: tuple = ()
    unexplained: Signature | None = None
    learned: tuple = ()
    gap: Gap | None = None
    robot: object = None
    retuned: tuple = ()
    recordings: tuple = ()
    tried: tuple = ()
    faults: tuple = ()
    sources: tuple = ()
    seconds: float = 0.0
    words: str = ''
    behind: Behind | None = None

    @property
    def named(self):
        """Return all findings, those that matter first."""
        return (*self.findings, *self.minor)
