# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What each effect of a model is worth, and the model without those that are worth nothing.

An effect is worth something if its evidence and held-out prediction both speak for it.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.discrepancy import fitting
from gms_flex_control.discrepancy.dictionary import may_join
from gms_flex_control.discrepancy.evidence import finite, State, state_of
from gms_flex_control.discrepancy.likelihood import Fitted
from gms_flex_control.discrepancy.search import Found
from gms_flex_control.discrepancy.thresholds import CREDIBLE, EVIDENCE, FEW_BLOCKS, MOST_LEFT
from gms_flex_control.discrepancy.validation import (
    acting,
    Gain,
    gain_where,
    predicted,
    prediction_cost,
)
from gms_flex_control.effects.registry import find
import numpy as np


class Worth(NamedTuple):
    """One effect of a model and what it is worth."""

    index: int         # among the robot's effects
    torque: float      # rms of what it contributes [N m]
    share: float       # of what it changes that nothing else can make
    loss: float        # cost of its absence, known parameters no farther off than plausible
    evidence: float    # 2 log evidence that it adds
    outright: float    # likewise, known parameters no farther off than plausible without it
    gain: Gain         # on held-out blocks
    less: Fitted       # the model without it, known parameters plausible
    rest: State        # likewise, known parameters anywhere

    @property
    def weight(self) -> float:
        """Return by what effects are ranked [N m], between all torque and what is its alone."""
        return self.torque * self.share ** 0.25

    def is_real(self, caution=1.0) -> bool:
        """Return whether evidence and held-out data speak for it, with so much ``caution``."""
        return self.evidence > EVIDENCE and self.gain.is_real(caution)


def _worth_of(likelihood, found, i, whole):
    """Return what the i-th effect is worth in a model that predicts blocks so well, (B,)."""
    model, jacobian = found.best.model, found.best.jacobian
    spec = model.robot.effects[i]
    less = likelihood.fitted(fitting.without(model.robot, i), model.x)
    others = fitting.jacobian_without(likelihood, model, jacobian, i)
    change = less.whitened - model.whitened
    own, loss = _beside(likelihood, model, less, others, change)
    anything, plausible, limit = fitting.fit_without(likelihood, model, less.robot, others)
    gain = gain_where(likelihood, whole - predicted(likelihood, plausible, others, limit), change)
    if fitting.is_at_limit(spec, model.robot) or (find(spec.name).of_feedback and not _predicts(
            likelihood, found, spec, plausible)):
        gain = gain._replace(nats=min(gain.nats, 0.0))
    rest = state_of(likelihood, anything, others, found.hypotheses)
    evidence = finite(found.best.evidence - rest.evidence)
    share = min(loss / own, 1.0) if own > 0.0 else 0.0
    return Worth(i, _torque_rms(likelihood, less, model), share,
                 max(plausible.cost - model.cost, 0.0), evidence,
                 evidence + plausible.cost - anything.cost, gain, plausible, rest)


def acts_widely(likelihood, model, index) -> bool:
    """Return whether an effect acts in as many blocks as judge, or in all."""
    acts = acting(likelihood, _action(likelihood, model, index))
    return np.sum(acts) >= min(FEW_BLOCKS, len(acts))


def acts_like(likelihood, model, index, values) -> bool:
    """Return whether most of what an effect does is as with other ``values``, of Value."""
    effects = model.robot.effects
    spec = replace(effects[index], values=tuple(value.value for value in values))
    if spec == effects[index]:
        return True
    other = likelihood.fitted(
        replace(model.robot, effects=(*effects[:index], spec, *effects[index + 1:])), model.x)
    change = other.whitened - model.whitened
    return change @ change <= MOST_LEFT * np.sum(_action(likelihood, other, index) ** 2)


def _action(likelihood, model, index):
    """Return what an effect of a model changes of its whitened residuals (R,)."""
    less = likelihood.fitted(fitting.without(model.robot, index), model.x)
    return model.whitened - less.whitened


