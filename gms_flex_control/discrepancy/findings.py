# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
From effects that were fitted to findings: what each is worth, and what it could also be.

An effect is a finding if its evidence and held-out prediction both speak for it. Small ones are
listed apart and change no verdict.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.discrepancy.describe import evidence_of
from gms_flex_control.discrepancy.dictionary import may_join
from gms_flex_control.discrepancy.evidence import finite, posterior, State, state_of
from gms_flex_control.discrepancy.fitting import (
    effect_columns,
    fit,
    informative,
    is_at_limit,
    is_within,
    numbers_of,
    prior_of,
    refitted,
    without,
)
from gms_flex_control.discrepancy.likelihood import Fitted
from gms_flex_control.discrepancy.remainder import FreeFunctions
from gms_flex_control.discrepancy.result import Finding, Residual, Value
from gms_flex_control.discrepancy.thresholds import (
    BETTER,
    CLEARLY,
    CREDIBLE,
    EVIDENCE,
    LARGEST_NOISE,
    PLAUSIBLE,
    PRACTICAL,
    RESEMBLES,
    UNSEEN,
)
from gms_flex_control.discrepancy.validation import Gain, gain_of, prediction_cost
from gms_flex_control.effects.registry import find
from gms_flex_control.identification.outcome import CONFIDENT
import numpy as np

_ALIKE = 0.96         # of what an effect explains: another that explains so much is alike
_RUNNERS = 6          # hypotheses tried in the place of a finding
_OF_INERTIA = ('inertia', 'motor_inertia', 'gravity')


class Worth(NamedTuple):
    """One effect of a model and what it is worth."""

    index: int         # among the robot's effects
    torque: float      # rms of what it contributes [N m]
    share: float       # of its rows that nothing else can make
    loss: float        # cost of its absence, known parameters no farther off than plausible
    evidence: float    # 2 log evidence that it adds
    outright: float    # likewise, known parameters no farther off than plausible without it
    gain: Gain         # on held-out blocks
    less: Fitted       # the model without it, known parameters plausible
    rest: State        # likewise, known parameters anywhere

    @property
    def weight(self) -> float:
        """
        Return by what effects are ranked [N m]: between all its torque and what is its alone.

        A large effect that others can make the better part of is large all the same.
        """
        return self.torque * self.share ** 0.25

    def is_real(self, caution=1.0) -> bool:
        """Return whether evidence and held-out data speak for it, with so much ``caution``."""
        return self.evidence > EVIDENCE and self.gain._replace(
            sigmas=self.gain.sigmas / caution).is_real


def plausible_limit(likelihood, model) -> np.ndarray:
    """
    Return how far known parameters may go where they stand for an effect of a model, (P,).

    In standard deviations of their priors; as far as the model has them in any case.
    """
    return np.maximum(PLAUSIBLE, np.abs(model.x) / likelihood.sd)


def as_given(likelihood, state, nuisances) -> State:
    """Return a State with its effects fitted beside known parameters as they are given."""
    x = np.zeros(len(likelihood.nuisances))
    model = fit(likelihood, state.model.robot, x, nuisances, plausible=0.0)
    own = effect_columns(likelihood, model.robot, x, model.rows, numbers_of(likelihood,
                                                                            model.robot))
    return State(model, nuisances, own, -np.inf, 0.0)


def _worth_of(likelihood, found, i):
    """Return what the i-th effect of a search's end is worth."""
    model, columns = found.best.model, found.best.columns
    spec = model.robot.effects[i]
    less, others = without(likelihood, model, columns, i)
    change = less.rows - model.rows
    own, loss = _beside(likelihood, model, less, others, change)
    anything, limit = fit(likelihood, less.robot, model.x, others), plausible_limit(
        likelihood, model)
    plausible = anything if is_within(likelihood, anything, limit) else fit(
        likelihood, less.robot, model.x, others, plausible=limit)
    gain = gain_of(likelihood, (model, columns), (plausible, others), change, limit)
    if is_at_limit(spec, model.robot) or (find(spec.name).of_feedback and not _predicts(
            likelihood, found, spec, plausible)):
        gain = gain._replace(nats=min(gain.nats, 0.0))
    rest = state_of(likelihood, anything, others, found.hypotheses)
    evidence = finite(found.best.evidence - rest.evidence)
    return Worth(i, likelihood.torque_rms(less, model), min(loss / own, 1.0) if own > 0.0 else 0.0,
                 max(plausible.cost - model.cost, 0.0), evidence,
                 evidence + plausible.cost - anything.cost, gain, plausible, rest)


