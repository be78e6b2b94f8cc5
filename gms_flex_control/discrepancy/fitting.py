# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Gauss and Newton on all that is free: nuisance parameters, and parameters of effects."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.discrepancy.likelihood import Fitted
from gms_flex_control.discrepancy.nuisance import LARGEST
from gms_flex_control.discrepancy.thresholds import PLAUSIBLE
from gms_flex_control.discrepancy.torque_noise import white_noise
from gms_flex_control.effects.registry import bounds_of, find
from gms_flex_control.params.robot import RobotParams
import numpy as np

_RIDGE = 1e-10                # of the diagonal, where parameters are nearly one
_PULL = 1e-9                  # relative slope at a bound below which it holds
_STEP = 0.01                  # of a value, for its derivative
_LEAST = 0.1                  # of its usual size: so large a value is for that, at least
_ANGLES = {'phase': 0.02, 'direction': 0.02, 'order': 0.02}
_REACH, _ANGLE_REACH = 60.0, 25.0  # largest change at once, in steps
_SHRINK = (1.0, 0.3, 0.1)     # of a step that does not help
_ENOUGH = 0.3                 # decrease of the cost below which a fit has ended
_TRIFLE = 0.1                 # likewise, foreseen: only the whole step is tried for it
_NEAR = 2.0                   # steps of a derivative within which it is kept
_PHASE_SD = np.pi / np.sqrt(3.0)  # of a phase that nothing is known of
_LEAST_SHARE = 0.3            # of the squares of a derivative that is not encoder noise
_LEAST_EIGENVALUE = 1e-10     # of scaled products of derivatives
_ANCHORED = 3                 # times at most that what noise adds is taken anew
_AS_FORESEEN = 10.0           # times `_ENOUGH`: it adds as much as foreseen
_RETUNED = 3                  # times at most that derivatives are taken anew
_AT_LIMIT = 0.01              # relative distance from a limit of the search


