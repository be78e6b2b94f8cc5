# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The evidence for models: likelihood, priors, and what the freedom of each parameter costs.

Laplace's approximation: 2 log evidence is that of the likeliest parameters less log det of what
the data add to the precision of the priors (the Occam factor), less the odds against each effect
before anything was measured.
"""

from typing import NamedTuple

from gms_flex_control.discrepancy.fitting import informative, numbers_of, prior_cost, prior_of
from gms_flex_control.discrepancy.likelihood import Fitted
from gms_flex_control.discrepancy.residuals import stiffness_along
from gms_flex_control.discrepancy.thresholds import CREDIBLE
import numpy as np

_SOFTEST = 0.05       # of the stiffness believed, which a play has


class State(NamedTuple):
    """A model, its derivatives and its evidence."""

    model: Fitted
    columns: np.ndarray  # (C, R) by nuisance parameters, then numbers of effects
    evidence: float      # 2 log, but for a constant

    def key(self, known):
        """Return the effects that were added, frozenset of (effect, joint)."""
        return frozenset((spec.name, spec.joint) for spec in self.model.robot.effects[known:])


def state_of(likelihood, model, columns, hypotheses):
    """
    Return a model with its evidence.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    model : Fitted
        At its likeliest.
    columns : ndarray, shape (C, R)
        Derivatives of its rows.
    hypotheses : int
        How many effects of joints are looked for; one is expected to be missing.

    Returns
    -------
    State

    """
    numbers = numbers_of(likelihood, model.robot)
    precision, _, free = prior_of(likelihood, model.robot, numbers)
    weight = likelihood.weights(model.sums.groups)
    scaled = informative(likelihood, model, columns)[free] / np.sqrt(precision[free])[:, None]
    gram = (scaled * weight) @ scaled.T
    _, occam = np.linalg.slogdet(np.eye(len(gram)) + gram)
    added = len(model.robot.effects) - len(likelihood.robot.effects)
    exact = likelihood.sums(model.rows, model.robot, model.x, exact=True)
    evidence = (-exact.cost - prior_cost(likelihood, model) - occam
                + 2.0 * log_determinant(likelihood, model)
                - 2.0 * added * np.log(max(hypotheses, 2)))
    return State(model, columns, float(evidence) if np.isfinite(evidence) else -np.inf)


def log_determinant(likelihood, model):
    """
    Return the logarithm of the determinant of rows by readings, of what is not encoder noise.

    Beside the motion of a link its torsion is an answer, not a choice: so the density of readings
    is that of rows times the slope of the spring. A softer spring makes less torque of all that
    is read wrongly, which explains none of it. What null simulations show is cleared from the
    sums; what levels have beyond counts here. As believed the determinant is 1.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    model : Fitted
        With its noise levels.

    """
    beyond = 1.0 - likelihood.weights(model.sums.groups)
    if not beyond.any():
        return 0.0
    n, joints = likelihood.robot.n_joints, likelihood.robot.joints
    believed, out = likelihood.robot.arm.stiffness, 0.0
    beyond = np.bincount(likelihood.recording * 2 * n + likelihood.channel, beyond,
                         2 * n * len(likelihood.motions)).reshape(-1, 2, n)[:, 1]
    seen = np.isfinite(believed) & [joint not in likelihood.unseen for joint in joints]
    constants = likelihood.constants(model.robot, model.x)
    for motion, count in zip(likelihood.motions, beyond * seen, strict=True):
        if count.any():
            ratio = np.maximum(stiffness_along(motion, constants)[seen] / believed[seen], _SOFTEST)
            out += float(count[seen] @ np.log(ratio))
    return out


def posterior(states, known):
    """
    Return the probabilities of models that were tried, those of equal effects once.

    Parameters
    ----------
    states : sequence of State
        Tried.
    known : int
        Effects the user knew of.

    Returns
    -------
    list of (frozenset, float)
        Effects and probability, the likeliest first.

    """
    best = {}
    for state in states:
        key = state.key(known)
        best[key] = max(best.get(key, -np.inf), state.evidence)
    keys = sorted(best, key=lambda key: -best[key])
    log = 0.5 * np.array([best[key] for key in keys])
    mass = np.exp(log - log.max())
    return list(zip(keys, (mass / mass.sum()).tolist(), strict=True))


def credible(models, mass=CREDIBLE):
    """Return the fewest models (of `posterior`) that hold so much of the probability."""
    shares = np.cumsum([share for _, share in models])
    return models[:int(np.searchsorted(shares, mass)) + 1]