def _beside(likelihood, model, less, others, change):
    """Return the squares of what an effect changes, and of what nothing else can make of it."""
    weight = likelihood.weights(model.sums.groups)
    pull = prior_of(likelihood, less).pull
    kept = np.ones(len(others), dtype=bool)
    kept[:len(model.x)] = likelihood.resting(less.robot) | ~likelihood.resting(model.robot)
    used = informative(likelihood, less, others)[kept]
    gram = (used * weight) @ used.T + np.diag(pull[kept])
    slope = used @ (weight * change)
    own = float(change @ (weight * change))
    return own, max(own - float(slope @ np.linalg.lstsq(gram, slope, rcond=1e-12)[0]), 0.0)


def _predicts(likelihood, found, spec, less):
    """Return whether an effect makes prediction one sample ahead better, inertia as it is."""
    model = found.best.model
    inertia = np.array([one.name in _OF_INERTIA for one in likelihood.nuisances], dtype=bool)
    with_it, without_it = prediction_cost(
        likelihood, [(model.robot, model.x), (less.robot, np.where(inertia, model.x, less.x))],
        spec.joint)
    return without_it - with_it > EVIDENCE + 2.0 * np.log(found.hypotheses)


def judged(likelihood, found) -> tuple:
    """
    Return the search's end with effects that are real alone, their Worths, and what is left.

    Where a free function of some variable is left to explain, an effect that explains less than
    such functions would in its place only resembles what is there.

    Returns
    -------
    Found, list of Worth, Free or None, Found
        The last with effects that only resemble what is there as well.

    """
    found, worths = _pruned(likelihood, _timed(likelihood, found))
    functions, whole = FreeFunctions(likelihood), found
    while True:
        left = functions.left_in(found.best.model, found.best.columns, caution_of(likelihood))
        if not worths or left is None and not is_noisy(likelihood, found.best.model):
            return found, worths, left, whole
        shares = [_share(functions, found.best.model.robot.effects[one.index], one, left)
                  for one in worths]
        if min(shares) > RESEMBLES:
            return found, worths, left, whole
        worst = worths[int(np.argmin(shares))].index
        found, worths = _pruned(likelihood, _dropped(likelihood, found, worst))


def predictive(likelihood, found, worths, held_out) -> tuple:
    """
    Return the search's end without effects that worsen HeldOut prediction, and its Worths.

    Nor with those of one size that hardly act here: where they act, they would do much.
    """
    while worths:
        effects = found.best.model.robot.effects
        hardly = next((one.index for one in worths if find(effects[one.index].name).of_one_size
                       and not _lessened(likelihood, found, one, held_out)[2]), None)
        if hardly is not None:
            found, worths = _pruned(likelihood, _dropped(likelihood, found, hardly))
            continue
        energy = held_out.energy(found.best)
        if len(worths) == 1:
            break
        without_each = {one.index: held_out.energy(one.rest) for one in worths}
        worst = min(without_each, key=without_each.get)
        if CLEARLY * without_each[worst] > energy:
            break
        found, worths = _pruned(likelihood, _dropped(likelihood, found, worst))
    return _alone(likelihood, found, worths, held_out)


def _lessened(likelihood, found, one, held_out):
    """
    Return by how much an effect, a Worth, lessens the residual torque of HeldOut data.

    Without it and with it, (n,) each [N m], and whether that matters in practice.
    """
    before, after = held_out.torque(one.rest._replace(model=one.less, plausible=plausible_limit(
        likelihood, found.best.model))), held_out.errors(found.best).torque
    better = np.sqrt(np.maximum(before ** 2 - after ** 2, 0.0)) / likelihood.coulomb
    return before, after, bool(np.any(better >= PRACTICAL))


def predicting_subset(likelihood, found, held_out) -> State:
    """
    Return the State with those of the effects found that together predict held-out data best.

    One effect after the other is added to none, while that predicts better.
    """
    added = range(likelihood.known, len(found.best.model.robot.effects))

    def tried(subset):
        state = (found.best if len(subset) == len(added) else _without(
            likelihood, found, *(i for i in added if i not in subset)))
        return held_out.energy(state), state, subset
    last, every = tried(()), tried(tuple(added))
    while len(last[2]) < len(added) - 1:
        other = min((tried((*last[2], i)) for i in added if i not in last[2]),
                    key=lambda one: one[0])
        if other[0] >= last[0]:
            break
        last = other
    return min(every, last, key=lambda one: one[0])[1]


