# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Recordings, a model of their robot, and the rows that say how far it is from them."""

from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
import os

from gms_flex_control.discrepancy.bounded import solve
from gms_flex_control.discrepancy.known import DOUBT, knobs_of, MOST_DOUBT, REPLACED, tuned
from gms_flex_control.discrepancy.noise import Noise
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.retrace import retrace
from gms_flex_control.discrepancy.whitening import Whitening
from gms_flex_control.simulation import plant
import numpy as np

REPLICATES = 6        # runs in which nothing is missing, that rows are measured by
_FRESH = 3            # further ones: of those measured by, the measure makes too little
BLOCK = 2.0           # of time that is held out or not as a whole [s]
_HELD_OUT = 4         # one block in so many
_KNOB_STEP = 0.01
_OF_DOUBT = 2.0       # standard deviations of a known parameter that its doubt is
_OF_MOTORS = 3.0      # times what an effect must explain where links are not seen


class Problem:
    """
    The rows of a model, and their derivatives by what the user knows only nearly.

    Parameters
    ----------
    paths : sequence of Path
        The recordings.
    robot : RobotParams
        As believed, effects that are known included.
    practical : float
        Torque below which nothing matters, as a share of Coulomb friction.
    seed : int
        Of the runs in which nothing is missing.
    doubt : float
        How many times as far as usual known parameters may be off.
    at_rest : bool
        Whether link equations count while a link stands. Friction then is anything up to static
        friction, which only a model whose friction is nearly right can follow.
    like : (RobotParams, ndarray of shape (P,)), optional
        Robot and knobs whose runs tell what noise is; default those believed.

    """

    def __init__(self, paths, robot, practical, seed=0, doubt=1.0, at_rest=True, like=None):
        self.paths, self.robot, self._seed, self._doubt = tuple(paths), robot, seed, doubt
        self._practical, self._at_rest = practical, at_rest
        base = plant.constants_of(robot)
        self.knobs = knobs_of(base, {name: min(doubt * share, MOST_DOUBT)
                                     for name, share in DOUBT.items()})
        self._doubts = np.array([knob.doubt for knob in self.knobs])
        level = 0.5 * (robot.friction.forward.coulomb + robot.friction.backward.coulomb)
        self.floor = practical * np.tile(level, 2)
        self.pool = ThreadPoolExecutor(os.cpu_count() or 1)
        self._like = like or (robot, np.zeros(len(self.knobs)))
        self._measure()

    def _seen(self, path):
        """Return where the equations of a Path tell something, bool (S, 2 n)."""
        known = np.repeat(path.known[:, None], path.standing.shape[1], axis=1)
        return np.concatenate([known if self._at_rest else known & ~path.standing, known], axis=1)

    def share_at_rest(self, robot, x):
        """Return the share of the squares of a model's residual torque while links stand."""
        still = whole = 0.0
        constants = self.constants(robot, x)
        for path, whitening in zip(self.paths, self.whitenings, strict=True):
            square = whitening.torque_rows(unexplained(path, constants)) ** 2
            at = np.minimum((whitening.time / path.period).astype(int), len(path.standing) - 1)
            still += np.sum(square[:, :path.standing.shape[1]][path.standing[at]])
            whole += np.sum(square)
        return float(still / max(whole, 1e-300))

    def rows_of(self, residuals, x=None):
        """Return rows (R,) of residuals (S, 2 n) of each path, then how far knobs are moved."""
        burden = np.zeros(len(self.knobs)) if x is None else _OF_DOUBT * x / self._doubts
        return np.concatenate([*(whitening.rows_of(residual).ravel() for whitening, residual in
                                 zip(self.whitenings, residuals, strict=True)), burden])

    def _measure(self):
        """Take the measure of rows from runs in which nothing is missing."""
        robot, x = self._like
        constants = self.constants(robot, x)
        runs = [[retrace(path, constants, np.random.default_rng([self._seed, k]))
                 for path in self.paths] for k in range(_FRESH + REPLICATES)]
        residuals = list(self.pool.map(
            lambda run: [unexplained(path, constants) for path in run], runs))
        self.whitenings = [Whitening(np.stack(clean[_FRESH:]), path.period, self.floor,
                                     self._seen(path), even=not self._at_rest)
                           for path, clean in zip(self.paths, zip(*residuals, strict=True),
                                                  strict=True)]
        self._divide()
        clean = np.stack([self.rows_of(run) for run in residuals])
        # what filters leave at every reversal, say, though nothing is missing: so they do of the
        # recording, whose rows scatter by that of this mean as well
        self.usual, count = clean.mean(axis=0), len(clean)
        self.clean = (clean - self.usual) * np.sqrt((count + 1) / (count - 1))
        self.level = float(np.mean(self.clean[:_FRESH, self.fitted] ** 2))
        self.noise = Noise(self, runs[:2], robot, x)

    def measured_like(self, model):
        """Return the Problem in which runs of a model, a Fitted, tell what noise is."""
        return Problem(self.paths, self.robot, self._practical, self._seed, self._doubt,
                       self._at_rest, (model.robot, model.x))

    def along(self, paths):
        """Return the Problem of paths that nearly are its own, in the same units of noise."""
        other = copy(self)
        other.paths = paths
        return other

    def of_others(self, paths):
        """Return the Problem of other recordings, all of them held out."""
        other = Problem(paths, self.robot, self._practical, self._seed, self._doubt,
                        self._at_rest, self._like)
        other.held_out, other.fitted = other.held_out | other.fitted, other.fitted & False
        self.burden_of(other.held_out)[:] = False
        other.moments_held_out = [whitening.settled for whitening in other.whitenings]
        return other

    def level_of(self, joint):
        """Return Coulomb friction of a joint, the least of all for the whole arm [N m]."""
        level = self.floor[:self.robot.n_joints] / self._practical
        return float(level[self.robot.joints.index(joint)] if joint in self.robot.joints
                     else level.min())

    def with_held_out(self, turn):
        """Return the Problem with other blocks held out, one of `turns`; the last is usual."""
        other = copy(self)
        other._original = self  # which noise was measured with
        other._divide(turn)
        return other

    def _divide(self, turn=-1):
        """Set which rows are fitted and which held out, by blocks of time."""
        counts = [_blocks_in(whitening.time[-1]) for whitening in self.whitenings]
        self.turns = min(_HELD_OUT, sum(counts))

        def is_out(first, whitening, time):
            block = first + _block_of(time, whitening.time[-1])
            return block % self.turns == turn % self.turns
        pairs = list(zip(np.cumsum([0, *counts[:-1]]), self.whitenings, strict=True))
        out = np.concatenate([np.repeat(is_out(first, whitening, whitening.row_time),
                                        whitening.scale.shape[1]) for first, whitening in pairs])
        used = np.concatenate([whitening.scale.ravel() > 0.0 for whitening in self.whitenings])
        others = np.ones(len(self.knobs), dtype=bool)
        self.fitted = np.concatenate([used & ~out, others])
        self.held_out = np.concatenate([used & out, ~others])
        self.moments_held_out = [is_out(first, whitening, whitening.time) & whitening.settled
                                 for first, whitening in pairs]

    @property
    def unseen(self):
        """Return the joints whose links have no encoder, set of str."""
        return {path.joints[link.joint] for path in self.paths for link in path.unseen}

    @property
    def caution(self):
        """Return how many times as much as usual an effect must explain."""
        return _OF_MOTORS if self.unseen else 1.0

    @property
    def clean_cost(self):
        """Return the cost of a run in which nothing is missing."""
        return self.level * self.unit_cost

    @property
    def unit_cost(self):
        """Return the cost of what noise makes and of what does not matter together."""
        return float(self.fitted.sum())

    def missing(self, model):
        """Return how far the cost of a Fitted is above that of a clean run, in `unit_cost`."""
        return (self.exact_cost(model) - self.clean_cost) / self.unit_cost

    def cost(self, rows, robot, x):
        """
        Return the sum of squares of a model's rows that are fitted, cleared of what noise adds.

        To first order, as `slope` has it.
        """
        return float(np.sum(rows[self.fitted] ** 2) - 2.0 * self.noise.half_cost(robot, x))

    def exact_cost(self, model):
        """
        Return the cost of a Fitted with all that noise adds, not to first order alone.

        Two effects that are nearly the same, such as a payload and a heavier link, have slopes of
        their own; far from where noise was measured they would differ by these alone.
        """
        return (float(np.sum(model.rows[self.fitted] ** 2))
                - self.noise.exact_cost(model.robot, model.x))

    def slope(self, columns, rows, robot, numbers=()):
        """Return the downhill slope of half the cost by knobs and numbers of effects (C,)."""
        return (self.noise.slopes(robot, numbers)
                - columns[:, self.fitted] @ rows[self.fitted])

    def bound_of(self, robot):
        """Return the largest change of each knob (P,), 0 where a new effect stands for it."""
        known = len(self.robot.effects)
        replaced = {(REPLACED[spec.name], robot.joints.index(spec.joint))
                    for spec in robot.effects[known:] if spec.name in REPLACED}
        return np.array([0.0 if (knob.name, knob.joint) in replaced else knob.doubt
                         for knob in self.knobs])

    def constants(self, robot, x):
        """Return the kernels' record of a robot with its knobs at ``x``."""
        return tuned(plant.constants_of(robot), self.knobs, x)

    def rows(self, robot, x):
        """
        Return residuals of a model in units of what shows in a clean run, and its knobs' burden.

        Less what all clean runs show. The burden, one row for each knob, is its change in units
        of half of its doubt.
        """
        return self.rows_along(self.paths, self.constants(robot, x), x) - self.usual

    def rows_along(self, paths, constants, x=None):
        """Return `rows` of a kernels' record along paths, nothing taken off."""
        return self.rows_of([unexplained(path, constants) for path in paths], x)

    def burden_of(self, rows):
        """Return the rows, a view of `rows` (R,), that tell how far each knob is moved (P,)."""
        return rows[len(rows) - len(self.knobs):]

    def torque_rms(self, robot, x, other):
        """Return the rms by which two models' residual torques differ, of the larger channel."""
        changes = [whitening.torque_rows(unexplained(path, self.constants(robot, x))
                                         - unexplained(path, self.constants(other, x)))
                   for path, whitening in zip(self.paths, self.whitenings, strict=True)]
        return float(np.sqrt(np.mean(np.concatenate(changes) ** 2, axis=0)).max())

    def each(self, function, jobs):
        """Return what a function gives of each job, in threads, stacked."""
        return np.array(list(self.pool.map(function, jobs)))

    def knob_columns(self, robot, x, rows):
        """Return derivatives of the rows by the knobs, shape (P, R)."""
        def column(i):
            at = x.copy()
            at[i] += _KNOB_STEP
            return (self.rows(robot, at) - rows) / _KNOB_STEP
        return self.each(column, range(len(x)))

    def retuned(self, robot, x, iterations=2):
        """Return knobs, rows and the knobs' columns where the rows are smallest."""
        for _ in range(iterations):
            rows = self.rows(robot, x)
            columns = self.knob_columns(robot, x, rows)
            used = columns[:, self.fitted]
            bound = self.bound_of(robot)
            x = x + solve(used @ used.T, self.slope(columns, rows, robot), -bound - x, bound - x)
        return x, self.rows(robot, x), columns


def _blocks_in(duration):
    """Return how many blocks there are in a time [s], two at least."""
    return max(round(duration / BLOCK), 2)


def _block_of(time, duration):
    """Return the block that each time (T,) is in; what is left of half of one joins the last."""
    block = (time / min(BLOCK, 0.5 * duration)).astype(int)
    return np.minimum(block, _blocks_in(duration) - 1)


def with_effect(robot, spec):
    """Return a robot with one more effect."""
    return replace(robot, effects=(*robot.effects, spec))
