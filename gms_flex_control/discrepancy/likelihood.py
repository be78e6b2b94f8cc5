# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How likely recordings are under a model of their robot.

Whitened residuals are normal where nothing is missing. They fall into groups: one recording, one
equation, one octave, links at rest or in motion. The noise level of a group is not known, only
that it is not below that of null simulations; the most likely one is taken. So what drives and
loads add, white or coloured, counts as noise, and a rest at which friction is anything up to
break-away does not count as much as motion does.
"""

from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
import os
from typing import NamedTuple

from gms_flex_control.discrepancy.motion import encoder_step
from gms_flex_control.discrepancy.nuisance import (
    nuisances_of,
    of_recordings,
    OF_SHAPE,
    OfRecording,
    PRIOR,
    tuned,
)
from gms_flex_control.discrepancy.null_simulation import null_simulation
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.thresholds import LARGEST_NOISE, PRACTICAL_FLOOR
from gms_flex_control.discrepancy.whitening import Whitening
from gms_flex_control.effects.guess import Scales
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import SimulationError
from gms_flex_control.simulation import plant
import numpy as np

BLOCK = 2.0            # of time, left out as a whole: longer than friction remembers [s]
_HIGHEST = (LARGEST_NOISE / PRACTICAL_FLOOR) ** 2  # variance of noise over null simulations
_NULL_RUNS = 9         # simulations in which nothing is missing
_MEASURED_BY = 6       # of these: by which residuals are whitened
_STEP = 0.01           # relative change of a nuisance parameter, for its derivative
_MEDIAN = 0.4549       # of the square of a standard normal number
_ALL_NOISE = 0.3       # of the squares of a derivative: noise shows more than the model does
_LEAST_SCALE, _MOST_SCALE = 0.1, 2.0  # of the torque that was commanded: drives give no more
_FEWEST = 40           # rows of a group that tell a noise level
_FAST_OCTAVES = 2      # highest ones: above 5 Hz
_DRAWS = 4             # of unit noise
_WILD = 4.0            # times the squared torque that the recording lacks: driven wild
_LOW = 4.0             # standard deviations of chi square: sums below are no merit of a model
_MOST_ADDED = 3.0      # times what encoders add to the null simulations: as of twice the inertia
_OCTAVES_OF_NOISE = 3  # highest ones, in which the quietest tells the white part of noise


class Sums(NamedTuple):
    """Sums of squares by group, cleared of what encoder noise adds, and their cost."""

    groups: np.ndarray  # (G,)
    cost: float         # -2 log likelihood and -2 log prior, but for constants
    cleared: np.ndarray  # (G,) whether what noise adds has been subtracted, bool


@dataclass(frozen=True, eq=False)
class Fitted:
    """
    A model and how likely it is.

    Parameters
    ----------
    robot : RobotParams
        With effects.
    x : ndarray, shape (P,)
        Nuisance parameters.
    rows : ndarray, shape (R,)
        Whitened residuals.
    sums : Sums
        Of the rows.

    """

    robot: object
    x: np.ndarray
    rows: np.ndarray
    sums: Sums

    @property
    def cost(self):
        """Return -2 log of likelihood times prior, but for constants."""
        return self.sums.cost


class Likelihood:
    """
    The likelihood of models along recordings, and its derivatives.

    Parameters
    ----------
    motions : sequence of Motion
        The recordings.
    robot : RobotParams
        As believed, effects that are known included.
    seed : int
        Of the null simulations.
    widened : float
        How many times as far off as usual known parameters may be.
    held_out : bool
        Whether models are fitted to other recordings: what is particular about these ones is
        not known.

    """

    def __init__(self, motions, robot, seed=0, widened=1.0, held_out=False):
        self.motions, self.robot, self._seed = tuple(motions), robot, seed
        self.held_out = held_out
        prior = {kind: widened * sd for kind, sd in PRIOR.items()}
        stated = {(kind, robot.joints.index(joint) if joint in robot.joints else -1):
                  widened * sd for (kind, joint), sd in robot.uncertainty.items()}
        self.nuisances = nuisances_of(plant.constants_of(robot), prior, stated) + (
            () if held_out else of_recordings(self.motions, robot))
        self.sd = np.array([one.sd for one in self.nuisances])
        self.of_recording = np.array([isinstance(one, OfRecording) for one in self.nuisances],
                                     dtype=bool)
        self._shapes = np.array([one.name in OF_SHAPE for one in self.nuisances], dtype=bool)
        friction = robot.friction
        self.coulomb = 0.5 * (friction.forward.coulomb + friction.backward.coulomb)
        self.pool = ThreadPoolExecutor(os.cpu_count() or 1)
        self.noise = np.zeros((len(self.motions), 2 * robot.n_joints))
        self._scales = scales_of(self.motions, robot)
        self._supply = self._scales[0].supply
        self._simulate(robot, np.zeros(len(self.nuisances)))

    # --- noise -------------------------------------------------------------------------------

    def _simulate(self, robot, x):
        """Make the null simulations of a model and take the measure of residuals from them."""
        constants = self.constants(robot, x)
        runs = [[null_simulation(motion, constants, np.random.default_rng([self._seed, k]))
                 for motion in self.motions] for k in range(_NULL_RUNS)]
        self._clean = list(self.pool.map(
            lambda run: [unexplained(motion, constants) for motion in run], runs))
        self._pair, self._null = runs[:2], (robot, x)
        if not self.held_out:  # at each nuisance parameter a little off, and as simulated
            self._null_residuals = list(self.pool.map(
                lambda step: [self.residuals(run, robot, x + step) for run in self._pair],
                (*(_STEP * np.eye(len(x))), np.zeros(len(x)))))
        self._whiten()

    def simulated_as(self, model):
        """Return the Likelihood whose null simulations are those of a Fitted."""
        other = copy(self)
        other._simulate(model.robot, model.x)
        return other

    def with_noise(self, noise):
        """Return the Likelihood with white torque noise (M, 2 n) in its null simulations."""
        other = copy(self)
        other.noise = noise
        other._whiten()
        return other

    def _whiten(self):
        """Whiten by the null simulations, with the torque noise in them."""
        floor = PRACTICAL_FLOOR * np.tile(self.coulomb, 2)
        runs = [[residual + self.torque_noise(m, np.random.default_rng([self._seed, 7, k, m]))
                 for m, residual in enumerate(run)] for k, run in enumerate(self._clean)]
        self.whitenings = [
            Whitening(np.stack(clean[_NULL_RUNS - _MEASURED_BY:]), motion.period, floor,
                      _known(motion))
            for motion, clean in zip(self.motions, zip(*runs, strict=True), strict=True)]
        self._group()
        clean = np.stack([self._rows_of(run) for run in runs])
        # what filters leave at every reversal, say, though nothing is missing: so they do of the
        # recording, whose rows scatter by that of this mean as well
        self.usual, count = clean.mean(axis=0), len(clean)
        self.clean = (clean - self.usual) * np.sqrt((count + 1) / (count - 1))
        self._by_effect = {}  # (effect, joint): as `_shown`, (parameters, R) each
        if self.held_out:
            return
        self._null_rows = [self._rows_of(run) for run in self._null_residuals[-1]]
        self._own = self._null_rows[0] - self._null_rows[1]
        self._by_nuisance, self._informative = np.moveaxis(self.each(
            lambda i: self._shown([self._rows_of(run) for run in self._null_residuals[i]], _STEP),
            range(len(self.nuisances))), 1, 0)

    def _shown(self, rows, step):
        """
        Return what a ``step`` of a parameter makes of two null simulations, (2, R).

        How noise shows in the derivative, and 1 where the derivative tells something: not in
        groups in which it is mostly noise.
        """
        noise = rows[0] - rows[1] - self._own
        hidden = (self._by_group(noise ** 2)
                  > 2.0 * _ALL_NOISE * self._by_group((rows[0] - self._null_rows[0]) ** 2))
        return noise / step, ~hidden[self.group]

    def torque_noise(self, m, rng):
        """Return the residual torque (S, 2 n) that white torque noise makes in a recording."""
        motion, n = self.motions[m], self.robot.n_joints
        drawn = rng.standard_normal((len(motion.fine_time), 2 * n)) * self.noise[m]
        return np.concatenate([motion.through_filter(drawn[:, :n]),
                               motion.through_filter(drawn[:, n:])], axis=1)

    def _group(self):
        """Set which rows count, their groups, and their blocks of time."""
        used, groups, blocks, channels, parts, first_group, first_block = [], [], [], [], [], 0, 0
        self.block_at, self.at_rest = [], []  # of the moments of each whitening
        n = self.robot.n_joints
        for motion, whitening in zip(self.motions, self.whitenings, strict=True):
            shape = whitening.scale.shape
            at = np.minimum((whitening.row_time / motion.period).astype(int),
                            len(motion.standing) - 1)
            still = np.tile(motion.standing[at], 2)
            channel = np.broadcast_to(np.arange(2 * n), shape)
            group = (whitening.part[:, None] * 2 * n + channel) * 2 + still
            groups.append((first_group + group).ravel())
            first_group += 2 * int(group.max() // 2 + 1)
            count = max(round(whitening.time[-1] / BLOCK), 2)
            block = np.minimum((whitening.row_time * count / whitening.time[-1]).astype(int),
                               count - 1)
            blocks.append(np.repeat(first_block + block, shape[1]))
            first_block += count
            self.block_at.append(first_block - count + np.minimum(
                (whitening.time * count / whitening.time[-1]).astype(int), count - 1))
            self.at_rest.append(motion.standing[np.minimum(
                (whitening.time / motion.period).astype(int), len(motion.standing) - 1)])
            used.append(whitening.scale.ravel() > 0.0)
            channels.append(channel.ravel())
            parts.append(np.repeat(whitening.part, shape[1]))
        self._used = np.flatnonzero(np.concatenate(used))
        group = np.concatenate(groups)[self._used]
        count = np.bincount(group)
        group[count[group] < _FEWEST] &= ~1  # rests that are too few join motion
        _, self.group = np.unique(group, return_inverse=True)
        self.block, self.blocks = np.concatenate(blocks)[self._used], first_block
        self.channel = np.concatenate(channels)[self._used]
        self.part = np.concatenate(parts)[self._used]  # the octave, the highest first
        self.recording = np.repeat(np.arange(len(used)), [len(one) for one in used])[self._used]
        self.count = np.bincount(self.group).astype(float)
        self._least = np.maximum(self.count - _LOW * np.sqrt(2.0 * self.count), 0.0)
        self.by_group = np.argsort(self.group, kind='stable')  # rows, group after group
        self.ends = np.concatenate([[0], np.cumsum(self.count)]).astype(int)

    def white_noise(self, model):
        """
        Return the white torque noise of each equation beyond that of the null simulations.

        The quietest of the high octaves tells it: what is missing shows in some, noise in all. It
        is not more than drives make.

        Parameters
        ----------
        model : Fitted
            Nuisance parameters re-tuned.

        Returns
        -------
        ndarray, shape (M, 2 n)
            Standard deviation per sample of the recording [N m].

        """
        out, squares, first = np.zeros_like(self.noise), model.rows ** 2, 0
        for m, whitening in enumerate(self.whitenings):
            size = whitening.scale.size
            mine = (self._used >= first) & (self._used < first + size)
            place = self._used[mine] - first
            part = whitening.part[place // whitening.scale.shape[1]]
            first += size
            unit = copy(self)
            unit.noise = np.ones_like(self.noise)
            response = np.mean([whitening.rows_of(unit.torque_noise(
                m, np.random.default_rng([self._seed, 8, k, m]))).ravel()[place] ** 2
                for k in range(_DRAWS)], axis=0)
            for c in range(out.shape[1]):
                excess = []
                for octave in range(_OCTAVES_OF_NOISE):
                    here = (self.channel[mine] == c) & (part == octave)
                    if here.any():  # by medians: what is missing acts in some moments
                        size = np.maximum(response[here], 1e-300)
                        clean = np.mean(self.clean[:, mine][:, here] ** 2, axis=0)
                        excess.append(np.median((squares[mine][here] - _MEDIAN * clean) / size)
                                      / _MEDIAN * (1.0 + 1.0 / np.sqrt(here.sum())))
                if excess:
                    out[m, c] = np.sqrt(max(min(excess) + self.noise[m, c] ** 2, 0.0))
        most = LARGEST_NOISE * np.tile(self.coulomb, 2) / np.maximum(self.noise_response(), 1e-300)
        return np.minimum(out, most)

    # --- what encoder noise adds to the sums, which a lighter arm would make smaller -----------

    def _along_nulls(self, robot, x):
        """Return the rows of a model along two null simulations of one motion, not one noise."""
        return [self._rows_of(self.residuals(run, robot, x)) for run in self._pair]

    def learn_noise(self, spec, linear):
        """
        Learn how encoder noise shows in the rows of an effect.

        Parameters
        ----------
        spec : EffectSpec
            At a small size.
        linear : sequence of (int, tuple)
            Parameters in which it is linear, and values at which only that one is not zero.

        """
        robot, x = self._null
        shown = np.zeros((len(spec.values), 2, len(self._own)))
        shown[:, 1] = 1.0
        for k, values in linear:
            changed = replace(robot, effects=(*robot.effects, replace(spec, values=values)))
            shown[k] = self._shown(self._along_nulls(changed, x), values[k])
        self._by_effect[spec.name, spec.joint] = shown[:, 0], shown[:, 1]

    def noise_rows(self, spec):
        """Return how encoder noise shows in the rows by each parameter of an effect, or 0."""
        return self._by_effect.get((spec.name, spec.joint), np.zeros((1, len(spec.values), 1)))[0]

    def informative_of(self, spec):
        """Return 1 in rows that show each parameter of an effect, 0 in those of mostly noise."""
        return self._by_effect.get((spec.name, spec.joint), np.ones((2, len(spec.values), 1)))[1]

    def informative(self, robot, numbers):
        """Return `informative_of` of nuisance parameters and numbers (C, R)."""
        of_numbers = [np.broadcast_to(
            self.informative_of(robot.effects[one.effect])[one.parameter], self.group.shape)
            for one in numbers]
        return np.concatenate([
            self._informative, np.reshape(of_numbers, (len(numbers), len(self.group)))])

    def noise_along(self, robot, x):
        """Return how rows of two null simulations would differ for a model (R,)."""
        (null_robot, null_x), known = self._null, len(self.robot.effects)
        rows = self._own + (x - null_x) @ self._by_nuisance
        for sign, effects in ((1.0, robot.effects[known:]), (-1.0, null_robot.effects[known:])):
            for spec in effects:
                rows = rows + sign * np.asarray(spec.values) @ self.noise_rows(spec)
        return rows

    def _by_group(self, values):
        return np.bincount(self.group, values, minlength=len(self.count))

    # --- likelihood --------------------------------------------------------------------------

    def sums(self, rows, robot, x, exact=False):
        """
        Return the Sums of a model.

        ``exact``: what noise adds is simulated, not extrapolated from the null.
        """
        noise = (np.subtract(*self._along_nulls(robot, x)) if exact
                 else self.noise_along(robot, x))
        added = 0.5 * self._by_group(noise ** 2 - self._own ** 2)
        most = 0.5 * _MOST_ADDED * self._by_group(self._own ** 2)
        whole = self._by_group(rows ** 2)
        least = np.minimum(whole, self._least)  # clearing is no merit below what chance does
        groups = np.maximum(whole - np.minimum(added, most), least)
        return Sums(groups, self.misfit(groups) + float(np.sum((x / self.sd) ** 2)),
                    (groups > least) & (added < most))

    def misfit(self, sums):
        """Return -2 log likelihood of sums (..., G) at the likeliest noise levels."""
        level = self.noise_levels(sums)
        return np.sum(self.count * np.log(level) + np.asarray(sums) / level, axis=-1)

    def noise_levels(self, sums):
        """Return the likeliest variances of the groups: null simulations' to drives' at worst."""
        return np.clip(np.asarray(sums) / self.count, 1.0, _HIGHEST)

    def weights(self, sums):
        """Return the weights of the rows (R,) at the likeliest noise levels of sums (G,)."""
        return (1.0 / self.noise_levels(sums))[self.group]

    def slopes(self, columns, model, weight, numbers=()):
        """Return the downhill slopes of half the cost by nuisances and numbers (C,)."""
        return (self.noise_columns(model.robot, numbers) @ self._noise_cleared(model, weight)
                - self.known_noise(columns) @ (weight * model.rows))

    def known_noise(self, columns):
        """
        Return columns (C, R), 0 in rows of mostly noise that is known to first order only.

        That is where residuals are not linear in a nuisance parameter.
        """
        known = columns.copy()
        known[:len(self._shapes)][self._shapes] *= self._informative[self._shapes]
        return known

    def noise_slopes(self, model, weight, numbers=()):
        """Return what encoder noise adds to `slopes` (C,) in rows that are informative."""
        return (self.noise_columns(model.robot, numbers) * self.informative(
            model.robot, numbers)) @ self._noise_cleared(model, weight)

    def _noise_cleared(self, model, weight):
        """Return the noise (R,) that sums are cleared of, so weighted."""
        return 0.5 * weight * model.sums.cleared[self.group] * self.noise_along(
            model.robot, model.x)

    def noise_columns(self, robot, numbers):
        """Return how encoder noise shows in derivatives by nuisances and numbers (C, R)."""
        by_number = [np.broadcast_to(self.noise_rows(robot.effects[one.effect])[one.parameter],
                                     self.group.shape) for one in numbers]
        return self.known_noise(np.concatenate(
            [self._by_nuisance, np.reshape(by_number, (len(numbers), len(self.group)))]))

    def constants(self, robot, x):
        """Return the kernels' record of a robot with its nuisance parameters at ``x``."""
        mine = x[:len(self.nuisances)]  # recordings held out have none of their own
        return tuned(_record_of(robot), self.nuisances, mine)

    def recorded(self, motions, x):
        """Return motions cleared of what nuisance parameters (P,) make particular about each."""
        motions = list(motions)
        for one, value in zip(self.nuisances, x, strict=False):
            if value != 0.0 and isinstance(one, OfRecording):
                motions[one.recording] = one.recorded(motions[one.recording], value)
        return motions

    def _rows_of(self, residuals):
        """Return the rows (R,) that count of residuals (S, 2 n) of each recording."""
        return np.concatenate([whitening.rows_of(residual).ravel() for whitening, residual in
                               zip(self.whitenings, residuals, strict=True)])[self._used]

    def rows(self, robot, x):
        """Return whitened residuals of a model (R,), less what every null simulation shows."""
        return self._rows_of(self.residuals(self.motions, robot, x)) - self.usual

    def residuals(self, motions, robot, x):
        """Return residual torques per unit of commanded torque, (S, 2 n) of each motion [N m]."""
        scale, acting = np.ones(2 * robot.n_joints), []
        motions = self.recorded(motions, x)
        for spec in robot.effects:
            kind = find(spec.name)
            shifted = [kind.torque_acted(motion.command, motion.fine_period, spec.values)
                       for motion in motions]
            if shifted[0] is None:
                acting.append(spec)
            else:  # exact, where the errors of angles that it is in the plant are not
                motions = [motion.with_torque(torque) for motion, torque in zip(
                    motions, shifted, strict=True)]
            factor = kind.torque_scale(spec.values, self._supply)
            if factor != 1.0:
                j = robot.joints.index(spec.joint)
                driven = not robot.arm.rigid[j] and spec.joint not in self.unseen
                scale[j + robot.n_joints * driven] *= np.clip(factor, _LEAST_SCALE, _MOST_SCALE)
        if len(acting) < len(robot.effects):
            robot = replace(robot, effects=tuple(acting))
        constants = self.constants(robot, x)
        return [unexplained(motion, constants) / scale for motion in motions]

    def rows_of_torque(self, residuals):
        """Return what torques (S, 2 n) along each recording add to the rows (R,)."""
        return self._rows_of(residuals)

    def fitted(self, robot, x, exact=False):
        """Return a model as it is, a Fitted."""
        rows = self.rows(robot, x)
        return Fitted(robot, x, rows, self.sums(rows, robot, x, exact))

    def resting(self, robot):
        """Return which nuisance parameters (P,) an effect of a model replaces, bool."""
        added = robot.effects[len(self.robot.effects):]
        replaced = {(find(spec.name).replaces, robot.joints.index(spec.joint))
                    for spec in added if find(spec.name).replaces}
        return np.array([(one.name, one.joint) in replaced for one in self.nuisances], dtype=bool)

    def each(self, function, jobs):
        """Return what a function gives of each job, in threads, stacked."""
        return np.array(list(self.pool.map(function, jobs)))

    def columns(self, robot, x, rows):
        """Return derivatives of the rows by the nuisance parameters, shape (P, R)."""
        def column(i):
            at = x.copy()
            at[i] += _STEP
            return (self.rows(robot, at) - rows) / _STEP
        return self.each(column, range(len(x))).reshape(len(x), len(rows))

    # --- torques -----------------------------------------------------------------------------

    def torque(self, model):
        """Return the residual torques of a model behind the low-pass, (S', 2 n) each [N m]."""
        return [whitening.torque_rows(residual) for residual, whitening in zip(
            self.residuals(self.motions, model.robot, model.x), self.whitenings, strict=True)]

    def excess_torque(self, model):
        """Return what a model leaves in motion beyond null simulations, rms (2 n,) [N m]."""
        left = self._in_motion([one ** 2 for one in self.torque(model)])
        return np.sqrt(np.maximum(left - self.clean_torque() ** 2, 0.0))

    def is_followed(self, model):
        """
        Return whether a null simulation of a model keeps to the recorded motion.

        One that lacks more torque than the recording does, beyond what drives make, goes its own
        way: it shows what a model does that is driven wild, not what noise does.
        """
        constants = self.constants(model.robot, model.x)
        try:
            runs = [null_simulation(motion, constants, np.random.default_rng(self._seed))
                    for motion in self.motions]
        except SimulationError:
            return False
        own = [whitening.torque_rows(unexplained(run, constants)) ** 2
               for run, whitening in zip(runs, self.whitenings, strict=True)]
        most = np.maximum(self._in_motion([one ** 2 for one in self.torque(model)]),
                          (LARGEST_NOISE * np.tile(self.coulomb, 2)) ** 2)
        return bool(np.all(self._in_motion(own) <= _WILD * most))  # not where it is not finite

    def clean_torque(self):
        """Return what null simulations leave in motion, torque noise too, rms (2 n,) [N m]."""
        return np.sqrt(self._in_motion([np.mean([whitening.torque_rows(
            run[m] + self.torque_noise(m, np.random.default_rng([self._seed, 9, k, m]))) ** 2
            for k, run in enumerate(self._clean[:2])], axis=0)
            for m, whitening in enumerate(self.whitenings)]))

    def _in_motion(self, squares):
        """Return the mean of squares (S', 2 n) of each recording while links move (2 n,)."""
        where = [np.tile(~still, 2) & whitening.settled[:, None]
                 for still, whitening in zip(self.at_rest, self.whitenings, strict=True)]
        count = sum(one.sum(axis=0) for one in where)
        return sum(np.sum(square * one, axis=0) for square, one in zip(
            squares, where, strict=True)) / np.maximum(count, 1)

    def noise_response(self):
        """Return the rms behind the low-pass of white torque noise of unit size (2 n,)."""
        unit = copy(self)
        unit.noise = np.ones_like(self.noise)
        rows = self.whitenings[0].torque_rows(
            unit.torque_noise(0, np.random.default_rng([self._seed, 8, 0])))
        return np.sqrt(np.mean(rows ** 2, axis=0))

    def octave_levels(self, model):
        """Return noise levels of slow and of fast octaves of each equation in motion, (2 n, 2)."""
        levels, out = model.sums.groups / self.count, np.zeros((2 * self.robot.n_joints, 2))
        for c in range(len(out)):
            for side, fast in enumerate((False, True)):
                groups = np.unique(self.group[(self.channel == c)
                                              & ((self.part < _FAST_OCTAVES) == fast)])
                if len(groups):
                    out[c, side] = np.average(levels[groups], weights=self.count[groups])
        return out

    def torque_rms(self, one, other):
        """Return the rms by which residual torques of two models differ, larger equation."""
        squares = [(a - b) ** 2 for a, b in zip(self.torque(one), self.torque(other),
                                                strict=True)]
        return float(np.sqrt(np.mean(np.concatenate(squares), axis=0)).max())

    def scales_of(self, joint):
        """Return the Scales of a joint, those of the first for the whole arm."""
        joints = self.robot.joints
        return self._scales[joints.index(joint) if joint in joints else 0]

    @property
    def unseen(self):
        """Return the joints whose links have no encoder, set of str."""
        return {motion.joints[link.joint] for motion in self.motions for link in motion.unseen}

    def level_of(self, joint):
        """Return Coulomb friction of a joint, the least of all for the whole arm [N m]."""
        joints = self.robot.joints
        return float(self.coulomb[joints.index(joint)] if joint in joints else self.coulomb.min())


