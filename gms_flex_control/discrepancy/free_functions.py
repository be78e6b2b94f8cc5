# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Torques that are a free function of one variable: hypotheses without a name.

Where one of them explains what is missing much better than an effect of the catalogue does, the
effect only resembles what is there.
"""

from typing import NamedTuple

from gms_flex_control.discrepancy.fitting import informative, numbers_of, prior_of, values_of
from gms_flex_control.discrepancy.likelihood import BLOCK
from gms_flex_control.discrepancy.signature import of_others, variables
from gms_flex_control.discrepancy.thresholds import EVIDENCE, PRACTICAL
from gms_flex_control.discrepancy.validation import folds, gain_over, of_blocks
import numpy as np

_KNOTS = 20           # of a function, even in the samples
_OF_TIME = 12         # likewise, of time, at most
# not of torque: a function of it may shrink the whole equation
_VARIABLES = ('time', 'link angle', 'link rate', 'torsion')
_DIRECTED = ('time', 'link angle')  # multiplied by the direction of motion, too
_LEAST = 3.0 * PRACTICAL  # of Coulomb friction: a function that is free fits some noise
_TRIED = 4            # functions of most evidence, of which one may be real
_WEIGHINGS = 3        # times that noise levels are taken anew


class Free(NamedTuple):
    """A function of one variable in one equation, and what it would gain."""

    evidence: float    # 2 log, over the model it was added to
    gain: float        # decrease of the cost
    torque: float      # rms of what it adds [N m]
    joint: str
    equation: str      # 'link' or 'motor'
    variable: str


class _Function(NamedTuple):
    """The rows of one free function."""

    joint: str
    equation: str
    variable: str
    rows: np.ndarray     # (K, R) of its triangles
    square: np.ndarray   # (K, K) mean products of the triangles


class FreeFunctions:
    """
    The rows of all free functions.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.

    """

    def __init__(self, likelihood):
        self._likelihood = likelihood
        robot, jobs = likelihood.robot, []
        for j, joint in enumerate(robot.joints):
            shapes = _shapes(likelihood, j)
            for side, equation in enumerate(('link', 'motor')):
                if equation == 'motor' and (robot.arm.rigid[j] or joint in likelihood.unseen):
                    continue
                jobs += [(joint, equation, name, hats, j + side * robot.n_joints)
                         for name, hats in shapes.items()]
        self._all = list(likelihood.pool.map(lambda job: _function(likelihood, *job), jobs))

    def ranked(self, model, columns, joint=None):
        """
        Return the free functions beside a model, list of Free, that of most evidence first.

        Parameters
        ----------
        model : Fitted
            What is there.
        columns : ndarray, shape (C, R)
            Derivatives of its rows.
        joint : str, optional
            Only functions of this joint.

        """
        columns = informative(self._likelihood, model, columns)
        here = [one for one in self._all if joint in (None, 'arm', one.joint)]
        before = self._cost(model, columns, np.zeros((0, columns.shape[1])))[0]
        found = self._likelihood.pool.map(
            lambda one: self._gained(model, columns, one, before), here)
        return sorted(found, key=lambda one: -one.evidence)

    def _cost(self, model, columns, rows):
        """Return the least cost of a model with a function, its weights and those of rows."""
        likelihood = self._likelihood
        step, sums = self._fitted(model, columns, rows)
        weight, mine = likelihood.weights(sums), step[:len(columns)]
        return (likelihood.misfit(sums) + self._prior(model, mine)
                - 2.0 * float(self._noise(model, weight) @ mine)), step[len(columns):], weight

    def _gained(self, model, columns, one, before):
        """Return a function as a Free, of a model with a cost ``before``."""
        likelihood, rows = self._likelihood, one.rows
        cost, own, weight = self._cost(model, columns, rows)
        size = np.full(len(rows), 1.0 / likelihood.level_of(one.joint) ** 2)
        scaled = rows / np.sqrt(size)[:, None]
        _, occam = np.linalg.slogdet(np.eye(len(rows)) + (scaled * weight) @ scaled.T)
        gain = float(before - cost - np.sum(own ** 2 * size))
        return Free(gain - occam - 2.0 * np.log(len(self._all)), gain,
                    float(np.sqrt(max(own @ one.square @ own, 0.0))), *one[:3])

    def _prior(self, model, step):
        """Return -2 log prior of a model after a step of its own parameters."""
        numbers = numbers_of(self._likelihood, model.robot)
        precision, centred, _ = prior_of(self._likelihood, model.robot, numbers)
        values = np.concatenate([model.x, values_of(model.robot, numbers)]) + step
        return float(np.sum(precision * centred * values ** 2))

    def _fitted(self, model, columns, rows, kept=True):
        """Return the step of all parameters and weights of a function, and the sums (G,)."""
        likelihood = self._likelihood
        numbers = numbers_of(likelihood, model.robot)
        precision, centred, free = prior_of(likelihood, model.robot, numbers)
        values = np.concatenate([model.x, values_of(model.robot, numbers), np.zeros(len(rows))])
        size = np.full(len(rows), 1.0 / likelihood.coulomb.max() ** 2)
        pull = np.concatenate([precision * centred, size])
        free = np.concatenate([free, np.ones(len(rows), dtype=bool)])
        every = np.concatenate([columns, rows])[free]
        step, sums = np.zeros(len(values)), model.sums.groups
        for _ in range(_WEIGHINGS):
            weight = likelihood.weights(sums) * kept
            slope = -every @ (weight * model.rows) - (pull * values)[free]
            slope[:free[:len(columns)].sum()] += self._noise(model, weight)[free[:len(columns)]]
            step[free] = np.linalg.lstsq((every * weight) @ every.T + np.diag(pull[free]), slope,
                                         rcond=1e-12)[0]
            sums = self._sums(model, columns, rows, step)
        return step, sums

    def _noise(self, model, weight):
        """Return the slopes (C,) that encoder noise makes, which are no merit of a function."""
        return self._likelihood.noise_slopes(model, weight, numbers_of(
            self._likelihood, model.robot))

    def _sums(self, model, columns, rows, step):
        """Return the sums of a model after a step, what noise adds as it is (G,)."""
        likelihood = self._likelihood
        moved = model.rows + step[:len(columns)] @ columns + step[len(columns):] @ rows
        noise = np.bincount(likelihood.group, model.rows ** 2, len(likelihood.count)) \
            - model.sums.groups
        return np.bincount(likelihood.group, moved ** 2, len(likelihood.count)) - noise

    def left_in(self, model, columns, caution=1.0):
        """Return the free function that a model lacks, a Free, None where nothing matters."""
        without, shown = None, informative(self._likelihood, model, columns)
        for free in self.ranked(model, columns)[:_TRIED]:
            if (free.evidence <= EVIDENCE
                    or free.torque <= _LEAST * self._likelihood.level_of(free.joint)):
                continue
            rows = next(one.rows for one in self._all
                        if one[:3] == (free.joint, free.equation, free.variable))
            if without is None:
                without = self._predicted(model, shown, rows[:0])
            gain = gain_over(self._predicted(model, shown, rows) - without)
            if gain._replace(sigmas=gain.sigmas / caution).is_real:
                return free
        return None

    def _predicted(self, model, columns, rows):
        """Return the log likelihood of blocks left out (B,), with a function of rows (K, R)."""
        likelihood, out = self._likelihood, np.zeros(self._likelihood.blocks)
        for left_out in folds(likelihood):
            step, sums = self._fitted(model, columns, rows, ~left_out)
            moved = model.rows + step[:len(columns)] @ columns + step[len(columns):] @ rows
            out += of_blocks(likelihood, left_out, moved, likelihood.weights(sums))
        return out


def _shapes(likelihood, j):
    """Return triangles over variables of joint ``j``, dict of list of ndarray (S, K)."""
    motions, found = likelihood.motions, {}
    own = [variables(motion, j) for motion in motions]
    others = [of_others(motion, j) for motion in motions]
    longest = max(motion.time[-1] - motion.time[0] for motion in motions)
    moving = [_direction(one['link rate']) for one in own]
    for name in (*_VARIABLES, *(name for name in others[0] if name.startswith('link angle'))):
        if name == 'torsion' and likelihood.robot.arm.rigid[j]:
            continue
        values = [one[name] for one in (own if name in _VARIABLES else others)]
        # a block of time that is left out must not hold a knot alone
        knots = int(np.clip(longest / (2.0 * BLOCK), 3, _OF_TIME)) if name == 'time' else _KNOTS
        at = np.unique(np.quantile(np.concatenate(values), np.linspace(0.0, 1.0, knots)))
        found[name] = [np.stack([np.interp(one, at, unit) for unit in np.eye(len(at))], axis=1)
                       for one in values]
        if name in _DIRECTED:
            found[f'{name} times the direction of motion'] = [
                hats * way[:, None] for hats, way in zip(found[name], moving, strict=True)]
    return found


def _function(likelihood, joint, equation, name, hats, column):
    """Return a _Function of triangles (S, K) in a column of the residuals."""
    rows = []
    for k in range(hats[0].shape[1]):
        torques = [np.zeros((len(own), 2 * likelihood.robot.n_joints)) for own in hats]
        for torque, own in zip(torques, hats, strict=True):
            torque[:, column] = own[:, k]
        rows.append(likelihood.rows_of_torque(torques))
    every = np.concatenate(hats)
    return _Function(joint, equation, name, np.array(rows), every.T @ every / len(every))


def _direction(rate):
    """Return the direction of motion (S,), smoothly through rest."""
    return np.tanh(rate / max(0.05 * float(np.sqrt(np.mean(rate ** 2))), 1e-12))
