# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Least squares beside the tool: the drive's torque as a weighted sum of columns of the motion.

Columns and torque pass the same low-pass. Weights and delay, and which groups of columns are used
at all, are chosen on the data that are fitted; the data held out are only predicted.
"""

from dataclasses import dataclass
from typing import NamedTuple

from bench.real_machines import library
from bench.real_machines.motion import low_pass, rms
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import lsq_linear

DELAYS = np.arange(-20, 21) * 2.5e-4  # of the torque behind the motion, scanned [s]
NO_DELAY = (0.0,)
FOLDS = 5          # of the data that are fitted, each in turn predicted by the others
WORTH = 0.99       # of the squares predicted: a group that helps less is left out
_RIDGE = 1e-6      # of the square of a column, added to it
_FINER = 8.0       # samples kept per period of the band
_DELAY = 'delay'   # a group without columns


class Part(NamedTuple):
    """A Motion and which of its samples (S,) are used, bool."""

    motion: object
    mask: np.ndarray


@dataclass(frozen=True, eq=False)
class Fit:
    """Weights of columns."""

    columns: tuple  # C of them
    weights: np.ndarray  # (C,), torque per unit of the column
    # by which the torque's part lags behind the motion; negative where it leads it, as a torque
    # does that takes effect late [s]
    delay: float
    band: float  # of the low-pass [Hz]

    def weight(self, name):
        """Return the weight of a column by its name."""
        return float(self.weights[[column.name for column in self.columns].index(name)])

    @property
    def groups(self):
        """Return the groups of its columns, each once, and whether a delay was fitted."""
        groups = dict.fromkeys(column.group for column in self.columns)
        return (*groups, *((_DELAY,) if self.delay else ()))

    def residual(self, motion):
        """Return measured less modelled torque (S,) behind the low-pass [N m]."""
        modelled = Delayed(self.columns, motion, self.band)(self.delay) @ self.weights
        return low_pass(motion.torque, self.band, motion.period) - modelled

    def rms(self, parts):
        """Return the residual torque over the samples of Parts, rms [N m]."""
        return rms(np.concatenate([self.residual(motion)[mask] for motion, mask in parts]))


class Delayed:
    """Columns of a Motion behind a low-pass of a ``band`` [Hz], at any delay."""

    def __init__(self, columns, motion, band):
        values = np.stack([column.along(motion) for column in columns], axis=1)
        self._time, self._values = motion.time, low_pass(values, band, motion.period)
        self._between = None

    def __call__(self, delay, every=1):
        """Return every so many samples of the columns (S, C) of a ``delay`` [s] before."""
        if delay == 0.0:
            return self._values[::every]
        self._between = self._between or CubicSpline(self._time, self._values)
        return self._between(np.clip(self._time[::every] - delay, 0.0, self._time[-1]))


class Squares:
    """
    Inner products of columns and torque, for each delay and fold of the data.

    ``band`` of the low-pass [Hz], ``delays`` [s]; each of ``parts`` is cut into ``folds`` pieces.
    """

    def __init__(self, columns, parts, band, delays=NO_DELAY, folds=1):
        self.columns, self.band, self.delays = tuple(columns), band, tuple(delays)
        size = len(self.columns) + 1
        self._products = np.zeros((len(self.delays), folds, size, size))
        for motion, mask in parts:
            every = max(int(1.0 / (_FINER * band * motion.period)), 1)
            table = Delayed(self.columns, motion, band)
            torque = low_pass(motion.torque, band, motion.period)[::every]
            pieces = np.array_split(np.flatnonzero(mask[::every]), folds)
            for d, delay in enumerate(self.delays):
                both = np.column_stack([table(delay, every), torque])
                for f, rows in enumerate(pieces):
                    self._products[d, f] += both[rows].T @ both[rows]

    def fitted(self, groups=None, delayed=True):
        """Return the Fit of the columns of some groups (default all), at the best delay."""
        kept = self._of(groups)
        tried = range(len(self.delays)) if delayed else [self.delays.index(0.0)]
        costs = {d: self._cost(kept, d, slice(None), slice(None)) for d in tried}
        best = min(costs, key=costs.get)
        weights = self._weights(kept, self._products[best].sum(axis=0))
        return Fit(tuple(self.columns[k] for k in kept), weights, self.delays[best], self.band)

    def predicted(self, groups, delayed):
        """Return the squares that fits to the other folds leave of each fold."""
        kept, total = self._of(groups), 0.0
        tried = range(len(self.delays)) if delayed else [self.delays.index(0.0)]
        for fold in range(self._products.shape[1]):
            others = np.arange(self._products.shape[1]) != fold
            best = min(tried, key=lambda d: self._cost(kept, d, others, others))
            total += self._cost(kept, best, others, [fold])
        return total

    def _of(self, groups):
        return [k for k, column in enumerate(self.columns)
                if groups is None or column.group in groups]

    def _cost(self, kept, delay, fit, held_out):
        """Return what weights of the folds ``fit`` leave of squares of those ``held_out``."""
        weights = self._weights(kept, self._products[delay][fit].sum(axis=0))
        product = self._products[delay][held_out].sum(axis=0)
        line = np.append(weights, -1.0)
        rows = [*kept, len(self.columns)]
        return float(line @ product[np.ix_(rows, rows)] @ line)

    def _weights(self, kept, product):
        square, target = product[np.ix_(kept, kept)], product[kept, -1]
        scale = np.sqrt(np.diag(square))
        scale[scale == 0.0] = 1.0
        root = np.linalg.cholesky(square / np.outer(scale, scale) + _RIDGE * np.eye(len(kept)))
        free = np.linalg.solve(root, target / scale)
        least = [0.0 if self.columns[k].positive else -np.inf for k in kept]
        found = np.linalg.solve(root.T, free)
        if np.any(found < least):
            found = lsq_linear(root.T, free, (least, np.inf), method='bvls').x
        return found / scale


def textbook(parts, band, gravity):
    """Return the Fit of inertia, Coulomb and viscous friction, an offset, and gravity if any."""
    return Squares(library.textbook(gravity), parts, band).fitted()


class Compared(NamedTuple):
    """The fits of least squares to one set of data."""

    plain: Fit       # textbook
    whole: Fit       # all of the library, at the best delay
    chosen: Fit      # the groups that help to predict folds of the data
    alone: dict      # textbook with one group more: the Fit by the name of the group


def compared(parts, band, gravity, loaded):
    """
    Fit the textbook model, the library and what of the library the data ask for.

    ``band`` of the low-pass [Hz]; whether ``gravity`` acts and whether the load changes. Return
    them as Compared.
    """
    plain = textbook(parts, band, gravity)
    more = library.further(parts, plain if loaded else None)
    smooth = Squares([*plain.columns, *more], parts, band, DELAYS).fitted()
    left = [smooth.residual(motion) for motion, _ in parts]
    orders = library.ripple_orders(parts, left, band)
    squares = Squares([*plain.columns, *more, *library.ripple(orders)], parts, band, DELAYS,
                      FOLDS)
    base = tuple(dict.fromkeys(column.group for column in plain.columns))
    added = [*dict.fromkeys(column.group for column in squares.columns
                            if column.group not in base), _DELAY]
    alone = {group: squares.fitted((*base, group), delayed=group == _DELAY) for group in added}
    return Compared(plain, squares.fitted(), _chosen(squares, base, added), alone)


def _chosen(squares, base, added):
    """Return the Fit with the groups that help to predict folds, added one after the other."""
    groups, best = list(base), squares.predicted(base, delayed=False)
    while True:
        costs = {group: squares.predicted([*groups, group], _DELAY in (*groups, group))
                 for group in added if group not in groups}
        group = min(costs, key=costs.get, default=None)
        if group is None or costs[group] > WORTH * best:
            return squares.fitted(groups, delayed=_DELAY in groups)
        groups.append(group)
        best = costs[group]
