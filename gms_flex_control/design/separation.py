# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How far a motion will separate hypotheses of what a model lacks.

One hypothesis is simulated as the robot, every hypothesis is then fitted to the recordings so far
and this one. By how much the evidence for the true one grows over that of another is the expected
log Bayes factor (Hunter and Reiner 1965; Atkinson and Fedorov 1975, T-optimality).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from gms_flex_control.data.recording import Recording
from gms_flex_control.design.motions import Candidate
from gms_flex_control.discrepancy.dictionary import Dictionary
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
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.experiment.plan import Plan
from gms_flex_control.experiment.simulated import run_plan, to_recording
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.trajectory import builders
import numpy as np

_DRAWS = 4          # from the posterior at two standard deviations, that must keep the limits
_SIGMAS = 2.0
_OVER = 1.02        # of a limit: rounding of encoders and of the reference
_LARGEST_SD = 1e3   # of a parameter of which nothing is known: a finite precision
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


class Prediction(NamedTuple):
    """What is expected of one motion."""

    candidate: Candidate
    duration: float           # [s]
    nats: np.ndarray          # (H, H) expected log Bayes factor of row (true) over column
    runs: tuple               # the Recording of each hypothesis

    @property
    def least(self) -> float:
        """Return that of the worst pair."""
        return float(self.nats[~np.eye(len(self.nats), dtype=bool)].min())


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
    likelihood = Likelihood([motion_of(one, robot) for one in recordings], robot)
    model, _ = retuned(likelihood, robot, np.zeros(len(likelihood.nuisances)))
    likelihood = likelihood.with_noise(likelihood.white_noise(model))
    base, nuisances = retuned(likelihood, robot, model.x, PLAUSIBLE)
    dictionary = Dictionary(likelihood, base, only=set().union(*sets))
    found = [_fitted(likelihood, base, nuisances, dictionary, frozenset(one)) for one in sets]
    return Beliefs(robot, tuple(sorted(found, key=lambda one: -one.evidence)), likelihood)


def _fitted(likelihood, base, nuisances, dictionary, effects):
    """Return a set of effects fitted to the recordings (Hypothesis)."""
    model, columns, left = base, nuisances, set(effects)
    while left:
        best = next((one for one in dictionary.ranked(model, columns)
                     if (one.spec.name, one.spec.joint) in left), None)
        if best is None:
            raise ConfigError('the recordings do not show ' + ' and '.join(
                f'{effect} of {joint}' for effect, joint in sorted(left)) + '; leave it out')
        model = fit(likelihood, with_effect(model.robot, best.spec), model.x, columns)
        columns = extended(likelihood, model, nuisances)
        left -= {(best.spec.name, best.spec.joint)}
    model, columns = refitted(likelihood, model, nuisances)
    numbers = numbers_of(likelihood, model.robot)
    prior = prior_of(likelihood, model, numbers)
    rows = informative(likelihood, model, columns)
    gram = (rows * likelihood.weights(model.sums.groups)) @ rows.T
    information = gram + np.diag(np.maximum(
        prior.pull, 1.0 / (prior.sd * _LARGEST_SD) ** 2))
    return Hypothesis(effects, model, numbers, np.linalg.inv(information),
                      state_of(likelihood, model, columns, 2).evidence)


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
    plans = [_plan(beliefs, one.robot(so_far), candidate, duration, gains, period, substeps, seed)
             for one in beliefs.hypotheses]
    try:
        runs = [run_plan(plan) for plan in plans]
        drawn = [run_plan(_plan(beliefs, one.robot(so_far, _SIGMAS, rng), candidate,
                                duration, gains, period, substeps, seed))
                 for one in beliefs.hypotheses for _ in range(_DRAWS)]
    except SimulationError:
        return None
    if not all(keeps(run, limits) for run in (*runs, *drawn)):
        return None
    nats = np.zeros((count, count))
    before = np.array([one.evidence for one in beliefs.hypotheses])
    noise = np.vstack([so_far.noise, np.sqrt(np.mean(so_far.noise ** 2, axis=0))])
    recordings = [to_recording(run, plan) for run, plan in zip(runs, plans, strict=True)]
    for a, recording in enumerate(recordings):
        motions = [*so_far.motions, motion_of(recording, beliefs.robot)]
        likelihood = Likelihood(motions, beliefs.robot, seed).with_noise(noise)
        gained = np.array([_evidence(likelihood, one, so_far.nuisances)
                           for one in beliefs.hypotheses]) - before
        nats[a] = 0.5 * (gained[a] - gained)
    return Prediction(candidate, duration, nats, tuple(recordings))


def _plan(beliefs, robot, candidate, duration, gains, period, substeps, seed):
    """Return the closed loop of a candidate with a robot (Plan), from zero."""
    trajectory = candidate.trajectory(robot.joints)
    start = np.zeros(robot.n_joints)
    return Plan(robot=robot, model=beliefs.robot, gains=gains,
                trajectory=builders.approach(builders.at_rest(start), trajectory, 0.0),
                motion=candidate.name, duration=duration, period_ns=round(1e9 * period),
                substeps=substeps, seed=seed, q_link=start)


def keeps(run, limits: Limits) -> bool:
    """Return whether a simulated run keeps range, velocity and torsion; torque is clipped."""
    q_link, dq_link, q_motor, _ = np.moveaxis(run.true, 1, 0)
    return bool(np.all(q_link <= _OVER * limits.upper) and np.all(q_link >= _OVER * limits.lower)
                and np.all(np.abs(dq_link) <= _OVER * limits.velocity)
                and np.all(np.abs(q_motor - q_link) <= _OVER * limits.torsion))


def _evidence(likelihood, hypothesis, nuisances):
    """Return 2 log evidence of a hypothesis, re-tuned from where the recordings so far left it."""
    known = dict(zip(nuisances, hypothesis.model.x, strict=True))
    x = np.array([known.get(one, 0.0) for one in likelihood.nuisances])
    model = likelihood.fitted(hypothesis.model.robot, x)
    columns = likelihood.columns(model.robot, x, model.rows)
    return state_of(likelihood, *refitted(likelihood, model, columns, _ITERATIONS), 2).evidence
