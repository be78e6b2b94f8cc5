# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The evidence for models: likelihood, priors, and what the freedom of each parameter costs.

Laplace's approximation: 2 log evidence is that of the likeliest parameters less log det of what
the data add to the precision of the priors (the Occam factor), less the odds against each effect
before anything was measured.
"""

from typing import NamedTuple

from gms_flex_control.compiled import compiled
from gms_flex_control.discrepancy import fitting
from gms_flex_control.discrepancy.likelihood import Fitted
from gms_flex_control.discrepancy.residuals import fresh_state
from gms_flex_control.discrepancy.thresholds import CREDIBLE, EVIDENCE, OTHER_SIZE
from gms_flex_control.effects import base as sig
from gms_flex_control.effects.registry import find
from gms_flex_control.simulation import plant
import numpy as np

_SOFTEST = 0.05       # of the stiffness simulated, which a play has
_WEIGHINGS = 3        # times that noise levels are taken anew
_OF_SLOPE = 2000      # samples of the regression that gives the slope of a spring


class State(NamedTuple):
    """A model, its derivatives and its evidence."""

    model: Fitted
    nuisances: np.ndarray  # (P, R) derivatives by nuisance parameters, which many States share
    own: np.ndarray        # (V, R) derivatives by numbers of effects
    evidence: float        # 2 log, but for a constant
    plausible: object = np.inf  # standard deviations that nuisance parameters may go, (P,) or one

    @property
    def jacobian(self) -> np.ndarray:
        """Return the derivatives (C, R) by nuisance parameters, then numbers of effects."""
        return np.concatenate([self.nuisances, self.own])

    def key(self, known) -> frozenset:
        """Return the effects that were added, frozenset of (effect, joint)."""
        return frozenset(spec.key for spec in self.model.robot.effects[known:])


def state_of(likelihood, model, jacobian, hypotheses) -> State:
    """
    Return a model at its likeliest, with its evidence, a State.

    ``jacobian`` (C, R) has the derivatives of its residuals; of ``hypotheses``, the effects of
    joints that are looked for, one is expected to be missing.
    """
    numbers = fitting.numbers_of(likelihood, model.robot)
    prior = fitting.prior_of(likelihood, model, numbers)
    weight = likelihood.weights(model.sums.groups)
    scaled = fitting.informative(likelihood, model, jacobian)[prior.free]
    scaled *= prior.sd[prior.free, None]
    gram = (scaled * weight) @ scaled.T
    _, occam = np.linalg.slogdet(np.eye(len(gram)) + gram)
    added = len(model.robot.effects) - likelihood.known
    exact = likelihood.sums(model.whitened, model.robot, model.x, exact=True)
    evidence = (-exact.cost - fitting.prior_cost(model, numbers) - occam
                + 2.0 * log_determinant(likelihood, model)
                - 2.0 * added * np.log(max(hypotheses, 2)))
    return State(model, jacobian[:len(model.x)], jacobian[len(model.x):], finite(evidence))


def finite(evidence) -> float:
    """Return an evidence, or a difference of two; what is no number speaks for nothing."""
    return float(evidence) if np.isfinite(evidence) else -np.inf


def log_determinant(likelihood, model) -> float:
    """
    Return the logarithm of the determinant of residuals by readings, beside that of encoder noise.

    Beside the motion of a link its torsion and its drive are answers, not choices. The residual of
    the link changes with the torsion by the slope of the spring, that of the motor counts per unit
    of commanded torque: so the density of readings is that of residuals times the slope. Of a
    variance of which encoders make a share, that share falls with the square of the slope, of
    which sums are cleared; the rest, of torques that drives and loads make or that nothing
    explains, does not. A softer spring that explains none of it only makes less torque of the
    same torsion. As simulated the determinant is 1.
    """
    joints, rigid = likelihood.robot.joints, likelihood.robot.arm.rigid
    links = [j for j, joint in enumerate(joints)
             if not rigid[j] and joint not in likelihood.unseen]
    if not links:
        return 0.0
    groups, null = likelihood.groups, likelihood.null
    encoders = 0.5 * likelihood.encoder_noise.own_sums / groups.count
    beyond = 1.0 - np.minimum(encoders / likelihood.noise_levels(model.sums.groups), 1.0)
    now, simulated = (likelihood.constants(one.robot, one.x) for one in (model, null))
    falls = np.zeros((len(likelihood.motions), 2 * len(joints)))  # of the share of encoders
    for m, motion in enumerate(likelihood.motions):
        ratio = stiffness_along(motion, now)[links] / stiffness_along(motion, simulated)[links]
        falls[m, links] = np.maximum(ratio, _SOFTEST) ** -2.0 - 1.0
    return -0.5 * float(np.sum(np.log1p(
        beyond[groups.group] * falls[groups.recording, groups.channel])))


@compiled
def spring_torques(states, drive, time, period, constants, state, work, spring) -> None:
    """Fill the torques (T, n) of springs along a motion (T, 6, n)."""
    for k in range(drive.shape[0]):
        plant.take_place(k, states, drive[k], time[k], state, work)
        plant.springs(state, period, constants, work)
        for j in range(drive.shape[1]):
            spring[k, j] = work.signals[j, sig.SPRING]


def stiffness_along(motion, constants) -> np.ndarray:
    """
    Return by how much spring torques change with the torsion along a motion, (n,) [N m/rad].

    The slope of the regression line over some samples: that of a linear spring is its stiffness.
    """
    every = max(len(motion.time) // _OF_SLOPE, 1)
    states, drive, time = (np.ascontiguousarray(one[::every]) for one in (
        motion.states, motion.drive, motion.time))
    torque = np.empty_like(drive)
    spring_torques(states, drive, time, motion.period * every, constants,
                   fresh_state(constants), plant.workspace(len(motion.samples.joints)), torque)
    torsion = states[:, 3] - states[:, 0]
    torsion = torsion - torsion.mean(axis=0)
    return np.sum(torque * torsion, axis=0) / np.maximum(np.sum(torsion ** 2, axis=0), 1e-300)


def posterior(states, known, trifles=frozenset()) -> list[tuple[frozenset, float]]:
    """
    Return the probabilities of States that were tried, those of equal effects once.

    List of (frozenset of effects beside the first ``known``, probability), the likeliest first;
    all alike where the evidence of none is finite. The likeliest is no likelier than without its
    ``trifles``, effects of joints that matter in no prediction: filters and integrators err as
    much, and errors of a model add to evidence as long as a recording lasts.
    """
    best = {}
    for state in states:
        key = state.key(known)
        best[key] = max(best.get(key, -np.inf), state.evidence)
    likeliest = max(best, key=best.get)
    best[likeliest - trifles] = best[likeliest]
    keys = sorted(best, key=lambda key: (-best[key], key != likeliest))
    log = 0.5 * np.array([best[key] for key in keys])
    mass = np.exp(log - log.max()) if np.isfinite(log.max()) else np.ones(len(log))
    return list(zip(keys, (mass / mass.sum()).tolist(), strict=True))


def doubted(kept, tried, known) -> list[State]:
    """
    Return all States that were tried, for the set of models.

    Of effects that evidence speaks for and held-out prediction against, nobody knows whether they
    are there: all models with them together are no likelier than those ``kept`` without.
    """
    there = {state.key(known) for state in kept}
    others = [state for state in tried if state.key(known) not in there]
    highest = [max((state.evidence for state in states), default=-np.inf)
               for states in (kept, others)]
    excess = max(finite(highest[1] - highest[0]), 0.0)
    return [*kept, *(state._replace(evidence=state.evidence - excess) for state in others)]


def credible(models, mass=CREDIBLE) -> list:
    """Return the fewest models (of `posterior`) that hold so much of the probability."""
    shares = np.cumsum([share for _, share in models])
    return models[:int(np.searchsorted(shares, mass)) + 1]


# --- directions beside a model -----------------------------------------------------------------


class Least(NamedTuple):
    """A minimum."""

    cost: float
    step: np.ndarray    # (C,) of all that is free in the model
    added: np.ndarray   # (K,) of the directions beside it
    sums: np.ndarray    # (G,) of squares by group


class NormalEquations:
    """
    Products of a model's derivatives group by group, which any noise levels can weigh.

    ``jacobian`` (C, R) has derivatives of a Fitted by nuisance parameters, then by numbers of its
    effects; nuisance parameters may go ``plausible`` standard deviations of their priors, a number
    or (P,).
    """

    def __init__(self, likelihood, model, jacobian, plausible=np.inf):
        self._likelihood, self._sums = likelihood, model.sums.groups
        self._jacobian = likelihood.groups.ordered(
            fitting.informative(likelihood, model, jacobian))
        self._residuals = likelihood.groups.ordered(model.whitened[None])
        numbers = fitting.numbers_of(likelihood, model.robot)
        self.prior = fitting.prior_of(likelihood, model, numbers)
        self._products = likelihood.groups.products
        self._gram = self._products(self._jacobian, self._jacobian)
        self._slope = -self._products(self._jacobian, self._residuals)[:, :, 0]
        self._noise = likelihood.noise_slopes(model, likelihood.weights(self._sums), numbers)
        self._limits = fitting.limits(model, numbers, self.prior, plausible * likelihood.sd)
        self.alone = self._least(self._gram, self._slope, self._noise, self.prior.pull,
                                 *self._limits)

    def _least(self, gram, slope, noise, pull, low, high):
        likelihood, k = self._likelihood, len(self.prior.values)
        values = np.concatenate([self.prior.values, np.zeros(slope.shape[1] - k)])
        sums = self._sums
        for _ in range(_WEIGHINGS):
            weight = 1.0 / likelihood.noise_levels(sums)
            step = fitting.solve(np.tensordot(weight, gram, 1) + np.diag(pull),
                                 weight @ slope + noise - pull * values, low, high)
            sums = self._sums - 2.0 * slope @ step + (gram @ step) @ step
        cost = (likelihood.misfit(sums) - 2.0 * float(noise @ step)
                + float(np.sum(pull * (values + step) ** 2)))
        return Least(cost, step[:k], step[k:], sums)

    def beside(self, added, noise=0.0, lowest=-np.inf, highest=np.inf, pull=0.0) -> Least:
        """
        Return the Least with directions ``added`` (K, R), within bounds.

        ``noise`` is what encoder noise adds to their slopes, ``pull`` the inverse variance of a
        prior about zero: each (K,) or a number.
        """
        k, count = len(self.prior.values), len(added)
        added = self._likelihood.groups.ordered(added)
        gram = np.empty((len(self._gram), k + count, k + count))
        gram[:, :k, :k] = self._gram
        gram[:, k:, k:] = self._products(added, added)
        gram[:, k:, :k] = self._products(added, self._jacobian)
        gram[:, :k, k:] = gram[:, k:, :k].swapaxes(1, 2)
        slope = np.concatenate([self._slope, -self._products(added, self._residuals)[:, :, 0]],
                               axis=1)

        def whole(own, value):
            return np.concatenate([own, np.broadcast_to(value, count)])
        low, high = self._limits
        return self._least(gram, slope, whole(self._noise, noise), whole(self.prior.pull, pull),
                           whole(low, lowest), whole(high, highest))


def is_of_other_size(likelihood, model, jacobian, hypotheses) -> bool:
    """
    Return whether an effect of one size that was added would have to be of another one.

    What it does, scaled by any factor, then has more evidence, odds of ``hypotheses`` included.
    """
    for i, spec in enumerate(model.robot.effects[likelihood.known:], start=likelihood.known):
        if find(spec.name).of_one_size:
            normal = NormalEquations(likelihood, model, jacobian)
            less = likelihood.fitted(fitting.without(model.robot, i), model.x)
            least = normal.beside((model.whitened - less.whitened)[None])
            if (abs(least.added[0]) > OTHER_SIZE and normal.alone.cost - least.cost
                    > EVIDENCE + 2.0 * np.log(max(hypotheses, 2))):
                return True
    return False
