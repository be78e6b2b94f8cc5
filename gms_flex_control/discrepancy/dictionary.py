# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What each effect of the catalogue would gain, beside a model.

All guesses are put along the measured motion once, at small sizes. What a hypothesis gains is
then linear algebra.
"""

from collections import Counter
from typing import NamedTuple

from gms_flex_control.data.signals import standing_out
from gms_flex_control.discrepancy.fitting import (
    informative,
    limits,
    numbers_of,
    prior_of,
    solve,
    values_of,
)
from gms_flex_control.discrepancy.likelihood import with_effect
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.effects.base import Change, Stage, Term
from gms_flex_control.effects.guess import HIGHEST_ORDER
from gms_flex_control.effects.registry import find, names
from gms_flex_control.params.robot import EffectSpec, WHOLE_ARM
import numpy as np

_AT_BOUND = 0.99      # of what is plausible of a nuisance parameter: it can give no more
_NEW = 1e-6           # of the squares of a guess's columns: nothing else makes so much of them
_EXACT = 8            # effects of joints whose gain is found within bounds, either way
_WEIGHINGS = 3        # times that noise levels are taken anew
_MOST_TRIED = 40      # guesses, to find so many: some have a ladder of sizes
_RATIO_STEP = 0.1     # of a relative change that an effect is


class Ranked(NamedTuple):
    """A hypothesis and what it gains."""

    gain: float      # decrease of the cost, all else re-tuned
    spec: EffectSpec


def fine_orders(likelihood, model):
    """Return the orders of waves over the motor angle finer than any guess, tuple per joint."""
    constants = likelihood.constants(model.robot, model.x)
    left = [unexplained(motion, constants) for motion in likelihood.motions]
    n, found = model.robot.n_joints, []
    for j in range(n):
        at = j if model.robot.arm.rigid[j] else n + j
        found.append(tuple(standing_out(
            [one.states[:, 3, j] for one in likelihood.motions], [rows[:, at] for rows in left],
            [one.states[:, 4, j] for one in likelihood.motions], HIGHEST_ORDER)))
    return found


def guesses_of(likelihood, excluded=(), fine=None, only=None):
    """
    Return what is looked for.

    Parameters
    ----------
    likelihood : Likelihood
        The recordings and the robot.
    excluded : collection of str
        Effects that are left out.
    fine : sequence of tuple of float, optional
        Orders of waves finer than those guessed that are looked for as well, per joint.
    only : collection of (str, str), optional
        Effects of joints that are looked for; default all.

    Returns
    -------
    list of (str, str, Guess)
        Effect, joint and Guess; effects of the whole arm where links carry each other.

    """
    robot, found = likelihood.robot, []
    commanded = all(motion.commanded for motion in likelihood.motions)
    for name in sorted(set(names()).difference(excluded)):
        kind = find(name)
        if (kind.needs_commands and not commanded
                or kind.needs_chain and robot.arm.kind == 'decoupled'):
            continue
        for at, joint in enumerate([WHOLE_ARM] if kind.whole_arm else robot.joints):
            if (only is not None and (name, joint) not in only
                    or joint in likelihood.unseen and kind.needs_link_encoder):
                continue
            if kind.whole_arm and kind.needs_link_encoder and (
                    likelihood.unseen or robot.n_joints == 1):
                continue
            scales = likelihood.scales_of(joint)._replace(fine_orders=fine[at] if fine else ())
            bounds = kind.search_bounds(at, robot)
            found += [(name, joint, allowed(guess, *bounds)) for guess in kind.guesses(scales)]
    return found


def allowed(guess, lower, upper):
    """Return a Guess whose values keep within the bounds of an effect's parameters."""
    size = guess.probes[0][0]
    if guess.is_linear and size > 0.0:  # its coefficient has bounds, too
        guess = guess._replace(lowest=max(guess.lowest, lower[0] / size),
                               highest=min(guess.highest, upper[0] / size))

    def within(c):
        wanted = guess.values(c)[0]
        return min(upper[0] / wanted, 1.0) if wanted > 0.0 else 1.0
    return guess._replace(values=lambda c: tuple(np.clip(guess.values(c), lower, upper).tolist()),
                          within=within)


def may_join(spec, robot, known):
    """
    Return whether an effect may be added to a robot: not twice, and none that undoes another.

    The torque constant together with the stiffness would scale a whole joint, which no motion
    tells from other torque: the trivial solution would minimise the cost. The first effects,
    ``known`` many, have a size that nothing moves, so they undo none.
    """
    if any((one.name, one.joint) == (spec.name, spec.joint) for one in robot.effects):
        return False
    rigid = spec.joint in robot.joints and robot.arm.rigid[robot.joints.index(spec.joint)]
    there = {one.name for one in robot.effects[known:] if one.joint == spec.joint}
    return not there & set(find(spec.name).excludes(bool(rigid)))


