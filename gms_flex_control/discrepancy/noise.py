# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What noise of the readings adds to the cost of a model.

It stands in the rows times inertia and stiffness: a lighter arm would always look better, by its
smaller noise. Two runs in which nothing is missing, which share their motion and not their noise,
tell how much that is.
"""

from dataclasses import replace
import weakref

from gms_flex_control.effects.base import Change
from gms_flex_control.effects.registry import find
import numpy as np

_KNOB_STEP = 0.01
_RATIO_STEP = 0.1     # of a relative change that an effect is


class Noise:
    """
    What noise adds, to first order in knobs and parameters of effects, and exactly.

    Parameters
    ----------
    problem : Problem
        The rows.
    runs : pair of sequence of Path
        Retraced runs of the recordings, with noise of their own each.
    robot, x : RobotParams and ndarray, shape (P,)
        Whose runs they are; nothing is added to the cost of this model.

    """

    def __init__(self, problem, runs, robot, x):
        self._problem = weakref.proxy(problem)  # which owns this: a cycle would be freed late
        self._runs, self._robot, self._x = runs, robot, x
        self._known = len(problem.robot.effects)
        self._own = self._rows(robot, x)
        self._of_knobs = problem.each(lambda i: self._slope(
            robot, x + _KNOB_STEP * (np.arange(len(x)) == i)) / _KNOB_STEP, range(len(x)))
        self._of_effects = {}  # (effect, joint): of each parameter

    def _rows(self, robot, x):
        """Return how rows of both runs differ: what they share is motion, not noise."""
        constants = self._problem.constants(robot, x)
        one, other = (self._problem.rows_along(run, constants) for run in self._runs)
        return (one - other)[self._problem.fitted]

    def _slope(self, robot, x):
        """Return half of what noise adds to the cost of a model, to first order."""
        return 0.5 * float(self._own @ (self._rows(robot, x) - self._own))

    def learn(self, spec):
        """
        Learn what noise adds to the slopes of an effect that is linear in its parameters.

        Parameters
        ----------
        spec : EffectSpec
            At a small size.

        """
        kind, count = find(spec.name), len(spec.values)
        sets, slopes = {0: spec.values}, np.zeros(count)
        if issubclass(kind, Change):  # its further ratios, one by one
            sets |= {k: tuple(_RATIO_STEP * (np.arange(count) == k)) for k in range(1, count)
                     if kind.parameters[k].unit == '1'}
        for k, values in sets.items():
            effects = (*self._robot.effects, replace(spec, values=values))
            slopes[k] = self._slope(replace(self._robot, effects=effects), self._x) / values[k]
        self._of_effects[spec.name, spec.joint] = slopes

    def forget(self, name, joint):
        """Take it that noise adds nothing to the slopes of an effect: its rows are but noise."""
        self._of_effects.pop((name, joint), None)

    def slopes_of(self, spec):
        """Return what noise adds to the slopes of an effect, one number per parameter."""
        return self._of_effects.get((spec.name, spec.joint), np.zeros(len(spec.values)))

    def slopes(self, robot, numbers=()):
        """Return what noise adds to the slopes of knobs and Numbers of effects, one by one."""
        return np.concatenate([self._of_knobs, [
            self.slopes_of(robot.effects[number.effect])[number.parameter]
            for number in numbers]])

    def half_cost(self, robot, x):
        """Return half of what noise adds to the cost of a model, to first order."""
        return float(self._of_knobs @ (x - self._x) + self._of_added(robot)
                     - self._of_added(self._robot))

    def _of_added(self, robot):
        return sum(self.slopes_of(spec) @ spec.values for spec in robot.effects[self._known:])

    def exact_cost(self, robot, x):
        """Return what noise adds to the cost of a model."""
        rows = self._rows(robot, x)
        return 0.5 * float(rows @ rows - self._own @ self._own)