def _beside(likelihood, model, less, others, change):
    """Return the squares of what an effect changes, and of what nothing else can make of it."""
    weight = likelihood.weights(model.sums.groups)
    pull = fitting.prior_of(likelihood, less).pull
    kept = np.ones(len(others), dtype=bool)
    kept[:len(model.x)] = likelihood.resting(less.robot) | ~likelihood.resting(model.robot)
    used = fitting.informative(likelihood, less, others)[kept]
    gram = (used * weight) @ used.T + np.diag(pull[kept])
    slope = used @ (weight * change)
    own = float(change @ (weight * change))
    return own, max(own - float(slope @ np.linalg.lstsq(gram, slope, rcond=1e-12)[0]), 0.0)


def _torque_rms(likelihood, one, other):
    """Return the rms by which residual torques of two models differ, larger equation."""
    squares = [(a - b) ** 2 for a, b in zip(likelihood.torque(one), likelihood.torque(other),
                                            strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(squares), axis=0)).max())


def _predicts(likelihood, found, spec, less):
    """Return whether an effect makes prediction one sample ahead better."""
    model = found.best.model
    with_it, without_it = prediction_cost(
        likelihood, [(model.robot, model.x), (less.robot, less.x)])
    return without_it - with_it > EVIDENCE + 2.0 * np.log(found.hypotheses)


def pruned(likelihood, found) -> tuple:
    """Return the search's end with effects that data speak for alone, and their Worths, ranked."""
    while True:
        model, jacobian = found.best.model, found.best.jacobian
        added = range(likelihood.known, len(model.robot.effects))
        whole = predicted(likelihood, model, jacobian, fitting.plausible_limit(
            likelihood, model)) if added else None
        worths = [_worth_of(likelihood, found, i, whole) for i in added]
        weak = [one for one in worths if not one.is_real(likelihood.caution)]
        if not weak:
            most = max((one.loss for one in worths), default=0.0)
            return found, sorted(worths, key=lambda one: (one.loss < (1.0 - CREDIBLE) * most,
                                                          -one.weight))
        # what has no evidence goes first: beside it others are known badly from few data
        worst = min(weak, key=lambda one: (one.evidence > EVIDENCE, min(one.evidence,
                                                                        2.0 * one.gain.nats)))
        found = dropped(likelihood, found, worst.index)


def dropped(likelihood, found, index) -> Found:
    """Return the end without an effect and models with it, going on with the likeliest other."""
    tried = (with_fewer(likelihood, found, index), *_tried_without(
        likelihood, found, found.best.model.robot.effects[index]))
    return found._replace(best=max(tried, key=lambda state: state.evidence), tried=tried)


def with_fewer(likelihood, found, *dropped) -> State:
    """Return the State of a search's end without effects (indices), all else re-tuned."""
    model = found.best.model
    return state_of(likelihood, *fitting.refitted(  # derivatives anew: much may move
        likelihood, fitting.without(model.robot, *dropped), model.x, found.nuisances),
        found.hypotheses)


def _tried_without(likelihood, found, spec):
    """Return the States that were tried without an effect."""
    return (state for state in found.tried if spec.key not in state.key(likelihood.known))


def timed(likelihood, found) -> Found:
    """
    Return the search's end with late effects exchanged where others predict better.

    Lag and delay differ above the frequencies of whitened residuals only.
    """
    for i in range(likelihood.known, len(found.best.model.robot.effects)):
        model = found.best.model
        effects = model.robot.effects
        spec, late = effects[i], find(effects[i].name)
        for name in late.similar if late.of_feedback else ():
            kind = find(name)
            other = replace(spec, name=name, values=(
                min(spec.values[0], kind.parameters[0].upper),))
            if (kind.whole_arm != late.whole_arm or not kind.of_feedback
                    or not may_join(other, fitting.without(model.robot, i), likelihood.known)):
                continue
            swapped, jacobian = fitting.refitted(likelihood, replace(
                model.robot, effects=(*effects[:i], other, *effects[i + 1:])), model.x,
                found.nuisances)
            own, instead = prediction_cost(likelihood, [
                (one.robot, one.x) for one in (model, swapped)])
            if instead < own - EVIDENCE - 2.0 * np.log(found.hypotheses):
                best = state_of(likelihood, swapped, jacobian, found.hypotheses)
                found = found._replace(best=best, tried=(best, *_tried_without(
                    likelihood, found, spec)))
                break
    return found
