# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What each effect of the catalogue would gain, beside a model.

All guesses are put along the measured motion once, at small sizes: their rows are the library.
What a hypothesis gains is then linear algebra.
"""

from collections import Counter
from typing import NamedTuple

from gms_flex_control.discrepancy.bounded import solve
from gms_flex_control.discrepancy.fine_waves import fine_orders
from gms_flex_control.discrepancy.fit import numbers_of
from gms_flex_control.discrepancy.guesses import all_guesses
from gms_flex_control.discrepancy.problem import with_effect
from gms_flex_control.effects.base import Stage, Term
from gms_flex_control.effects.catalogue.torque_ripple import HIGHEST_GUESSED
from gms_flex_control.effects.registry import find
from gms_flex_control.params.robot import EffectSpec
import numpy as np

_OF_CHANCE = 4.0      # times what a hypothesis gains where nothing is missing
_AT_BOUND = 0.99      # of a knob's doubt: it can give no more
_ALL_NOISE = 0.5      # of the squares of a column: noise tells more than it
_NEW = 1e-6           # of the squares of a guess's columns: nothing else makes so much of them
_EXACT = 12           # effects of joints whose gain is found within bounds
_MOST_TRIED = 60      # guesses, to find so many: some have a ladder of sizes


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
    knobs : ndarray, shape (P, R)
        Derivatives by what is known only nearly.
    without : collection of str
        Effects that are left out.

    """

    def __init__(self, problem, model, knobs, without=()):
        self._problem = problem
        self.guesses = all_guesses(problem, without,
                                   fine_orders(problem, model, HIGHEST_GUESSED))
        jobs = [(name, joint, values) for name, joint, guess in self.guesses
                for values in guess.probes]

        def column(job):
            spec = EffectSpec(name=job[0], joint=job[1], values=job[2])
            return (problem.rows(with_effect(model.robot, spec), model.x)
                    - model.rows)[problem.fitted]
        self.columns = np.reshape(problem.each(column, jobs),
                                  (len(jobs), int(problem.fitted.sum())))
        self._noise = self._noise_of(jobs)
        self._places = np.cumsum([0, *(len(guess.probes) for _, _, guess in self.guesses)])
        self._alike = self._by_size()
        self._by_chance = self._gained_by_chance(knobs)

    def _by_size(self):
        """Return guesses (M,), columns (M, K) and their products (M, K, K), for each size K."""
        sizes, alike = np.diff(self._places), []
        for size in np.unique(sizes):
            guesses = np.flatnonzero(sizes == size)
            columns = self._places[guesses][:, None] + np.arange(size)
            alike.append((guesses, columns, _products(self.columns[columns])))
        return alike

    def _noise_of(self, jobs):
        """Return what noise adds to the slope of each column, NaN where nothing tells."""
        problem, noise = self._problem, self._problem.noise
        ways = Counter((name, joint) for name, joint, _ in self.guesses)
        specs = [EffectSpec(name=name, joint=joint, values=guess.probes[0])
                 for name, joint, guess in self.guesses
                 if guess.is_linear and ways[name, joint] == 1]
        problem.each(noise.learn, specs)
        added = np.array([noise.slopes_of(EffectSpec(name=name, joint=joint, values=values))
                          @ values for name, joint, values in jobs])
        hidden = np.abs(added) > _ALL_NOISE * np.sum(self.columns ** 2, axis=1)
        for name, joint in {jobs[i][:2] for i in np.flatnonzero(hidden)}:
            noise.forget(name, joint)
        learned = {(spec.name, spec.joint) for spec in specs}
        told = np.array([(name, joint) in learned or _is_of_torque(name)
                         for name, joint, _ in jobs], dtype=bool)
        return np.where(told & ~hidden, added, np.nan)

    def _gained_by_chance(self, knobs):
        """Return what hypotheses gain in runs in which nothing is missing, the mean of each."""
        problem = self._problem
        own = knobs[:, problem.fitted]
        basis, _ = np.linalg.qr(own.T)
        gains = self._gains(problem.clean[:, problem.fitted], basis, self.columns @ basis,
                            0.0).mean(axis=0)
        by_chance = {}
        for (name, joint, _), gain in zip(self.guesses, gains, strict=True):
            by_chance[name, joint] = max(gain, by_chance.get((name, joint), 0.0))
        return by_chance

    def beyond_chance(self, one):
        """Return what a Ranked gains beyond what it may gain where nothing is missing."""
        return one.gain - _OF_CHANCE * self._by_chance[one.spec.name, one.spec.joint]

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
        problem = self._problem
        own, rows = columns[:, problem.fitted], model.rows[problem.fitted]
        numbers = numbers_of(model.robot, len(problem.robot.effects))
        slope = problem.slope(columns, model.rows, model.robot, numbers)
        low, high = limits(problem, model, len(own))
        gram, best = own @ own.T, {}
        before = half_cost(gram, slope, solve(gram, slope, low, high))
        gains, noise = self._scan(model, own)
        for i in np.argsort(-gains)[:_MOST_TRIED]:
            name, joint, guess = self.guesses[i]
            known = best.get((name, joint), Ranked(0.0, None)).gain
            if len(best) == _EXACT:
                break
            if known >= gains[i]:  # bounds take from it
                continue
            value, coefficients = self._with(i, own, rows, gram, low, high, slope, noise)
            share = guess.within(coefficients)
            gain = 2.0 * (before - value) * share * (2.0 - share)
            if gain > known:
                values = tuple(float(v) for v in guess.values(coefficients))
                best[name, joint] = Ranked(gain, EffectSpec(name=name, joint=joint,
                                                            values=values))
        return sorted(best.values(), key=lambda one: -one.gain)

    def most(self, model, columns):
        """Return what each hypothesis gains, bounds left aside, dict by effect and joint."""
        gains, _ = self._scan(model, columns[:, self._problem.fitted])
        found = {}
        for (name, joint, _), gain in zip(self.guesses, gains, strict=True):
            found[name, joint] = max(found.get((name, joint), 0.0), float(gain))
        return found

    def _scan(self, model, own):
        """Return what guesses gain where nothing is bounded (G,), and noise's slopes (K,)."""
        problem, knobs = self._problem, len(model.x)
        free = np.ones(len(own), dtype=bool)
        free[:knobs] = np.abs(model.x) < _AT_BOUND * problem.bound_of(model.robot)
        basis, root = np.linalg.qr(own[free].T)
        along = self.columns @ basis
        numbers = numbers_of(model.robot, len(problem.robot.effects))
        shared = along @ np.linalg.lstsq(
            root.T, problem.noise.slopes(model.robot, numbers)[free], rcond=1e-10)[0]
        # where it was not learned, noise adds what it adds to all that makes the column: a
        # friction that varies with place is friction
        noise = np.where(np.isnan(self._noise), shared, self._noise)
        return self._gains(model.rows[problem.fitted], basis, along, noise - shared), noise

    def _gains(self, rows, basis, along, noise):
        """
        Return what guesses gain where nothing is bounded (..., G), of rows (..., R).

        Beside what is free already, with a ``basis`` (R, B) and the columns ``along`` (K, B) it;
        ``noise`` (K,) is what noise adds to their slopes beyond that.
        """
        left = rows - (rows @ basis) @ basis.T
        right = left @ self.columns.T - noise
        gains = np.zeros((*rows.shape[:-1], len(self.guesses)))
        for guesses, columns, whole in self._alike:
            gram, mine = whole - _products(along[columns]), right[..., columns]
            new = (np.trace(gram, axis1=1, axis2=2) > _NEW * np.trace(whole, axis1=1, axis2=2))
            gains[..., guesses] = new * np.einsum(
                '...mk,mkl,...ml->...m', mine, np.linalg.pinv(gram, rcond=1e-10), mine)
        return gains

    def _with(self, i, own, rows, gram, low, high, slope, noise):
        """Return half the cost with a guess, all within bounds, and its coefficients."""
        guess = self.guesses[i][2]
        added = self.columns[self._places[i]:self._places[i + 1]]
        k, count = len(own), len(added)
        both = np.empty((k + count, k + count))
        both[:k, :k], both[k:, k:] = gram, added @ added.T
        both[:k, k:] = own @ added.T
        both[k:, :k] = both[:k, k:].T
        right = np.concatenate([slope, noise[self._places[i]:self._places[i + 1]]
                                - added @ rows])
        x = solve(both, right, np.concatenate([low, np.full(count, guess.lowest)]),
                  np.concatenate([high, np.full(count, guess.highest)]))
        return (half_cost(both, right, x) if np.any(x[k:]) else np.inf), x[k:]


