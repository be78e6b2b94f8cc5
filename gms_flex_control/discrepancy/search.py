# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The search for what is missing: one effect after the other, all re-tuned together each time.

The library tells which effects would gain most; only those are fitted in full.
"""

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

from gms_flex_control.discrepancy.compatible import LATE, may_join
from gms_flex_control.discrepancy.fit import effect_columns, fit, Fitted, FIXED, numbers_of
from gms_flex_control.discrepancy.guesses import is_at_limit
from gms_flex_control.discrepancy.library import least_cost, Library
from gms_flex_control.discrepancy.prediction import prediction_cost
from gms_flex_control.discrepancy.problem import with_effect
from gms_flex_control.effects.registry import find
import numpy as np

MOST = 20
_BY_MOTORS = 6        # at most where links are not seen: with more, none is sure
LEAST_GAIN = 60.0     # sum of squares of rows; see docs/discrepancy.md
SURE_GAIN = 150.0     # likewise, however much else is left
LEAST_SHARE = 0.01    # of what is still unexplained
LEAST_PART = 1e-4     # of all that was missing at first
_OF_LITTLE = 0.1      # of what is left: a gain below SURE_GAIN must be as much
_OF_ALL = 1e-3        # of all that was missing at first, likewise
_SHORTLIST = 3        # hypotheses that are fitted in full
_CLOSE = 0.5          # of the best gain
_SIMPLER = 0.03       # of a gain: so much less is as good, with fewer numbers
_EQUAL = 0.001        # of a gain: so much less is no difference
_BETTER = 0.01        # likewise: so much more is better, with more numbers
_ROUNDS = 3           # of adding and exchanging
_FEW = 3              # effects: one is looked for in the place of two
_NEARLY = 0.95        # of what others explain: what one in their place does at a first guess
_PATIENT = 8          # iterations: one begins far from where it does what two did
_LIKELY = 2           # ones that are fitted in full
_TELLS = 20.0         # twice the logarithm of a ratio of likelihoods, of two comparisons together


class Found(NamedTuple):
    """What the search ended with."""

    before: Fitted     # known parameters re-tuned, nothing added
    model: Fitted      # with the effects found
    columns: np.ndarray  # derivatives of its rows
    first: tuple       # of Ranked: the best of the first scan, within bounds
    scan: dict         # (effect, joint) to gain: all of it, bounds left aside
    library: Library


def search(problem, *, most=MOST, without=(), begin=None, say=lambda text: None):
    """
    Add effects until nothing is gained.

    Parameters
    ----------
    problem : Problem
        The rows.
    most : int
        How many effects may be added.
    without : collection of str
        Effects that are left out.
    begin : Fitted, optional
        With effects to begin with.
    say : callable, optional
        Told what is being done.

    Returns
    -------
    Found

    """
    before, knobs = retuned(problem, problem.robot, np.zeros(len(problem.knobs)))
    say('every effect along the motion')
    hunt = _Hunt(problem, before, knobs, Library(problem, before, knobs, without), say)
    most = min(most, _BY_MOTORS) if problem.unseen else most
    if begin:
        hunt.take(begin)
    for _ in range(_ROUNDS):
        while hunt.grow(most):
            pass
        if not hunt.exchange():
            break
    hunt.merge()
    hunt.settle()
    hunt.tell_late()
    return Found(before, hunt.model, hunt.columns, hunt.first, hunt.scan, hunt.library)


class _Hunt:
    """The model as it grows."""

    def __init__(self, problem, model, knobs, library, say):
        self._problem, self.model, self._knobs, self.library = problem, model, knobs, library
        self._known, self._say = len(model.robot.effects), say
        self._gain = SURE_GAIN * problem.caution
        self.columns, self._begun = knobs, model.cost
        self.first = tuple(library.ranked(model, knobs))
        self.scan = library.most(model, knobs)

    def grow(self, most):
        """Add effects while one is worth it; return whether any was."""
        grown = False
        while len(self.model.robot.effects) - self._known < most:
            ranked = self.library.ranked(self.model, self.columns)
            ranked = [one for one in ranked if may_join(one.spec, self.model.robot, self._known)
                      and self.library.beyond_chance(one) >= self._least(one.spec)]
            if not ranked:
                break
            added = self._best_added(ranked)
            if self.model.cost - added.cost < self._least(added.robot.effects[-1]):
                break
            self._append(added)
            self._say(f'{added.robot.effects[-1].name} of {added.robot.effects[-1].joint}')
            grown = True
        if grown:
            self.take(self.model)
        return grown

    def exchange(self):
        """Put others in the place of effects where that explains more; return whether any."""
        changed = False
        for one in self.model.robot.effects[self._known:]:  # an exchanged one moves to the end
            names = [(spec.name, spec.joint) for spec in self.model.robot.effects]
            changed |= self._exchanged(names.index((one.name, one.joint)))
        return changed

    def _exchanged(self, i):
        model, effects = self.model, self.model.robot.effects
        less, others = without(self._problem, model, self.columns, self._known, i)
        ranked = self.library.ranked(less, others)
        least = _NEARLY * (least_cost(self._problem, less, others) - model.cost)
        own = effects[i].name, effects[i].joint
        for one in ranked[:_SHORTLIST]:
            if ((one.spec.name, one.spec.joint) == own
                    or one.gain < max(_CLOSE * ranked[0].gain, least)
                    or not may_join(one.spec, less.robot, self._known)):
                continue
            other = fit(self._problem, with_effect(less.robot, one.spec), model.x, others,
                        first=self._known)
            larger = _size(one.spec) - _size(effects[i])
            worth = self._gain * max(larger, 0.2)
            if larger > 0:
                worth += _BETTER * (less.cost - model.cost)
            if (self._problem.exact_cost(model) - self._problem.exact_cost(other) > worth
                    and (_ends_at_limit(other) <= is_at_limit(effects[i], model.robot))):
                self._say(f'{one.spec.name} instead of {effects[i].name}')
                self.take(other)
                return True
        return False

    def merge(self):
        """Put one effect in the place of two where it explains as much, if there are few."""
        while self._known + 2 <= len(self.model.robot.effects) <= self._known + _FEW:
            added = range(self._known, len(self.model.robot.effects))
            if not any(self._merged(*pair) for pair in combinations(added, 2)):
                return

    def _merged(self, i, k):
        problem, model = self._problem, self.model
        less, columns = without(problem, model, self.columns, self._known, i, k)
        least = _NEARLY * (least_cost(problem, less, columns) - model.cost)
        for one in self.library.ranked(less, columns)[:_LIKELY]:
            if one.gain < least or not may_join(one.spec, less.robot, self._known):
                continue
            other = fit(problem, with_effect(less.robot, one.spec), model.x, columns,
                        first=self._known, iterations=_PATIENT)
            if (problem.exact_cost(other) < problem.exact_cost(model) + self._gain
                    and not _ends_at_limit(other)):
                self._say(f'{one.spec.name} instead of two')
                self.take(other)
                return True
        return False

    def settle(self):
        """Fit all once more by derivatives of the model found: those of the first are stale."""
        model = self.model
        if len(model.robot.effects) > self._known:
            self._knobs = self._problem.knob_columns(model.robot, model.x, model.rows)
            self.take(model)

    def tell_late(self):
        """
        Put a lag in the place of a delay, or the other way, where it predicts better.

        Both beside all else as it was fitted with the one, and as with the other: errors of
        prediction are torques, which a smaller inertia makes smaller.
        """
        for i in range(self._known, len(self.model.robot.effects)):
            robot = self.model.robot
            spec, others = robot.effects[i], robot.effects[:i] + robot.effects[i + 1:]
            if spec.name not in LATE:
                continue
            name, = LATE - {spec.name}
            late = replace(spec, name=name, values=(
                min(spec.values[0], find(name).parameters[0].upper),))
            if not may_join(late, replace(robot, effects=others), self._known):
                continue
            other = fit(self._problem, _with_instead(robot, i, late), self.model.x, self._knobs,
                        first=self._known)
            costs = prediction_cost(self._problem, [
                (_with_instead(model.robot, i, one), model.x)
                for one in (spec, other.robot.effects[i]) for model in (self.model, other)],
                spec.joint)
            own, instead = costs.reshape(2, 2).sum(axis=1)
            if instead < own - _TELLS:
                self._say(f'{name} instead of {spec.name}')
                self.take(other)

    def _least(self, spec):
        """Return what an effect must gain to be added."""
        left = self.model.cost - self._problem.clean_cost
        begun = self._begun - self._problem.clean_cost
        gain = np.clip(max(_OF_LITTLE * left, _OF_ALL * begun), LEAST_GAIN, SURE_GAIN)
        if self._problem.unseen or find(spec.name).of_feedback:
            gain = self._gain
        return max(gain, LEAST_SHARE * left, LEAST_PART * begun)

    def _best_added(self, ranked):
        """
        Return the best of few hypotheses fitted in full, the simplest of those alike.

        Of those that differ by nothing, the one that asks least of what is known.
        """
        model = self.model
        close = [one for one in ranked[:_SHORTLIST] if one.gain > _CLOSE * ranked[0].gain]
        fits = [self._added(one) for one in close]
        fits = [one for one in fits if not _ends_at_limit(one)] or fits
        fits = self._with_a_future(fits)
        best = model.cost - min(one.cost for one in fits)
        alike = [one for one in fits if model.cost - one.cost >= best - _SIMPLER * abs(best)]
        fewest = min(_size(one.robot.effects[-1]) for one in alike)
        alike = [one for one in alike if _size(one.robot.effects[-1]) == fewest]
        least = min(one.cost for one in alike) + _EQUAL * abs(best)
        return min((one for one in alike if one.cost <= least),
                   key=lambda one: np.sum(self._problem.burden_of(one.rows) ** 2))

    def _with_a_future(self, fits):
        """
        Return those beside which one more effect would leave least, if two explain nearly all.

        Of two effects that are missing, another may explain a little of each.
        """
        clean, begun = self._problem.clean_cost, len(self.model.robot.effects) > self._known
        little = clean + _OF_LITTLE * (self.model.cost - clean)
        if begun or len(fits) < 2 or min(one.cost for one in fits) < little:
            return fits
        left = np.array([one.cost - self._next_gain(one) for one in fits])
        if left.min() > little:
            return fits
        most = left.min() + _SIMPLER * (self.model.cost - left.min())
        return [one for one, cost in zip(fits, left, strict=True) if cost <= most]

    def _next_gain(self, model):
        """Return what the best effect beside the last one of a model would gain."""
        columns = _extended(self._problem, model, self.columns, len(model.robot.effects) - 1)
        return max((one.gain for one in self.library.ranked(model, columns)
                    if may_join(one.spec, model.robot, self._known)), default=0.0)

    def _added(self, one):
        """Return the model with a hypothesis fitted, all derivatives anew if it disappoints."""
        model, problem = self.model, self._problem
        robot = with_effect(model.robot, one.spec)
        fitted = fit(problem, robot, model.x, self.columns, first=self._known)
        if model.cost - fitted.cost > _CLOSE * one.gain:
            return fitted
        return fit(problem, fitted.robot, fitted.x, self._knobs, first=self._known)

    def _append(self, fitted):
        """Go on with one more effect, derivatives by all else as they were."""
        last = len(fitted.robot.effects) - 1
        self.model, self.columns = fitted, _extended(self._problem, fitted, self.columns, last)

    def take(self, fitted):
        """Go on with a model, its effects fitted together."""
        self.model, self.columns = refitted(self._problem, fitted.robot, fitted.x, self._knobs,
                                            self._known, iterations=2)


def _with_instead(robot, i, spec):
    """Return a robot with another in the place of its i-th effect."""
    return replace(robot, effects=(*robot.effects[:i], spec, *robot.effects[i + 1:]))


def _ends_at_limit(model):
    """Return whether the last effect of a model has no value, see `is_at_limit`."""
    return is_at_limit(model.robot.effects[-1], model.robot)


def retuned(problem, robot, x):
    """Return a robot with its knobs re-tuned from ``x`` (P,), and the knobs' columns (P, R)."""
    x, rows, knobs = problem.retuned(robot, x)
    return Fitted(robot, x, rows, problem.cost(rows, robot, x)), knobs