def solve(gram, right, lower, upper) -> np.ndarray:
    """
    Return the minimiser (P,) of ``x' G x / 2 - b' x`` within bounds that hold zero.

    A primal active set: from zero to the minimiser of all that is free, or to the first bound on
    the way; at the minimiser, the bound with the largest slope inward is freed.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram = gram * np.outer(scale, scale)
    gram.flat[::len(gram) + 1] += _RIDGE
    right, bounds, lower, upper = right * scale, (lower, upper), lower / scale, upper / scale
    x, free = np.zeros(len(right)), upper > lower
    for _ in range(10 * len(right)):
        if free.any():
            target = np.linalg.solve(gram[np.ix_(free, free)], right[free]
                                     - gram[np.ix_(free, ~free)] @ x[~free])
            step = target - x[free]
            room = np.where(step > 0.0, upper[free] - x[free], lower[free] - x[free])
            room = np.divide(room, step, out=np.full_like(step, np.inf), where=step != 0.0)
            share = room.min()
            if share < 1.0:
                at = np.flatnonzero(free)[room <= share]
                x[free] += share * step
                x[at] = np.where(step[room <= share] > 0.0, upper[at], lower[at])
                free[at] = False
                continue
            x[free] = target
        slope = right - gram @ x
        inward = np.where(x <= lower, slope, -slope) * (~free & (upper > lower))
        worst = int(np.argmax(inward))
        if not inward[worst] > _PULL * np.abs(right).max():
            break
        free[worst] = True
    return np.clip(x * scale, *bounds)


class EffectParameter(NamedTuple):
    """One parameter of one effect that a fit moves."""

    effect: int
    parameter: int
    step: float
    reach: float
    lower: float
    upper: float
    sd: float          # of its prior
    centred: bool      # whether zero is its likeliest value


def numbers_of(likelihood, robot, first=None) -> list:
    """Return the EffectParameters of a robot from the ``first`` effect on, default the added."""
    numbers = []
    first = likelihood.known if first is None else first
    for i, spec in enumerate(robot.effects[first:], start=first):
        kind = find(spec.name)
        typical = kind.typical(likelihood.scales_of(spec.joint))
        for k, (parameter, lower, upper) in enumerate(
                zip(kind.parameters, *bounds_of(spec, robot), strict=True)):
            if parameter.fixed:
                continue
            angle, value = _ANGLES.get(parameter.name), spec.values[k]
            step = angle or _STEP * max(abs(value), _LEAST * (typical[k] or 1.0))
            sd = typical[k] or (_PHASE_SD if parameter.unit == 'rad' and angle
                                else max(abs(value), 1e-9))
            numbers.append(EffectParameter(i, k, step, (_ANGLE_REACH if angle else _REACH) * step,
                                           lower, upper, sd, typical[k] is not None))
    return numbers


def values_of(robot, numbers) -> np.ndarray:
    """Return the values (V,) of parameters."""
    return np.array([robot.effects[n.effect].values[n.parameter] for n in numbers])


def at_values(robot, numbers, values) -> RobotParams:
    """Return a robot with parameters of its effects at values (V,), kept within bounds."""
    lists = [list(spec.values) for spec in robot.effects]
    for number, value in zip(numbers, values, strict=True):
        lists[number.effect][number.parameter] = float(np.clip(value, number.lower, number.upper))
    return replace(robot, effects=tuple(
        spec if list(spec.values) == entries else replace(spec, values=tuple(entries))
        for spec, entries in zip(robot.effects, lists, strict=True)))


def is_at_limit(spec, robot) -> bool:
    """Return whether an effect has a parameter where the search for it ends, which is no value."""
    kind = find(spec.name)

    def is_end(limit, allowed, unit):
        return limit != allowed or (np.isfinite(limit) and limit != 0.0 and unit != '1')
    return any(
        not kind.least_is_value and is_end(lower, one.lower, one.unit)
        and value < lower + _AT_LIMIT * abs(lower)
        or is_end(upper, one.upper, one.unit) and value > upper - _AT_LIMIT * abs(upper)
        for one, value, lower, upper in zip(
            kind.parameters, spec.values, *bounds_of(spec, robot), strict=True))


def plausible_limit(likelihood, model) -> np.ndarray:
    """Return how far (P,) known parameters that stand for an effect may go, or are already."""
    return np.maximum(PLAUSIBLE, np.abs(model.x) / likelihood.sd)


def is_within(likelihood, model, plausible) -> bool:
    """Return whether nuisance parameters are within so many deviations of their priors."""
    return bool(np.all(np.abs(model.x) <= plausible * likelihood.sd))


def effect_jacobian(likelihood, model, numbers) -> np.ndarray:
    """Return derivatives (V, R) of the residuals of a Fitted by parameters of its effects."""
    values = values_of(model.robot, numbers)

    def column(i):
        at, step = values.copy(), numbers[i].step
        step = -step if at[i] + step > numbers[i].upper else step
        at[i] += step
        found = likelihood.change(model, at_values(model.robot, numbers, at), model.x) / step
        return found if np.isfinite(found).all() else np.zeros_like(found)  # runs away
    return likelihood.each(column, range(len(numbers))).reshape(len(numbers), len(model.whitened))


class FreePriors(NamedTuple):
    """The priors of all C numbers that are free, and where a model is in them."""

    pull: np.ndarray     # (C,) inverse variance, 0 where zero is not the likeliest value
    sd: np.ndarray       # (C,)
    free: np.ndarray     # (C,) bool, False for nuisance parameters that an effect replaces
    values: np.ndarray   # (C,) nuisance parameters, then numbers of effects


def prior_of(likelihood, model, numbers=None) -> FreePriors:
    """Return the FreePriors of a Fitted."""
    numbers = numbers_of(likelihood, model.robot) if numbers is None else numbers
    sd = np.concatenate([likelihood.sd, [one.sd for one in numbers]])
    centred = np.concatenate([np.ones(len(model.x)), [float(one.centred) for one in numbers]])
    return FreePriors(centred / sd ** 2, sd, np.concatenate(
        [~likelihood.resting(model.robot), np.ones(len(numbers), dtype=bool)]),
        np.concatenate([model.x, values_of(model.robot, numbers)]))


def steps_without(likelihood, model, jacobian, numbers, parts, plausible) -> Iterator:
    """
    Yield by which step (C,) a model moves as each of the ``parts``, bool (R,), is left out.

    The step of `foreseen` by all other residuals, beyond that by all: where a fit ended, there is
    none that lessens the cost, even if derivatives of what is not linear promise one.
    """
    found = normal_equations(likelihood, model, jacobian, numbers, parts)
    low, high = limits(model, numbers, prior_of(likelihood, model, numbers),
                       plausible * likelihood.sd)

    def step_of(used):
        return _step(likelihood, model, numbers, *map(sum, zip(*used, strict=True)), plausible)[0]
    whole = step_of(found)
    for k in range(len(parts)):
        yield np.clip(step_of(found[:k] + found[k + 1:]) - whole, low, high)


def normal_equations(likelihood, model, jacobian, numbers, parts) -> list[tuple]:
    """
    Return the downhill slope of half the cost (C,), priors left aside, and products (C, C).

    Those of derivatives and of noise in them, of each part of the residuals.
    """
    weight, noise = likelihood.weights(model.sums.groups), likelihood.encoder_noise
    shown, noise = noise.known(jacobian), noise.jacobian(model.robot, numbers)
    spread = 0.5 * weight * model.sums.cleared[likelihood.groups.group]
    lost, left, found = likelihood.noise_cleared(model, weight), weight * model.whitened, []
    for part in parts:
        one, two = shown[:, part], noise[:, part]
        found.append((two @ lost[part] - one @ left[part],
                      (one * weight[part]) @ one.T, (two * spread[part]) @ two.T))
    return found


def foreseen(likelihood, model, jacobian, own, numbers, plausible) -> tuple:
    """
    Return the step (C,) to where a model is likeliest, and by how much the cost falls at most.

    To first order, within ``plausible``; ``jacobian`` hardly changes, its last are ``own``.
    """
    weight, noise = 1.0 / likelihood.noise_levels(model.sums.groups), likelihood.encoder_noise
    of_rows, grams = weight[likelihood.groups.group], likelihood.encoder_noise.grams_of(jacobian)
    of_numbers = noise.of_numbers(model.robot, numbers)
    lost, left = likelihood.noise_cleared(model, of_rows), of_rows * model.whitened
    slope = (np.concatenate([noise.grams.fixed @ lost, of_numbers @ lost])
             - np.concatenate([grams.fixed @ left, own @ left]))
    return _step(likelihood, model, numbers, slope, grams.weighted(own, weight),
                 noise.grams.weighted(of_numbers, 0.5 * weight * model.sums.cleared), plausible)


def _step(likelihood, model, numbers, slope, whole, added, plausible):
    """Return the step by a slope (C,) and products (C, C), and by how much the cost falls."""
    prior = prior_of(likelihood, model, numbers)
    downhill = slope - prior.pull * prior.values
    step = solve(_cleared(whole, added) + np.diag(prior.pull), downhill,
                 *limits(model, numbers, prior, plausible * likelihood.sd))
    return step, 2.0 * float(step @ downhill)


def _cleared(whole, added):
    """Return the products (C, C) less what encoder noise makes of them; `_LEAST_SHARE` is left."""
    size = np.sqrt(np.diag(whole))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    value, vector = np.linalg.eigh(whole * np.outer(scale, scale))
    root = np.sqrt(np.maximum(value, _LEAST_EIGENVALUE))
    back = (vector / root).T * scale
    share, at = np.linalg.eigh(back @ added @ back.T)
    most = size[:, None] * vector * root @ at
    return whole - (most * np.clip(share, 0.0, 1.0 - _LEAST_SHARE)) @ most.T


def informative(likelihood, model, jacobian) -> np.ndarray:
    """Return the Jacobian (C, R) of a model, 0 where encoder noise hides them."""
    return jacobian * likelihood.encoder_noise.informative(
        model.robot, numbers_of(likelihood, model.robot))


def limits(model, numbers, prior, farthest=np.inf) -> tuple:
    """Return how far all that is free may go, (C,) each; nuisances to ``farthest`` from zero."""
    count = len(model.x)
    reach = np.array([one.reach for one in numbers])
    farthest = np.broadcast_to(np.minimum(farthest, LARGEST), model.x.shape)
    low = np.concatenate([-farthest, [one.lower for one in numbers]]) - prior.values
    high = np.concatenate([farthest, [one.upper for one in numbers]]) - prior.values
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    low[count:] = np.maximum(low[count:], -reach)
    high[count:] = np.minimum(high[count:], reach)
    low[~prior.free] = high[~prior.free] = -prior.values[~prior.free]
    return low, high


def fit(likelihood, robot, x, jacobian, first=None, plausible=np.inf, iterations=8) -> Fitted:
    """
    Move nuisance parameters and the numbers of effects to where a model is likeliest, a Fitted.

    From ``robot`` and ``x`` (P,). ``jacobian`` (C, R) has derivatives that hardly change: by
    nuisance parameters and, if they are known, by the first numbers of these effects; others are
    taken anew each time. Effects before the ``first``, default those the user knows, are left as
    they are; nuisance parameters go ``plausible`` standard deviations of their priors, a number or
    (P,).
    """
    x = np.where(likelihood.resting(robot), 0.0, x)
    x = np.clip(x, -plausible * likelihood.sd, plausible * likelihood.sd)
    model, best = likelihood.fitted(robot, x), None
    for _ in range(_ANCHORED):
        found = _descended(likelihood, model, jacobian, first, plausible, iterations)
        if not likelihood.encoder_noise.is_foreseen(robot):
            return found
        model = likelihood.exact(found)
        if best is None or total_cost(likelihood, model) < total_cost(likelihood, best):
            best = model
        if abs(model.cost - found.cost) < _ENOUGH * _AS_FORESEEN:
            break
    return best


def fit_without(likelihood, model, robot, jacobian) -> tuple:
    """
    Return two Fitteds of a model's ``robot`` with less, and the `plausible_limit` of the second.

    Known parameters may stand for what is missing in the first, and only so far in the second.
    """
    anything, limit = fit(likelihood, robot, model.x, jacobian), plausible_limit(likelihood, model)
    if is_within(likelihood, anything, limit):
        return anything, anything, limit
    return anything, fit(likelihood, robot, model.x, jacobian, plausible=limit), limit


def total_cost(likelihood, model) -> float:
    """Return -2 log of likelihood times all priors, but for constants."""
    return model.cost + prior_cost(model, numbers_of(likelihood, model.robot))


def _descended(likelihood, model, jacobian, first, plausible, iterations):
    """Return a Fitted at the minimum of the cost, what noise adds to first order."""
    known, own = len(jacobian) - len(model.x), None
    for _ in range(iterations):
        if not np.isfinite(model.cost):
            break  # a motion that runs away gives no direction
        numbers = numbers_of(likelihood, model.robot, first)
        if own is None:
            own = effect_jacobian(likelihood, model, numbers[known:])
        step, most = foreseen(likelihood, model, jacobian, own, numbers, plausible)
        values = values_of(model.robot, numbers)
        for shrink in _SHRINK if most > _TRIFLE else _SHRINK[:1]:
            other = likelihood.fitted(
                at_values(model.robot, numbers, values + shrink * step[len(model.x):]),
                model.x + shrink * step[:len(model.x)])
            decrease = model.cost - other.cost + prior_cost(model, numbers) - prior_cost(
                other, numbers)
            if decrease > 0.0:
                break
        else:
            break
        model = other
        if decrease < _ENOUGH:
            break
        moved = np.abs(values_of(model.robot, numbers) - values)[known:]
        if np.any(moved > _NEAR * np.array([one.step for one in numbers[known:]])):
            own = None
    return model


def prior_cost(model, numbers) -> float:
    """Return -2 log prior of the sizes of a model's effects, its EffectParameters."""
    values = values_of(model.robot, numbers)
    return float(sum((value / one.sd) ** 2 for value, one in zip(values, numbers, strict=True)
                     if one.centred))