class Dictionary:
    """
    The rows of all guesses.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    model : Fitted
        Where the rows are taken.
    excluded : collection of str
        Effects that are left out.
    only : collection of (str, str), optional
        Effects of joints that are looked for; default all.

    """

    def __init__(self, likelihood, model, excluded=(), only=None):
        self._likelihood = likelihood
        self.guesses = guesses_of(likelihood, excluded, fine_orders(likelihood, model), only)
        jobs = [(name, joint, values) for name, joint, guess in self.guesses
                for values in guess.probes]

        def column(job):
            spec = EffectSpec(name=job[0], joint=job[1], values=job[2])
            return likelihood.rows(with_effect(model.robot, spec), model.x) - model.rows
        self.columns = np.reshape(likelihood.each(column, jobs), (len(jobs), len(model.rows)))
        self._noise, self._unknown = self._noise_of(jobs)
        self._places = np.cumsum([0, *(len(guess.probes) for _, _, guess in self.guesses)])

    def _noise_of(self, jobs):
        """Return how noise shows in each column (K, R), and where that is not known (K,)."""
        likelihood = self._likelihood
        ways = Counter((name, joint) for name, joint, _ in self.guesses)
        linear = [(name, joint, guess.probes[0]) for name, joint, guess in self.guesses
                  if guess.is_linear and ways[name, joint] == 1]

        def learn(one):
            name, joint, values = one
            kind, sets = find(name), [(0, values)]
            if issubclass(kind, Change):  # its further ratios, one by one
                sets += [(k, tuple(_RATIO_STEP * (np.arange(len(values)) == k)))
                         for k in range(1, len(values)) if kind.parameters[k].unit == '1']
            likelihood.learn_noise(EffectSpec(name=name, joint=joint, values=values), sets)
        list(likelihood.pool.map(learn, linear))
        added = np.zeros_like(self.columns)
        for column, row, (name, joint, values) in zip(self.columns, added, jobs, strict=True):
            spec, values = EffectSpec(name=name, joint=joint, values=values), np.asarray(values)
            shown = likelihood.informative_of(spec)
            column *= shown[np.argmax(values != 0.0)]
            row += values @ (likelihood.noise_rows(spec) * shown)
        learned = {one[:2] for one in linear}
        return added, ~np.array([(name, joint) in learned or _is_of_torque(name)
                                 for name, joint, _ in jobs], dtype=bool)

    def gains(self, model, columns, plausible=np.inf, even=False):
        """
        Return what guesses gain beside a model, bounds left aside (G,), and noise (K,).

        Noise levels are those of the model, or ``even``: an effect that explains all of a group
        whose level is high for want of it gains little by the former.
        """
        likelihood = self._likelihood
        numbers = numbers_of(likelihood, model.robot)
        precision, centred, free = prior_of(likelihood, model.robot, numbers)
        values = np.concatenate([model.x, values_of(model.robot, numbers)])
        free[:len(model.x)] &= np.abs(model.x) < _AT_BOUND * plausible * likelihood.sd
        weight = likelihood.weights(likelihood.count if even else model.sums.groups)
        root, pull = np.sqrt(weight), np.sqrt(precision * centred)
        columns = informative(likelihood, model, columns)
        # priors are rows of their own
        own = np.concatenate([columns * root, np.diag(pull)], axis=1)[free]
        rows = np.concatenate([model.rows * root, pull * values])
        basis, triangle = np.linalg.qr(own.T)
        scaled = self.columns * root
        along = scaled @ basis[:len(root)]
        left = (rows - basis @ (basis.T @ rows))[:len(root)]
        own_noise = likelihood.noise_slopes(model, weight, numbers)
        shared = along @ np.linalg.lstsq(triangle.T, own_noise[free], rcond=1e-10)[0]
        # where it was not learned, noise adds what it adds to all that makes the column: a
        # friction that varies with place is friction
        noise = np.where(self._unknown, shared, self._noise @ (
            0.5 * weight * model.sums.cleared[likelihood.group]
            * likelihood.noise_along(model.robot, model.x)))
        right = -(scaled @ left) + noise - shared
        gains = np.zeros(len(self.guesses))
        for i, (first, last) in enumerate(zip(self._places[:-1], self._places[1:], strict=True)):
            whole, mine = scaled[first:last] @ scaled[first:last].T, along[first:last]
            gram = whole - mine @ mine.T
            if np.trace(gram) > _NEW * np.trace(whole):
                gains[i] = right[first:last] @ np.linalg.lstsq(gram, right[first:last],
                                                               rcond=1e-10)[0]
        return np.where(np.isfinite(gains), gains, 0.0), noise

    def ranked(self, model, columns, plausible=np.inf):
        """
        Return the hypotheses with the largest gains, each effect of a joint once.

        Parameters
        ----------
        model : Fitted
            What is there already.
        columns : ndarray, shape (C, R)
            Derivatives by its nuisance parameters and by the numbers of its effects.
        plausible : float
            Standard deviations of their priors that nuisance parameters may go.

        Returns
        -------
        list of Ranked
            Best first.

        """
        likelihood, best = self._likelihood, {}
        known, tried = len(likelihood.robot.effects), set()
        normal = _Normal(likelihood, model, columns, plausible)
        for even in (False, True):
            gains, noise = self.gains(model, columns, plausible, even)
            found = set()
            for i in np.argsort(-gains)[:_MOST_TRIED]:
                name, joint, guess = self.guesses[i]
                if len(found) == _EXACT or gains[i] <= 0.0:
                    break
                if i in tried or not may_join(EffectSpec(name=name, joint=joint, values=()),
                                              model.robot, known):
                    continue
                found.add((name, joint))
                tried.add(i)
                part = slice(self._places[i], self._places[i + 1])
                gain, coefficients = normal.with_guess(self.columns[part], noise[part], guess)
                share = guess.within(coefficients)
                gain *= share * (2.0 - share)
                if gain > best.get((name, joint), Ranked(0.0, None)).gain:
                    values = tuple(float(v) for v in guess.values(coefficients))
                    best[name, joint] = Ranked(gain, EffectSpec(name=name, joint=joint,
                                                                values=values))
        return sorted(best.values(), key=lambda one: -one.gain)

    def largest(self, model, columns):
        """Return what each hypothesis gains, bounds left aside, dict by effect and joint."""
        found = {}
        for (name, joint, _), gain in zip(self.guesses, self.gains(model, columns)[0],
                                          strict=True):
            found[name, joint] = max(found.get((name, joint), 0.0), float(gain))
        return found