def refitted(problem, robot, x, knobs, known, iterations=3):
    """
    Return a robot with all its effects fitted together, and its columns anew.

    Parameters
    ----------
    problem : Problem
        The rows.
    robot : RobotParams
        Where to begin.
    x : ndarray, shape (P,)
        Knobs to begin with.
    knobs : ndarray, shape (P, R)
        Derivatives by the knobs.
    known : int
        Effects the user knew of, which stay.
    iterations : int
        At most.

    Returns
    -------
    model : Fitted
    columns : ndarray, shape (C, R)
        Derivatives by the knobs and by the parameters of effects that are not known.

    """
    model = fit(problem, robot, x, knobs, first=known, iterations=iterations)
    return model, _extended(problem, model, knobs, known)


def _extended(problem, model, columns, first):
    """Return columns (C, R), then those by the parameters of effects from the ``first`` on."""
    own = effect_columns(problem, model.robot, model.x, model.rows,
                         numbers_of(model.robot, first))
    return np.concatenate([columns, own])


def without(problem, model, columns, known, *dropped):
    """
    Return a model less some of its effects, nothing re-tuned, and the columns of all else.

    Parameters
    ----------
    problem : Problem
        The rows.
    model : Fitted
        With the effects.
    columns : ndarray, shape (C, R)
        Derivatives by its knobs and by the parameters of its effects.
    known : int
        Effects the user knew of, which have no columns.
    *dropped : int
        Which effects.

    """
    effects = model.robot.effects
    robot = replace(model.robot, effects=tuple(
        spec for i, spec in enumerate(effects) if i not in dropped))
    own = [len(model.x) + k for k, number in enumerate(numbers_of(model.robot, known))
           if number.effect in dropped]
    return Fitted.of(problem, robot, model.x), np.delete(columns, own, axis=0)


def _size(spec):
    """Return how many numbers of an effect are free."""
    return sum(parameter.name not in FIXED for parameter in find(spec.name).parameters)
