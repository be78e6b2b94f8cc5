# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
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

from gms_flex_control.data.recording import Operation, Recording
from gms_flex_control.design.motions import APPROACH, Candidate
from gms_flex_control.discrepancy import fitting
from gms_flex_control.discrepancy.dictionary import Dictionary, guesses_of, may_join
from gms_flex_control.discrepancy.evidence import state_of
from gms_flex_control.discrepancy.likelihood import Fitted, Likelihood
from gms_flex_control.discrepancy.motion import motion_of
from gms_flex_control.discrepancy.nuisance import with_nuisances
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.experiment.simulated import Plan, run_plan, to_recording
from gms_flex_control.hardware.limits import Limits
from gms_flex_control.params.arm import Body, carrying, together
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.robot import EffectSpec, RobotParams, with_effects
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import Trajectory
import numpy as np
from scipy.special import ndtr

DRAWS = 4           # from the posterior at two standard deviations, that must keep the limits
_SIGMAS = 2.0
_OVER = 0.02        # of a limit beyond it: rounding of encoders and of the reference
_CLIPPED = 0.01     # of the time that torque may be at its limit: peaks of friction reversals
_THINNED = 10       # rows of a recorded reference of which one is kept
_LARGEST_SD = 1e3   # of a parameter of which nothing is known: a finite precision
_HARDLY = 0.05      # of the size of an effect, where a fit begins a second time
_PHASES = 0.05      # between the times at which the motion may be stopped [s]
_EXPECTED = 0.5     # relative error of an expected gain of log odds: seen on hidden robots
_LEAST_SCATTER = 0.5  # of log odds
_ITERATIONS = 3     # of re-tuning along old and new recordings
_SUBSTEPS = 20      # of the simulation per sample


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

    def robot(self, likelihood, rng=None) -> RobotParams:
        """Return the robot, as fitted or drawn two standard deviations from there."""
        model, count = self.model, len(self.model.x)
        shift = np.zeros(len(self.covariance)) if rng is None else two_sigma(self.covariance, rng)
        return with_nuisances(
            fitting.at_values(model.robot, self.numbers, fitting.values_of(
                model.robot, self.numbers)
                      + shift[count:]), likelihood.nuisances, model.x + shift[:count])


@dataclass(frozen=True, eq=False)
class Beliefs:
    """What the recordings so far say: hypotheses and the noise of the drives."""

    robot: RobotParams        # as believed
    recordings: tuple         # of Recording
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
        """Return that of each hypothesis (H,), equally likely before, by the odds of the first."""
        mass = np.exp(-np.maximum(self.odds[0], 0.0))
        return mass / mass.sum()