def _alone(likelihood, found, worths, held_out):
    """Return the search's end with one effect alone if that predicts held-out data better."""
    single = sorted((state for state in found.tried if len(state.key(likelihood.known)) == 1),
                    key=lambda state: -state.evidence)[:_RUNNERS]
    if not worths or not single:
        return found, worths
    best = min(single, key=held_out.energy)
    if BETTER * held_out.energy(best) > held_out.energy(found.best):
        return found, worths
    other, others = _pruned(likelihood, found._replace(best=best))
    return (other, others) if others else (found, worths)


def _share(functions, spec, one, left):
    """
    Return the share of the evidence there is for something that an effect, a Worth, has.

    Of what a free function would in its place; and of what is left over its own variable, where
    its shape is not that of what is there.
    """
    free = functions.ranked(one.less, one.rest.columns, spec.joint)
    if not free or free[0].evidence <= 0.0:
        return np.inf
    share = one.outright / free[0].evidence
    if left is not None and left.joint == spec.joint and find(spec.name).evidence in left.variable:
        share = min(share, one.outright / max(one.outright + left.evidence, 1e-12))
    return share


def is_noisy(likelihood, model) -> bool:
    """Return whether a model leaves more than drives make of noise, and than encoders do."""
    return not np.all(likelihood.excess_torque(model) <= np.maximum(
        LARGEST_NOISE * np.tile(likelihood.coulomb, 2),
        caution_of(likelihood) * likelihood.clean_torque()))  # also where it is not finite


def caution_of(likelihood) -> float:
    """Return times as many standard errors as usual that held-out data must show."""
    return UNSEEN if likelihood.unseen else 1.0


def _timed(likelihood, found):
    """
    Return the search's end with late effects exchanged where others predict better.

    Lag and delay differ above the frequencies of the rows only. Both are compared beside all else
    as fitted with the one, and as with the other.
    """
    for i in range(likelihood.known, len(found.best.model.robot.effects)):
        model = found.best.model
        spec = model.robot.effects[i]
        for name in find(spec.name).confusable if find(spec.name).of_feedback else ():
            kind = find(name)
            other = replace(spec, name=name, values=(
                min(spec.values[0], kind.parameters[0].upper),))
            rest = model.robot.effects[:i] + model.robot.effects[i + 1:]
            if (kind.whole_arm != find(spec.name).whole_arm or not kind.of_feedback
                    or not may_join(other, replace(model.robot, effects=rest),
                                    likelihood.known)):
                continue
            swapped, columns = refitted(likelihood, likelihood.fitted(
                _instead(model.robot, i, other), model.x), found.nuisances)
            costs = prediction_cost(likelihood, [
                (_instead(one.robot, i, late), one.x) for late in (
                    spec, swapped.robot.effects[i]) for one in (model, swapped)], spec.joint)
            own, instead = costs.reshape(2, 2).sum(axis=1)
            if instead < own - 2.0 * (EVIDENCE + 2.0 * np.log(found.hypotheses)):
                best = state_of(likelihood, swapped, columns, found.hypotheses)
                found = found._replace(best=best, tried=(best, *_tried_without(
                    likelihood, found, spec)))
                break
    return found


def _instead(robot, i, spec):
    """Return a robot with another in the place of its i-th effect."""
    return replace(robot, effects=(*robot.effects[:i], spec, *robot.effects[i + 1:]))


def _pruned(likelihood, found):
    """Return the search's end with effects that data speak for alone, and their Worths, ranked."""
    while True:
        worths = [_worth_of(likelihood, found, i) for i in range(
            likelihood.known, len(found.best.model.robot.effects))]
        weak = [one for one in worths if not one.is_real(caution_of(likelihood))]
        if not weak:
            most = max((one.loss for one in worths), default=0.0)
            return found, sorted(worths, key=lambda one: (one.loss < (1.0 - CREDIBLE) * most,
                                                          -one.weight))
        # what has no evidence goes first: beside it others are known badly from few data
        worst = min(weak, key=lambda one: (one.evidence > EVIDENCE, min(one.evidence,
                                                                        2.0 * one.gain.nats)))
        found = _dropped(likelihood, found, worst.index)