def retuned(likelihood, robot, x, plausible=np.inf, jacobian=None) -> tuple:
    """Return a Fitted re-tuned from ``x`` (P,), and its Jacobian, anew where it has moved."""
    fixed = jacobian is not None
    if not fixed:
        jacobian = likelihood.jacobian(likelihood.fitted(robot, x))
    for _ in range(_RETUNED):
        model = fit(likelihood, robot, x, jacobian, first=len(robot.effects), plausible=plausible)
        moved, x = np.abs(model.x - x) / likelihood.sd, model.x
        if fixed or moved.max() < 1.0:
            break
        jacobian = likelihood.jacobian(model)
    return model, jacobian


def with_white_noise(likelihood) -> tuple:
    """
    Return the Likelihood with the white torque noise of its recordings, and a Fitted re-tuned.

    Noise moves links that are computed from torques: without it parameters that lessen it, such
    as light links, look likely, and are kept where they are plausible.
    """
    model, _ = retuned(likelihood, likelihood.robot, np.zeros(len(likelihood.nuisances)),
                       PLAUSIBLE if likelihood.unseen else np.inf)
    return likelihood.with_noise(white_noise(likelihood, model)), model


def refitted(likelihood, robot, x, nuisances, iterations=8) -> tuple:
    """Return a Fitted, all effects fitted together, and Jacobian, ``nuisances`` (P, R) kept."""
    model = fit(likelihood, robot, x, nuisances, iterations=iterations)
    return model, extended(likelihood, model, nuisances)


def extended(likelihood, model, jacobian, first=None) -> np.ndarray:
    """Return a Jacobian (C, R), then that by the numbers of effects from the ``first`` on."""
    numbers = numbers_of(likelihood, model.robot, first)
    return np.concatenate([jacobian, effect_jacobian(likelihood, model, numbers)])


def without(robot, *dropped) -> RobotParams:
    """Return a robot without some of its effects (indices)."""
    return replace(robot, effects=tuple(
        spec for i, spec in enumerate(robot.effects) if i not in dropped))


def jacobian_without(likelihood, model, jacobian, *dropped) -> np.ndarray:
    """Return the Jacobian of a model without numbers of some of its effects (indices)."""
    numbers = numbers_of(likelihood, model.robot)
    own = [len(model.x) + k for k, one in enumerate(numbers) if one.effect in dropped]
    return np.delete(jacobian, own, axis=0)
