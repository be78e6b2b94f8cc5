# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
From effects that were fitted to findings: those that are real, and what each could also be.

Small ones are listed apart and change no verdict.
"""

from collections.abc import Iterator

from gms_flex_control.discrepancy import fitting, thresholds, worth
from gms_flex_control.discrepancy.describe import evidence_of, evidence_of_ripple
from gms_flex_control.discrepancy.evidence import posterior, State
from gms_flex_control.discrepancy.result import Finding, Residual, Value
from gms_flex_control.discrepancy.torque_noise import clean_torque, excess_torque
from gms_flex_control.effects.registry import find
from gms_flex_control.identification.outcome import CONFIDENT
import numpy as np

_ALIKE = 0.96         # of what an effect explains: another that explains so much is alike
_RUNNERS = 6          # hypotheses tried in the place of a finding


def as_given(likelihood, state, nuisances, but=()) -> State:
    """Return a State, known parameters as given, ``but`` those of some joints, fitted anew."""
    x, joints = np.zeros(len(likelihood.nuisances)), likelihood.robot.joints
    free = {joints.index(name) for name in but}
    farthest = np.array([np.inf if one.joint in free else 0.0 for one in likelihood.nuisances])
    return _unweighed(likelihood, fitting.fit(
        likelihood, state.model.robot, x, nuisances, plausible=farthest), nuisances, farthest)


def as_before(likelihood, state, before) -> State:
    """Return a State with its effects beside the known parameters of another, ``before``."""
    robot = state.model.robot
    model = likelihood.fitted(robot, np.where(likelihood.resting(robot), 0.0, before.model.x))
    return _unweighed(likelihood, model, before.nuisances, before.plausible)


def _unweighed(likelihood, model, nuisances, plausible):
    """Return a model as a State whose evidence is not asked for."""
    own = fitting.effect_jacobian(likelihood, model, fitting.numbers_of(likelihood, model.robot))
    return State(model, nuisances, own, -np.inf, plausible)


def judged(likelihood, found, functions) -> tuple:
    """
    Return the search's end with effects that are real alone, their Worths, and what is left.

    Of a joint in which something is left, an effect that explains less than a free function of
    some variable, of the FreeFunctions, would in its place only resembles what is there. That is
    Found, list of Worth, Free or None, and Found with effects that only resemble as well.
    """
    found, worths = worth.pruned(likelihood, worth.timed(likelihood, found))
    whole = found
    while True:
        model, jacobian = found.best.model, found.best.jacobian
        beside = functions.ranked(model, jacobian)
        left = functions.left_in(model, jacobian, beside)
        somewhere = joints_left(likelihood, model, left)
        if not worths or not somewhere:
            return found, worths, left, whole
        shares = evidence_shares(functions, model, worths, left, beside, somewhere)
        if min(shares) > thresholds.RESEMBLES:
            return found, worths, left, whole
        worst = worths[int(np.argmin(shares))].index
        found, worths = worth.pruned(likelihood, worth.dropped(likelihood, found, worst))


def predictive(likelihood, found, worths, held_out) -> tuple:
    """
    Return the search's end without effects that worsen HeldOut prediction, and its Worths.

    Nor with those of one size that hardly act here: where they act, they would do much. A known
    parameter beyond its prior takes no effect's place: it is a wrong belief.
    """
    while worths:
        effects = found.best.model.robot.effects
        hardly = next((one.index for one in worths if find(effects[one.index].name).of_one_size
                       and not _lessened(likelihood, found, one, held_out)[2]), None)
        if hardly is not None:
            found, worths = worth.pruned(likelihood, worth.dropped(likelihood, found, hardly))
            continue
        energy = held_out.energy(found.best)
        fewer = {one.index: held_out.energy(one.rest) for one in worths if len(worths) > 1}
        # what has stood beside it may fall with it, and another take its place: the end counts
        ends = (worth.pruned(likelihood, worth.dropped(likelihood, found, index))
                for index in sorted(fewer, key=fewer.get)
                if thresholds.CLEARLY * fewer[index] <= energy)
        limit = fitting.plausible_limit(likelihood, found.best.model)
        better = next((end for end in ends if thresholds.CLEARLY * held_out.energy(
            limited(likelihood, end[0].best, limit)) <= energy), None)
        if better is None:
            break
        found, worths = better
    return _others(likelihood, found, worths, held_out)


def limited(likelihood, state, limit) -> State:
    """Return a State, known parameters no farther off than a ``limit`` (P,)."""
    model = state.model
    if fitting.is_within(likelihood, model, limit):
        return state
    return state._replace(plausible=limit, model=fitting.fit(
        likelihood, model.robot, model.x, state.jacobian, plausible=limit))


def _lessened(likelihood, found, one, held_out):
    """
    Return by how much an effect, a Worth, lessens the residual torque of data held out.

    Without it and with it, (n,) each [N m], and whether that matters in practice: not where
    neither that torque, below the noise floor without it as well, nor free runs are clearly better
    with it. Other recordings in which it hardly acts do not say that it does not: blocks of those
    that were fitted do.
    """
    state = found.best
    less = one.rest._replace(model=one.less, plausible=fitting.plausible_limit(
        likelihood, state.model))
    (before, _, free, _), (after, _, own_free, _) = held_out.errors(less), held_out.errors(state)
    better = np.sqrt(np.maximum(before ** 2 - after ** 2, 0.0)) / likelihood.coulomb
    shown, clearly = better >= thresholds.PRACTICAL, 1.0 + thresholds.NOT_CLEARLY
    if np.any(shown) and np.all(free <= clearly * own_free):
        shown &= before > np.minimum(np.nan_to_num(held_out.floor(state)), clearly * after)
    matters = bool(np.any(shown))
    if not matters and held_out.other:
        absent = likelihood.fitted(fitting.without(state.model.robot, one.index), state.model.x)
        if np.all(held_out.action(state.model, absent)
                  < thresholds.PRACTICAL * likelihood.coulomb):
            return _lessened(likelihood, found, one, held_out.of_blocks)
    return before, after, matters


def subsets(likelihood, found, held_out, fitted=lambda state: state) -> Iterator[State]:
    """Yield what is ``fitted`` of States with the effects that, added one by one, predict best."""
    added, chosen = range(likelihood.known, len(found.best.model.robot.effects)), ()

    def tried(some):
        return some, fitted(worth.with_fewer(
            likelihood, found, *(i for i in added if i not in some)))
    while len(chosen) < len(added) - 1:
        chosen, state = min((tried((*chosen, i)) for i in added if i not in chosen),
                            key=lambda one: held_out.energy(one[1]))
        yield state


def predicting_subset(likelihood, found, held_out) -> State:
    """Return the State of all effects found, none, or the first `subsets` that predicts best."""
    added = range(likelihood.known, len(found.best.model.robot.effects))
    best = worth.with_fewer(likelihood, found, *added) if added else found.best
    for state in subsets(likelihood, found, held_out):
        if held_out.energy(state) >= held_out.energy(best):
            break
        best = state
    return min(found.best, best, key=held_out.energy)


def _others(likelihood, found, worths, held_out):
    """
    Return the search's end with one effect alone, or as many others, if that predicts far better.

    What the motion that was fitted does not separate, another may.
    """
    if not worths:
        return found, worths
    likely = sorted((state for state in found.tried if np.isfinite(state.evidence)),
                    key=lambda state: -state.evidence)
    others = [state for size in {1, len(worths)} for state in [
        one for one in likely if len(one.key(likelihood.known)) == size][:_RUNNERS]]
    best = min(others, key=held_out.energy, default=found.best)
    if thresholds.BETTER * held_out.energy(best) > held_out.energy(found.best):
        return found, worths
    other, others = worth.pruned(likelihood, found._replace(best=best))
    return (other, others) if others else (found, worths)


def evidence_shares(functions, model, worths, left, beside, somewhere) -> list:
    """
    Return the share of the evidence there is for something that each effect, a Worth, has.

    Of what a free function has that takes its place, and of what is ``left`` over its own
    variable, where its shape is not that of what is there. Functions have the evidence of the list
    ``beside`` with all effects there: one that has no less then does not take an effect's place,
    and effects whose place the same one takes explain it together. Joints in which nothing is left
    have nothing to resemble.
    """
    rest = {free.place: max(free.evidence, 0.0) for free in beside}
    specs = [model.robot.effects[one.index] for one in worths]
    judged_here = [spec.joint in somewhere or find(spec.name).whole_arm for spec in specs]
    instead = [{free.place: free.evidence for free in functions.ranked(
        one.less, one.rest.jacobian, spec.joint)
        if free.evidence - rest[free.place] > thresholds.MOST_LEFT * one.outright}
        if is_judged else {}
        for spec, one, is_judged in zip(specs, worths, judged_here, strict=True)]
    if left is not None:
        for spec, one, places in zip(specs, worths, instead, strict=True):
            if left.joint == spec.joint and find(spec.name).evidence in left.variable:
                places[left.place] = max(places.get(left.place, 0.0), one.outright + left.evidence)
    together = {place: sum(one.outright for one, places in zip(worths, instead, strict=True)
                           if place in places) for place in rest}
    return [min((together[place] / max(together[place] - one.outright + evidence, 1e-12)
                 for place, evidence in places.items()), default=np.inf)
            for one, places in zip(worths, instead, strict=True)]


def joints_left(likelihood, model, free) -> tuple:
    """Return the joints (str) in which a model leaves more than noise, or a Free function."""
    quiet = excess_torque(likelihood, model) <= np.maximum(
        likelihood.largest_noise, likelihood.caution * clean_torque(likelihood))
    quiet = np.all(quiet.reshape(2, -1), axis=0)  # not where it is not finite
    return tuple(name for name, is_quiet in zip(likelihood.robot.joints, quiet, strict=True)
                 if not is_quiet or free is not None and name == free.joint)


def findings_of(likelihood, found, worths, held_out) -> list:
    """Return a Finding for each Worth; ``main`` ones lessen held-out torque by what matters."""
    models, samples = posterior(found.tried, likelihood.known), likelihood.motions[0].samples
    whole = max(found.before.model.cost - found.best.model.cost, 1e-12)
    beside = {other.key: other.decrease for other in found.dictionary.ranked(
        found.best.model, found.best.jacobian, thresholds.PLAUSIBLE)} if worths else {}
    out = []
    for one in worths:
        before, after, matters = _lessened(likelihood, found, one, held_out)
        spec = found.best.model.robot.effects[one.index]
        others, kind = _rivals(found, one, spec, beside), find(spec.name)
        custom = kind.is_custom(spec.values, samples.period, samples.commanded)
        if kind.of_recording and not (matters or custom):
            continue
        alike = {(name, joint) for name, joint, share in others if share > _ALIKE or (
            name in kind.similar and share > kind.declared_from)}
        out.append(Finding(
            effect=spec.name, joint=spec.joint, values=_values(likelihood, found, one.index),
            main=matters and not custom, torque=one.torque,
            share=min(one.loss / whole, 1.0), score=one.evidence, held_out=one.gain,
            probability=float(sum(mass for names, mass in models if spec.key in names)),
            runner_up=f'{others[0][0]} of {others[0][1]}' if others else None,
            runner_up_score=others[0][2] * one.evidence if others else 0.0,
            indistinguishable_from=tuple(sorted(alike)),
            discriminated_by=kind.discriminated_by if others else '',
            evidence=evidence_of(one, others), residual=Residual(before, after)))
    return out


def _rivals(found, one, spec, beside):
    """
    Return (name, joint, share of its loss) of what could stand in an effect's place.

    What another explains ``beside`` the effect (dict by key) is no share of that.
    """
    ranked = found.dictionary.ranked(one.less, one.rest.jacobian, thresholds.PLAUSIBLE)
    shares = [(*other.key, min((other.decrease - beside.get(other.key, 0.0))
                               / max(one.loss, 1e-12), 1.0))
              for other in ranked if other.key != spec.key]
    return sorted((rival for rival in shares if rival[2] > 0.0), key=lambda rival: -rival[2])[
        :_RUNNERS]


def _values(likelihood, found, index):
    """Return the Values of one effect, intervals by curvature or the scatter of simulations."""
    model, jacobian = found.best.model, found.best.jacobian
    numbers = fitting.numbers_of(likelihood, model.robot)
    weight = likelihood.weights(model.sums.groups)
    prior = fitting.prior_of(likelihood, model, numbers)
    free, scale = prior.free, prior.sd[prior.free]
    used = fitting.informative(likelihood, model, jacobian)[free] * scale[:, None]
    inverse = np.linalg.pinv((used * weight) @ used.T + np.eye(len(used)), hermitian=True)
    scatter = inverse @ (used * weight) @ likelihood.clean.T
    variance = np.zeros(len(free))
    variance[free] = np.maximum(np.diag(inverse), np.mean(scatter ** 2, axis=1)) * scale ** 2
    half = {(one.effect, one.parameter): CONFIDENT * float(np.sqrt(own))
            for one, own in zip(numbers, variance[len(model.x):], strict=True)}
    spec = model.robot.effects[index]
    return _with_intervals(spec, [half.get((index, k), 0.0) for k in range(len(spec.values))])


def _with_intervals(spec, half):
    """Return the Values of an effect whose intervals, within bounds, are so wide either way."""
    return tuple(
        Value(parameter.name, parameter.unit, float(value),
              float(max(value - away, parameter.lower)), float(min(value + away, parameter.upper)))
        for parameter, value, away in zip(find(spec.name).parameters, spec.values, half,
                                          strict=True))


def finding_of(ripple, robot) -> Finding:
    """Return the Finding of a FastRipple of a robot."""
    spec = ripple.spec
    own = np.array([joint == spec.joint for joint in robot.joints])
    values = _with_intervals(spec, [CONFIDENT * sd for sd in ripple.deviations])
    return Finding(
        effect=spec.name, joint=spec.joint, values=values, main=True, torque=ripple.torque,
        share=ripple.share, score=2.0 * ripple.gain.nats, probability=1.0, held_out=ripple.gain,
        runner_up=None, runner_up_score=0.0, indistinguishable_from=(), discriminated_by='',
        evidence=evidence_of_ripple(ripple),
        residual=Residual(*(np.where(own, one, np.nan) for one in ripple.residual)),
        full_rate=True)
