# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The search for what is missing: one effect after the other, all re-tuned together each time.

All effects of the catalogue are put along the measured motion once, at small sizes: their rows
are the library. What a hypothesis gains is then linear algebra; only the best are fitted in full.
"""

from typing import NamedTuple

from gms_flex_control.discrepancy.bounded import solve
from gms_flex_control.discrepancy.fit import effect_columns, fit, Fitted, numbers_of
from gms_flex_control.discrepancy.guesses import all_guesses
from gms_flex_control.discrepancy.problem import with_effect
from gms_flex_control.params.robot import EffectSpec
import numpy as np

MOST = 20
LEAST_GAIN = 100.0    # sum of squares of rows; see docs/discrepancy.md
LEAST_SHARE = 0.03    # of what is still unexplained
_SHORTLIST = 3        # hypotheses that are fitted in full
_CLOSE = 0.5          # of the best gain
_EXACT = 25           # hypotheses whose gain is found within bounds


class Ranked(NamedTuple):
    """A hypothesis and what it gains."""

    gain: float
    spec: EffectSpec


class Library:
    """
    The rows of all guesses.

    Parameters
    ----------
    problem : Problem
        The rows.
    model : Fitted
        Where they are taken.
    without : collection of str
        Effects that are left out.

    """

    def __init__(self, problem, model, without=()):
        self._problem = problem
        self.guesses = all_guesses(problem, without)
        jobs = [(name, joint, values) for name, joint, guess in self.guesses
                for values in guess.probes]

        def column(job):
            spec = EffectSpec(name=job[0], joint=job[1], values=job[2])
            return (problem.rows(with_effect(model.robot, spec), model.x)
                    - model.rows)[problem.fitted]
        self.columns = problem.each(column, jobs)
        self._places = np.cumsum([0, *(len(guess.probes) for _, _, guess in self.guesses)])

    def ranked(self, model, columns):
        """
        Return the hypotheses with the largest gains, each effect of a joint once.

        Parameters
        ----------
        model : Fitted
            What is there already.
        columns : ndarray, shape (C, R)
            Derivatives by its knobs and by the parameters of its effects.

        Returns
        -------
        list of Ranked
            Best first.

        """
        problem, knobs = self._problem, len(model.x)
        own, rows = columns[:, problem.fitted], model.rows[problem.fitted]
        slope = problem.slope(columns, model.rows)
        low = np.concatenate([-problem.bound - model.x, np.full(len(own) - knobs, -np.inf)])
        high = np.concatenate([problem.bound - model.x, np.full(len(own) - knobs, np.inf)])
        best = {}
        for i in self._promising(own, rows)[:_EXACT]:
            name, joint, guess = self.guesses[i]
            gain, coefficients = self._gain(i, own, rows, low, high, slope)
            if gain > best.get((name, joint), Ranked(0.0, None)).gain:
                values = tuple(float(v) for v in guess.values(coefficients))
                best[name, joint] = Ranked(gain, EffectSpec(name=name, joint=joint,
                                                            values=values))
        return sorted(best.values(), key=lambda one: -one.gain)

    def _promising(self, own, rows):
        """Return guesses by their gain without bounds, the best first."""
        basis, _ = np.linalg.qr(own.T)
        return np.argsort(-self.shares(rows - basis @ (basis.T @ rows), basis))

    def shares(self, rows, basis):
        """
        Return the share of rows (F,) that each guess explains beside a basis (F, B).

        The rows lie beside the basis already; bounds are not kept.
        """
        beside = self.columns - (self.columns @ basis) @ basis.T
        whole, right = np.sum(self.columns ** 2, axis=1), beside @ rows
        shares = np.zeros(len(self.guesses))
        for i, (begin, end) in enumerate(zip(self._places[:-1], self._places[1:], strict=True)):
            gram = beside[begin:end] @ beside[begin:end].T
            if np.trace(gram) > 1e-6 * whole[begin:end].sum():
                shares[i] = right[begin:end] @ np.linalg.lstsq(gram, right[begin:end],
                                                               rcond=1e-10)[0]
        return shares / (rows @ rows)

    def _gain(self, i, own, rows, low, high, slope):
        """Return the gain of a guess within all bounds, and its coefficients."""
        guess = self.guesses[i][2]
        added = self.columns[self._places[i]:self._places[i + 1]]
        both = np.concatenate([own, added])
        gram, right = both @ both.T, np.concatenate([slope, -added @ rows])
        k, count = len(own), len(added)
        before = solve(gram[:k, :k], right[:k], low, high)
        after = solve(gram, right, np.concatenate([low, np.full(count, guess.lowest)]),
                      np.concatenate([high, np.full(count, guess.highest)]))
        gain = 2.0 * (_value(gram[:k, :k], right[:k], before) - _value(gram, right, after))
        return (gain if np.any(after[k:]) else 0.0), after[k:]


def _value(gram, right, x):
    return float(0.5 * x @ gram @ x - right @ x)


class Found(NamedTuple):
    """What the search ended with."""

    before: Fitted     # known parameters re-tuned, nothing added
    model: Fitted      # with the effects found
    columns: np.ndarray  # derivatives of its rows
    first: tuple       # of Ranked: the first scan
    library: Library


def search(problem, *, most=MOST, without=(), say=lambda text: None):
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
    say : callable, optional
        Told what is being done.

    Returns
    -------
    Found

    """
    x, rows, knobs = problem.retuned(problem.robot, np.zeros(len(problem.knobs)))
    before = model = Fitted(problem.robot, x, rows, problem.cost(rows, x))
    say('every effect along the motion')
    library = Library(problem, model, without)
    columns, first = knobs, ()
    known = len(model.robot.effects)
    clean = problem.level * problem.fitted.sum()
    while len(model.robot.effects) - known < most:
        ranked = library.ranked(model, columns)
        first = first or tuple(ranked)
        there = {(spec.name, spec.joint) for spec in model.robot.effects}
        ranked = [one for one in ranked if (one.spec.name, one.spec.joint) not in there]
        least = max(LEAST_GAIN, LEAST_SHARE * (model.cost - clean))
        if not ranked or ranked[0].gain < least:
            break
        added = _best_added(problem, model, ranked, columns[:len(x)])
        if model.cost - added.cost < least:
            break
        say(f'{added.robot.effects[-1].name} of {added.robot.effects[-1].joint}')
        model = fit(problem, added.robot, added.x, columns[:len(x)], first=known, iterations=2)
        columns = np.concatenate([columns[:len(x)], effect_columns(
            problem, model.robot, model.x, model.rows,
            numbers_of(model.robot.effects, known))])
    return Found(before, model, columns, first, library)


def _best_added(problem, model, ranked, knob_columns):
    """Return the best of few hypotheses, each fitted in full."""
    close = [one for one in ranked[:_SHORTLIST] if one.gain > _CLOSE * ranked[0].gain]
    first = len(model.robot.effects)
    fits = [fit(problem, with_effect(model.robot, one.spec), model.x, knob_columns, first=first)
            for one in close]
    return min(fits, key=lambda one: one.cost)