def two_sigma(covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a shift (C,) in a random direction, two standard deviations of a covariance long."""
    direction = rng.standard_normal(len(covariance))
    return _SIGMAS * np.linalg.cholesky(covariance) @ (direction / np.linalg.norm(direction))


class Prediction(NamedTuple):
    """What is expected of one motion."""

    candidate: Candidate
    duration: float           # [s]
    odds: np.ndarray          # (H, H) log odds of row (true) over column expected afterwards
    runs: tuple               # the Recording of each hypothesis

    def after(self, duration: float, so_far: np.ndarray) -> np.ndarray:
        """Return the log odds (H, H) expected after so long: what they gain grows with time."""
        return so_far + (self.odds - so_far) * duration / self.duration


def resolving(beliefs: Beliefs, odds: np.ndarray, wanted: float) -> np.ndarray:
    """
    Return the probability (H,) that a motion leaves a hypothesis alone, if that is the true one.

    ``odds`` (H, H) are the log odds expected after it, ``wanted`` are those that leave one of a
    pair. A gain g of log odds scatters by 2 g (as of all Gaussian likelihoods), and is itself
    expected with an error of `_EXPECTED` g.
    """
    gain = np.maximum(odds - beliefs.odds, 0.0)
    share = ndtr((odds - wanted) / np.sqrt(_LEAST_SCATTER ** 2 + 2.0 * gain
                                           + (_EXPECTED * gain) ** 2))
    np.fill_diagonal(share, 1.0)
    return share.min(axis=1)


def beliefs_of(recordings: Sequence[Recording], robot: RobotParams,
               sets: Sequence[Collection]) -> Beliefs:
    """Fit each hypothesis, a set of (effect, joint), to recordings; ConfigError if impossible."""
    likelihood, model = fitting.with_white_noise(Likelihood(
        [motion_of(one, robot) for one in recordings], robot, cautious=True))
    base, nuisances = fitting.retuned(likelihood, robot, model.x, PLAUSIBLE)
    dictionary = Dictionary(likelihood, base, only=set().union(*sets))
    found = sorted((_fitted(likelihood, base, nuisances, dictionary, frozenset(one))
                    for one in sets), key=lambda one: -one.evidence)
    return Beliefs(robot, tuple(recordings), tuple(found), likelihood, log_odds(
        likelihood, [one.model for one in found], [one.evidence for one in found]))


def log_odds(likelihood: Likelihood, models: Sequence[Fitted], evidence: Sequence[float]
             ) -> np.ndarray:
    """
    Return the log odds (H, H) of models, row over column, that encoder noise leaves beyond chance.

    Sums of squares are cleared of encoder noise. Where two models show different noise, d, sums of
    the recording and of the null simulations scatter by 4 sum d^2 each: of this `PLAUSIBLE`
    standard deviations are subtracted.
    """
    noise = [np.subtract(*likelihood.of_pair(one.robot, one.x)) / np.sqrt(2.0) for one in models]
    odds = 0.5 * np.subtract.outer(evidence, evidence)
    for a, b in combinations(range(len(models)), 2):
        weight = np.minimum(*(likelihood.weights(models[k].sums.groups) for k in (a, b)))
        margin = PLAUSIBLE * np.sqrt(2.0 * weight @ (noise[a] - noise[b]) ** 2)
        odds[a, b] -= margin
        odds[b, a] -= margin
    return odds


def _fitted(likelihood, base, nuisances, dictionary, effects):
    """Return a set of effects fitted to the recordings (Hypothesis)."""
    model, jacobian, left = base, nuisances, set(effects)
    while left:
        spec = _begun(likelihood, dictionary, model, jacobian, left)
        # where known parameters stand for the effect it begins beside them, from nearly nothing
        model = min((fitting.fit(likelihood, with_effects(model.robot, one), model.x, jacobian)
                     for one in (spec, replace(spec, values=(
                         _HARDLY * spec.values[0], *spec.values[1:])))), key=lambda one: one.cost)
        jacobian = fitting.extended(likelihood, model, nuisances)
        left -= {spec.key}
    model, jacobian = fitting.refitted(likelihood, model.robot, model.x, nuisances)
    numbers = fitting.numbers_of(likelihood, model.robot)
    prior = fitting.prior_of(likelihood, model, numbers)
    rows = fitting.informative(likelihood, model, jacobian)
    gram = (rows * likelihood.weights(model.sums.groups)) @ rows.T
    information = gram + np.diag(np.maximum(prior.pull, 1.0 / (prior.sd * _LARGEST_SD) ** 2))
    return Hypothesis(effects, model, numbers, np.linalg.inv(information),
                      state_of(likelihood, model, jacobian, 2).evidence)


def _begun(likelihood, dictionary, model, jacobian, left):
    """Return an EffectSpec of those ``left``, the one that explains most, where a fit begins."""
    for one in dictionary.ranked(model, jacobian):
        if one.key in left:
            return one.spec
    decreases, _ = dictionary.decreases(model, jacobian)  # none: the data speak against them
    for i in np.argsort(-decreases):
        name, joint, guess = dictionary.guesses[i]
        spec = EffectSpec(name=name, joint=joint, values=guess.probes[0])
        if (name, joint) in left and may_join(spec, model.robot, likelihood.known):
            return spec
    raise ConfigError('no model of this robot has ' + ' and '.join(
        f'{effect} of {joint}' for effect, joint in sorted(left)) + '; leave it out')


class PlannedLoop(NamedTuple):
    """The closed loop in which robots of the hypotheses are simulated."""

    gains: ControllerParams   # of the controller, which believes the robot as believed
    limits: Limits
    period: float             # sample time [s]
    fitted: tuple             # RobotParams of each hypothesis
    kept: tuple               # those that must keep the limits: as believed, fitted, and drawn
    load: Body | None = None  # that the robot carries

    def run(self, robot, believed, candidate, duration) -> tuple:
        """Return the Plan and the Run of a robot; SimulationError if it diverges."""
        plan = closed_loop_plan(loaded(robot, together(self.load, candidate.load)), believed,
                                candidate, duration, self.gains, period=self.period)
        return plan, run_plan(plan)

    def keeps(self, robot, believed, candidate, duration) -> bool:
        """Return whether a robot keeps the limits along a motion."""
        try:
            return keeps(self.run(robot, believed, candidate, duration)[1], self.limits)
        except SimulationError:
            return False


class RecordedReference(NamedTuple):
    """The reference of a recording, as a motion."""

    name: str
    reference: Trajectory
    load: Body | None = None  # beside what is carried

    def trajectory(self, _) -> Trajectory:
        """Return the reference, its time from 0."""
        return self.reference


def loop_of(beliefs: Beliefs, gains: ControllerParams, limits: Limits, *, period: float
            ) -> PlannedLoop:
    """Return the PlannedLoop, with hypotheses as fitted and two deviations off."""
    rng, so_far, believed = np.random.default_rng(0), beliefs.likelihood, beliefs.robot
    fitted = tuple(one.robot(so_far) for one in beliefs.hypotheses)
    drawn = [one.robot(so_far, rng) for one in beliefs.hypotheses for _ in range(DRAWS)]
    loop = PlannedLoop(gains, limits, period, fitted, (), beliefs.recordings[-1].operation.load)
    driven = [(loop._replace(load=one.operation.load), recorded_motion(one))
              for one in beliefs.recordings
              if np.isfinite(one.reference[:, 0]).all(axis=1).sum() > _THINNED]
    return loop._replace(kept=(believed, *(robot for robot in (*fitted, *drawn) if all(
        then.keeps(robot, believed, motion, motion.reference.end) for then, motion in driven))))


def recorded_motion(recording: Recording) -> RecordedReference:
    """Return the motion through every tenth row of a recorded reference (T, 5, n)."""
    known = np.flatnonzero(np.isfinite(recording.reference[:, 0]).all(axis=1))[::_THINNED]
    return RecordedReference(recording.source, builders.through(
        recording.time[known] - recording.time[known[0]], recording.reference[known]))


def predicted(beliefs: Beliefs, candidate: Candidate, duration: float, loop: PlannedLoop,
              seed: int = 0) -> Prediction | None:
    """Return how far a motion of ``duration`` [s] is expected to separate each pair, or None."""
    so_far, count = beliefs.likelihood, len(beliefs.hypotheses)
    if not (stops_within(candidate, beliefs.robot.joints, duration, loop.limits)
            and all(loop.keeps(one, beliefs.robot, candidate, duration) for one in loop.kept)):
        return None
    try:
        runs = [loop.run(one, beliefs.robot, candidate, duration) for one in loop.fitted]
    except SimulationError:
        return None
    odds, effects = np.zeros((count, count)), set().union(
        *(one.effects for one in beliefs.hypotheses))
    noise = np.vstack([so_far.noise, np.sqrt(np.mean(so_far.noise ** 2, axis=0))])
    operation = Operation(together(loop.load, candidate.load))
    recordings = [replace(to_recording(run, plan), operation=operation) for plan, run in runs]
    for a, recording in enumerate(recordings):
        motions = [*so_far.motions, motion_of(recording, beliefs.robot)]
        likelihood = Likelihood(motions, beliefs.robot, seed, cautious=True).with_noise(noise)
        # else fits take noise for evidence
        likelihood.learn_noise(guesses_of(likelihood, only=effects))
        states = [_state(likelihood, one, so_far.nuisances) for one in beliefs.hypotheses]
        odds[a] = log_odds(likelihood, [one.model for one in states],
                           [one.evidence for one in states])[a]
    if not np.isfinite(odds).all():  # a fit that has no determinant foresees nothing
        return None
    return Prediction(candidate, duration, odds, tuple(recordings))


def stops_within(candidate: Candidate, joints: Sequence[str], duration: float, limits: Limits
                 ) -> bool:
    """Return whether ``~/stop`` after a duration [s] keeps range and velocity, its delay aside."""
    states = candidate.trajectory(joints).sample(np.arange(duration, duration + APPROACH, _PHASES))
    stops = np.stack([builders.braked(state, 0.0, duration=APPROACH).sample(
        np.arange(0.0, APPROACH, _PHASES))[:, :2] for state in states])
    angle, velocity = np.moveaxis(stops, 2, 0)
    return bool(np.all(angle <= limits.upper) and np.all(angle >= limits.lower)
                and np.all(np.abs(velocity) <= limits.velocity))


def closed_loop_plan(robot: RobotParams, believed: RobotParams, candidate: Candidate,
                     duration: float, gains: ControllerParams, *, period: float,
                     seed: int = 0) -> Plan:
    """Return the closed loop (Plan) of a robot along a motion, from rest at zero."""
    trajectory = candidate.trajectory(robot.joints)
    start = np.zeros(robot.n_joints)
    return Plan(robot=robot, model=believed, gains=gains,
                trajectory=builders.approach(builders.at_rest(start), trajectory, 0.0),
                motion=candidate.name, duration=duration, period_ns=round(1e9 * period),
                substeps=_SUBSTEPS, seed=seed, q_link=start)


def loaded(robot: RobotParams, load: Body | None) -> RobotParams:
    """Return a robot that carries a load, given in the frame at the end of its arm."""
    return robot if load is None else replace(robot, arm=carrying(robot.arm, load))


def keeps(run, limits: Limits) -> bool:
    """Return whether a simulated run keeps range, velocity and torsion, and is hardly clipped."""
    q_link, dq_link, q_motor, _ = np.moveaxis(run.true, 1, 0)
    over = _OVER * (limits.upper - limits.lower)
    clipped = np.mean(np.abs(run.command) >= (1.0 - _OVER) * limits.torque, axis=0)
    return bool(np.all(q_link <= limits.upper + over) and np.all(q_link >= limits.lower - over)
                and np.all(np.abs(dq_link) <= (1.0 + _OVER) * limits.velocity)
                and np.all(np.abs(q_motor - q_link) <= (1.0 + _OVER) * limits.torsion)
                and np.all(clipped <= _CLIPPED))


def _state(likelihood, hypothesis, nuisances):
    """Return the State of a hypothesis, re-tuned from where the recordings so far left it."""
    known = dict(zip(nuisances, hypothesis.model.x, strict=True))
    x = np.array([known.get(one, 0.0) for one in likelihood.nuisances])
    robot = hypothesis.model.robot
    jacobian = likelihood.jacobian(likelihood.fitted(robot, x))
    return state_of(likelihood, *fitting.refitted(likelihood, robot, x, jacobian, _ITERATIONS), 2)