def _is_of_torque(name):
    """Return whether an effect changes the torque that was asked for, which has no noise."""
    kind = find(name)
    return issubclass(kind, Term) and kind.stage == Stage.ACTUATOR


def _products(columns):
    """Return the inner products (M, K, K) of K columns (M, K, R) each."""
    return columns @ columns.swapaxes(1, 2)


def limits(problem, model, count):
    """Return how far a model's knobs may go, with ``count`` columns in all; (count,) each."""
    bound, free = problem.bound_of(model.robot), np.full(count - len(model.x), np.inf)
    return (np.concatenate([-bound - model.x, -free]), np.concatenate([bound - model.x, free]))


def half_cost(gram, slope, x):
    """Return half the cost at a step ``x`` (P,), from half the cost before."""
    return float(0.5 * x @ gram @ x - slope @ x)


def least_cost(problem, model, columns):
    """Return the least cost of a model with all its columns (C, R) re-tuned within bounds."""
    used = columns[:, problem.fitted]
    numbers = numbers_of(model.robot, len(problem.robot.effects))
    gram, slope = used @ used.T, problem.slope(columns, model.rows, model.robot, numbers)
    step = solve(gram, slope, *limits(problem, model, len(columns)))
    return model.cost + 2.0 * half_cost(gram, slope, step)