class _Normal:
    """The normal equations of a model, group by group, to be extended by one guess."""

    def __init__(self, likelihood, model, columns, plausible):
        self._likelihood, self._model = likelihood, model
        self._columns = informative(likelihood, model, columns)[:, likelihood.by_group]
        self._rows = model.rows[likelihood.by_group]
        numbers = numbers_of(likelihood, model.robot)
        precision, centred, free = prior_of(likelihood, model.robot, numbers)
        self._values = np.concatenate([model.x, values_of(model.robot, numbers)])
        self._pull = precision * centred
        self._gram = self._products(self._columns, self._columns)
        self._slope = -self._products(self._columns, self._rows[None])[:, :, 0]
        self._noise = likelihood.noise_slopes(
            model, likelihood.weights(model.sums.groups), numbers)
        self._limits = limits(model, numbers, self._values, free, plausible * likelihood.sd)
        self._before = self._least(self._gram, self._slope, self._noise, *self._limits)[0]

    def _products(self, one, other):
        """Return products of rows of each group (G, A, B), of (A, R) and (B, R) in its order."""
        ends = self._likelihood.ends
        products = [one[:, a:b] @ other[:, a:b].T for a, b in zip(ends[:-1], ends[1:],
                                                                  strict=True)]
        return np.reshape(products, (len(products), len(one), len(other)))

    def _least(self, gram, slope, noise, low, high):
        """Return the least cost to first order, noise levels at their likeliest, and the step."""
        likelihood, k = self._likelihood, len(self._values)
        pull = np.concatenate([self._pull, np.zeros(slope.shape[1] - k)])
        values = np.concatenate([self._values, np.zeros(slope.shape[1] - k)])
        sums = self._model.sums.groups
        for _ in range(_WEIGHINGS):
            weight = 1.0 / likelihood.noise_levels(sums)
            step = solve(np.tensordot(weight, gram, 1) + np.diag(pull),
                         weight @ slope + noise - pull * values, low, high)
            sums = (self._model.sums.groups - 2.0 * slope @ step
                    + np.einsum('i,gij,j->g', step, gram, step))
        return (likelihood.misfit(sums) - 2.0 * float(noise @ step)
                + float(np.sum(pull * (values + step) ** 2))), step

    def with_guess(self, added, noise, guess):
        """Return the gain of a guess with columns ``added``, and its coefficients."""
        k, count = len(self._values), len(added)
        added = added[:, self._likelihood.by_group]
        gram = np.zeros((len(self._gram), k + count, k + count))
        gram[:, :k, :k] = self._gram
        gram[:, k:, k:] = self._products(added, added)
        gram[:, k:, :k] = self._products(added, self._columns)
        gram[:, :k, k:] = gram[:, k:, :k].swapaxes(1, 2)
        slope = np.concatenate([self._slope, -self._products(added, self._rows[None])[:, :, 0]],
                               axis=1)
        low, high = self._limits
        cost, step = self._least(gram, slope, np.concatenate([self._noise, noise]),
                                 np.concatenate([low, np.full(count, guess.lowest)]),
                                 np.concatenate([high, np.full(count, guess.highest)]))
        return (self._before - cost if np.any(step[k:]) else 0.0), step[k:]


def _is_of_torque(name):
    """Return whether an effect changes the torque that was asked for, which has no noise."""
    kind = find(name)
    return issubclass(kind, Term) and kind.stage == Stage.ACTUATOR
