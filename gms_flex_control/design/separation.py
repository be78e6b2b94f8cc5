# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How far a motion will separate hypotheses of what a model lacks.

One hypothesis is simulated as the robot, every hypothesis is then fitted to the recordings so far
and this one. Their log odds are the expected log Bayes factor (Hunter and Reiner 1965; Atkinson
and Fedorov 1975, T-optimality), less two standard deviations of what encoder noise makes of it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from gms_flex_control.data.recording import Recording
from gms_flex_control.design.motions import Candidate
from gms_flex_control.discrepancy.dictionary import Dictionary, may_join
from gms_flex_control.discrepancy.evidence import state_of
from gms_flex_control.discrepancy.fitting import (
    at_values,
    extended,
    fit,
    informative,
    numbers_of,
    prior_of,
    refitted,
    retuned,
    values_of,
)
from gms_flex_control.discrepancy.likelihood import Fitted, Likelihood, with_effect
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import with_nuisances
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.discrepancy.torque_noise import white_noise
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.experiment.simulated import Plan, run_plan, to_recording
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import EffectSpec, RobotParams
from gms_flex_control.trajectory import builders
import numpy as np

_DRAWS = 4          # from the posterior at two standard deviations, that must keep the limits
_SIGMAS = 2.0
_OVER = 0.02        # of a limit beyond it: rounding of encoders and of the reference
_LARGEST_SD = 1e3   # of a parameter of which nothing is known: a finite precision
_HARDLY = 0.05      # of the size of an effect, where a fit begins a second time
_ITERATIONS = 3     # of re-tuning along old and new recordings


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One set of effects, fitted to the recordings so far."""

    effects: frozenset        # of (effect, joint)
    model: Fitted
    numbers: list             # free parameters of the effects
    covariance: np.ndarray    # (C, C) of nuisance parameters, then numbers
    evidence: float           # 2 log, but for a constant

    @property
    def words(self) -> str:
        """Return the effects in words."""
        return ' and '.join(f'{effect} of {joint}' for effect, joint in sorted(self.effects)
                            ) or 'nothing missing'

    def robot(self, likelihood, sigmas=0.0, rng=None) -> RobotParams:
        """Return the robot, as fitted or drawn so many standard deviations from there."""
        model, shift = self.model, np.zeros(len(self.covariance))
        if rng is not None:
            direction = rng.standard_normal(len(shift))
            shift = sigmas * np.linalg.cholesky(self.covariance) @ (
                direction / np.linalg.norm(direction))
        count = len(model.x)
        return with_nuisances(
            at_values(model.robot, self.numbers, values_of(model.robot, self.numbers)
                      + shift[count:]), likelihood.nuisances, model.x + shift[:count])


@dataclass(frozen=True, eq=False)
class Beliefs:
    """What the recordings so far say: hypotheses and the noise of the drives."""

    robot: RobotParams        # as believed
    hypotheses: tuple         # of Hypothesis, the likeliest first
    likelihood: Likelihood    # of the recordings
    odds: np.ndarray          # (H, H) log odds of row over column, see `log_odds`

    def left(self, wanted: float) -> 'Beliefs':
        """Return those that the likeliest does not exceed by log odds ``wanted``."""
        kept = np.flatnonzero(self.odds[0] < wanted)
        return replace(self, hypotheses=tuple(self.hypotheses[k] for k in kept),
                       odds=self.odds[np.ix_(kept, kept)])

    @property
    def probabilities(self) -> np.ndarray:
        """Return that of each hypothesis (H,), equally likely before any recording."""
        log = 0.5 * np.array([one.evidence for one in self.hypotheses])
        mass = np.exp(log - log.max())
        return mass / mass.sum()


class Prediction(NamedTuple):
    """What is expected of one motion."""

    candidate: Candidate
    duration: float           # [s]
    odds: np.ndarray          # (H, H) log odds of row (true) over column expected afterwards
    runs: tuple               # the Recording of each hypothesis

    @property
    def pairs(self) -> np.ndarray:
        """Return the lesser log odds of each pair, either of it true, as itertools pairs them."""
        return np.minimum(self.odds, self.odds.T)[np.triu_indices(len(self.odds), 1)]


def beliefs_of(recordings: Sequence[Recording], robot: RobotParams,
               sets: Sequence[Collection]) -> Beliefs:
    """
    Fit each hypothesis to the recordings.

    Parameters
    ----------
    recordings : sequence of Recording
        So far.
    robot : RobotParams
        As believed before them.
    sets : sequence of collection of (effect, joint)
        The hypotheses.

    Returns
    -------
    Beliefs

    Raises
    ------
    ConfigError
        If the recordings do not allow one of the effects.

    """
    likelihood = Likelihood([motion_of(one, robot) for one in recordings], robot, cautious=True)
    model, _ = retuned(likelihood, robot, np.zeros(len(likelihood.nuisances)))
    likelihood = likelihood.with_noise(white_noise(likelihood, model))
    base, nuisances = retuned(likelihood, robot, model.x, PLAUSIBLE)
    dictionary = Dictionary(likelihood, base, only=set().union(*sets))
    found = sorted((_fitted(likelihood, base, nuisances, dictionary, frozenset(one))
                    for one in sets), key=lambda one: -one.evidence)
    return Beliefs(robot, tuple(found), likelihood, log_odds(
        likelihood, [one.model for one in found], [one.evidence for one in found]))


def log_odds(likelihood: Likelihood, models: Sequence[Fitted], evidence: Sequence[float]
             ) -> np.ndarray:
    """
    Return the log odds (H, H) of models, row over column, that encoder noise leaves beyond chance.

    Sums of squares are cleared of encoder noise. Where two models show different noise, d, sums of
    the recording and of the null simulations scatter by 4 sum d^2 each: of this `PLAUSIBLE`
    standard deviations are subtracted.
    """
    noise = [np.subtract(*likelihood.of_pair(one.robot, one.x)) / np.sqrt(2.0)
             for one in models]
    odds = 0.5 * np.subtract.outer(evidence, evidence)
    for a, b in combinations(range(len(models)), 2):
        weight = np.minimum(*(likelihood.weights(models[k].sums.groups) for k in (a, b)))
        margin = PLAUSIBLE * np.sqrt(2.0 * weight @ (noise[a] - noise[b]) ** 2)
        odds[a, b] -= margin
        odds[b, a] -= margin
    return odds


def _fitted(likelihood, base, nuisances, dictionary, effects):
    """Return a set of effects fitted to the recordings (Hypothesis)."""
    model, columns, left = base, nuisances, set(effects)
    while left:
        spec = _begun(likelihood, dictionary, model, columns, left)
        # where known parameters stand for the effect it begins beside them, from nearly nothing
        model = min((fit(likelihood, with_effect(model.robot, one), model.x, columns)
                     for one in (spec, _smaller(spec))), key=lambda one: one.cost)
        columns = extended(likelihood, model, nuisances)
        left -= {(spec.name, spec.joint)}
    model, columns = refitted(likelihood, model, nuisances)
    numbers = numbers_of(likelihood, model.robot)
    prior = prior_of(likelihood, model, numbers)
    rows = informative(likelihood, model, columns)
    gram = (rows * likelihood.weights(model.sums.groups)) @ rows.T
    information = gram + np.diag(np.maximum(
        prior.pull, 1.0 / (prior.sd * _LARGEST_SD) ** 2))
    return Hypothesis(effects, model, numbers, np.linalg.inv(information),
                      state_of(likelihood, model, columns, 2).evidence)


def _begun(likelihood, dictionary, model, columns, left):
    """Return an EffectSpec of those ``left``, the one that gains most, where a fit begins."""
    for one in dictionary.ranked(model, columns):
        if one.key in left:
            return one.spec
    gains, _ = dictionary.gains(model, columns)  # none gains: the data speak against them
    for i in np.argsort(-gains):
        name, joint, guess = dictionary.guesses[i]
        spec = EffectSpec(name=name, joint=joint, values=guess.probes[0])
        if (name, joint) in left and may_join(spec, model.robot, likelihood.known):
            return spec
    raise ConfigError('no model of this robot has ' + ' and '.join(
        f'{effect} of {joint}' for effect, joint in sorted(left)) + '; leave it out')


def _smaller(spec):
    """Return an EffectSpec of hardly any size, its shape the same."""
    return replace(spec, values=(_HARDLY * spec.values[0], *spec.values[1:]))


def predicted(beliefs: Beliefs, candidate: Candidate, duration: float, gains: ControllerParams,
              limits: Limits, *, period: float, substeps: int = 20, seed: int = 0
              ) -> Prediction | None:
    """
    Return how far a motion is expected to separate every pair of hypotheses.

    Parameters
    ----------
    beliefs : Beliefs
        From `beliefs_of`.
    candidate : Candidate
        The motion.
    duration : float
        Of it [s].
    gains : ControllerParams
        Of the controller, which believes the robot as believed.
    limits : Limits
        That each simulated robot must keep, also two standard deviations from its fit.
    period : float
        Sample time [s].
    substeps, seed : int
        Of the simulation.

    Returns
    -------
    Prediction or None
        None if a limit would be crossed.

    """
    rng, count = np.random.default_rng(seed), len(beliefs.hypotheses)
    so_far = beliefs.likelihood

    def plan_with(robot):
        return closed_loop_plan(robot, beliefs.robot, candidate, duration, gains, period=period,
                                substeps=substeps, seed=seed)

    plans = [plan_with(one.robot(so_far)) for one in beliefs.hypotheses]
    try:
        runs = [run_plan(plan) for plan in plans]
        drawn = [run_plan(plan_with(one.robot(so_far, _SIGMAS, rng)))
                 for one in beliefs.hypotheses for _ in range(_DRAWS)]
    except SimulationError:
        return None
    if not all(keeps(run, limits) for run in (*runs, *drawn)):
        return None
    odds = np.zeros((count, count))
    noise = np.vstack([so_far.noise, np.sqrt(np.mean(so_far.noise ** 2, axis=0))])
    recordings = [to_recording(run, plan) for run, plan in zip(runs, plans, strict=True)]
    for a, recording in enumerate(recordings):
        motions = [*so_far.motions, motion_of(recording, beliefs.robot)]
        likelihood = Likelihood(motions, beliefs.robot, seed, cautious=True).with_noise(noise)
        states = [_state(likelihood, one, so_far.nuisances) for one in beliefs.hypotheses]
        odds[a] = log_odds(likelihood, [one.model for one in states],
                           [one.evidence for one in states])[a]
    return Prediction(candidate, duration, odds, tuple(recordings))


def closed_loop_plan(robot: RobotParams, believed: RobotParams, candidate: Candidate,
                     duration: float, gains: ControllerParams, *, period: float,
                     substeps: int = 20, seed: int = 0) -> Plan:
    """Return the closed loop (Plan) of a robot along a motion, from rest at zero."""
    trajectory = candidate.trajectory(robot.joints)
    start = np.zeros(robot.n_joints)
    return Plan(robot=robot, model=believed, gains=gains,
                trajectory=builders.approach(builders.at_rest(start), trajectory, 0.0),
                motion=candidate.name, duration=duration, period_ns=round(1e9 * period),
                substeps=substeps, seed=seed, q_link=start)


def keeps(run, limits: Limits) -> bool:
    """Return whether a simulated run keeps range, velocity and torsion; torque is clipped."""
    q_link, dq_link, q_motor, _ = np.moveaxis(run.true, 1, 0)
    over = _OVER * (limits.upper - limits.lower)
    return bool(np.all(q_link <= limits.upper + over) and np.all(q_link >= limits.lower - over)
                and np.all(np.abs(dq_link) <= (1.0 + _OVER) * limits.velocity)
                and np.all(np.abs(q_motor - q_link) <= (1.0 + _OVER) * limits.torsion))


def _state(likelihood, hypothesis, nuisances):
    """Return the State of a hypothesis, re-tuned from where the recordings so far left it."""
    known = dict(zip(nuisances, hypothesis.model.x, strict=True))
    x = np.array([known.get(one, 0.0) for one in likelihood.nuisances])
    model = likelihood.fitted(hypothesis.model.robot, x)
    columns = likelihood.columns(model.robot, x, model.rows)
    return state_of(likelihood, *refitted(likelihood, model, columns, _ITERATIONS), 2)