@lru_cache(maxsize=64)
def _record_of(robot):
    """Return the kernels' record of a robot, which nobody may change."""
    return plant.constants_of(robot)


def scales_of(motions, robot):
    """Return the Scales of each joint over all recordings."""
    arm, found = robot.arm, []
    for j in range(robot.n_joints):
        link, rate, motor = (np.concatenate([one.states[:, row, j] for one in motions])
                             for row in (0, 1, 3))
        torque = np.concatenate([one.command[:, j] for one in motions])
        twist = 0.0 if arm.rigid[j] else float(np.std(motor - link))  # an offset is no usual size
        spring = float(arm.stiffness[j] * twist) if twist > 0.0 else float(np.std(torque))
        speed = max(float(np.sqrt(np.mean(rate ** 2))), 1e-6)
        found.append(Scales(
            friction=float(np.mean([side.static[j] + side.viscous[j] * speed for side in (
                robot.friction.forward, robot.friction.backward)])),
            torque=float(np.abs(torque).max()), spring=spring, twist=twist, speed=speed,
            inertia=float(arm.motor_inertia[j]),
            link_inertia=float(arm.link_inertia[j]),
            mass=float(arm.mass.sum()),
            lowest=float(link.min()), highest=float(link.max()), turned=float(np.ptp(motor)),
            duration=float(max(one.time[-1] - one.time[0] for one in motions)),
            supply=min(float(one.supply.mean()) for one in motions),
            count=max(encoder_step(one.readings[:, 0, j], one.noise[0, j]) for one in motions),
            presliding=float(np.max(robot.friction.weight[j] * robot.friction.forward.coulomb[j]
                                    / robot.friction.stiffness[j]))))
    return found


def _known(motion):
    """Return where all angles were read, bool (S, 2 n)."""
    return np.repeat(motion.known[:, None], 2 * motion.standing.shape[1], axis=1)


def with_effect(robot, spec):
    """Return a robot with one more effect."""
    return replace(robot, effects=(*robot.effects, spec))