def _dropped(likelihood, found, index):
    """
    Return the search's end without an effect: models with it no longer count as tried.

    It goes on with the likeliest of the others: one of them may have what stood in its place.
    """
    tried = (_without(likelihood, found, index), *_tried_without(
        likelihood, found, found.best.model.robot.effects[index]))
    return found._replace(best=max(tried, key=lambda state: state.evidence), tried=tried)


def _without(likelihood, found, *dropped):
    """Return the State of a search's end without effects (indices), all else re-tuned."""
    # derivatives anew: much may move
    less, _ = without(likelihood, found.best.model, found.best.columns, *dropped)
    return state_of(likelihood, *refitted(likelihood, less, found.nuisances), found.hypotheses)


def _tried_without(likelihood, found, spec):
    """Return the States that were tried without an effect."""
    return (state for state in found.tried
            if (spec.name, spec.joint) not in state.key(likelihood.known))


def findings_of(likelihood, found, worths, held_out) -> list:
    """
    Return a Finding for each Worth of a search's end.

    Those that matter, ``main``, lessen the residual torque of HeldOut data by what matters in
    practice.
    """
    models = posterior(found.tried, likelihood.known)
    whole = max(found.before.model.cost - found.best.model.cost, 1e-12)
    out = []
    for one in worths:
        before, after, main = _lessened(likelihood, found, one, held_out)
        spec = found.best.model.robot.effects[one.index]
        others, kind = _rivals(found, one, spec), find(spec.name)
        alike = {f'{name} of {joint}' for name, joint, share in others if share > _ALIKE or (
            name in kind.confusable and share > kind.declared_from)}
        out.append(Finding(
            effect=spec.name, joint=spec.joint, values=_values(likelihood, found, one.index),
            main=main, torque=one.torque,
            share=min(one.loss / whole, 1.0), score=one.evidence, held_out=one.gain,
            probability=float(sum(mass for names, mass in models
                                  if (spec.name, spec.joint) in names)),
            runner_up=f'{others[0][0]} of {others[0][1]}' if others else None,
            runner_up_score=others[0][2] * one.evidence if others else 0.0,
            confusable_with=tuple(sorted(alike)),
            discriminated_by=kind.discriminated_by if others else '',
            evidence=evidence_of(one, others), residual=Residual(before, after)))
    return [one for one in out if one.main or not find(one.effect).of_recording]


def _rivals(found, one, spec):
    """Return (name, joint, share of its loss) of what could stand in an effect's place."""
    ranked = found.dictionary.ranked(one.less, one.rest.columns, PLAUSIBLE)
    return [(*other.key, min(other.gain / max(one.loss, 1e-12), 1.0))
            for other in ranked[:_RUNNERS] if other.key != (spec.name, spec.joint)]


def _values(likelihood, found, index):
    """
    Return the Values of one effect, intervals by the curvature of the likelihood.

    Or by how far null simulations scatter, if that is more: the curvature assumes that rows are
    independent.
    """
    model, columns = found.best.model, found.best.columns
    numbers, weight = numbers_of(likelihood, model.robot), likelihood.weights(model.sums.groups)
    prior = prior_of(likelihood, model, numbers)
    free, scale = prior.free, prior.sd[prior.free]
    used = informative(likelihood, model, columns)[free] * scale[:, None]
    inverse = np.linalg.pinv((used * weight) @ used.T + np.eye(len(used)), hermitian=True)
    scatter = inverse @ (used * weight) @ likelihood.clean.T
    variance = np.zeros(len(free))
    variance[free] = np.maximum(np.diag(inverse), np.mean(scatter ** 2, axis=1)) * scale ** 2
    half = {(one.effect, one.parameter): CONFIDENT * float(np.sqrt(own))
            for one, own in zip(numbers, variance[len(model.x):], strict=True)}
    spec = model.robot.effects[index]
    return tuple(
        Value(parameter.name, parameter.unit, float(value),
              float(value) - half.get((index, k), 0.0), float(value) + half.get((index, k), 0.0))
        for k, (parameter, value) in enumerate(zip(find(spec.name).parameters, spec.values,
                                                   strict=True)))
