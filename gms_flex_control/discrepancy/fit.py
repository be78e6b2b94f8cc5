# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Gauss and Newton on all that is free: knobs within their doubt, parameters of effects."""

from dataclasses import dataclass, replace
from typing import NamedTuple

from gms_flex_control.discrepancy.bounded import solve
from gms_flex_control.discrepancy.guesses import bounds_of
from gms_flex_control.effects.registry import find
import numpy as np

FIXED = ('load', 'duration')  # parameters that only set the unit of another
_STEP = 0.01                  # of a value, for its derivative
_ANGLES = {'phase': 0.02, 'direction': 0.02, 'order': 0.02}
_REACH, _ANGLE_REACH = 60.0, 25.0  # largest change at once, in steps
_SHRINK = (1.0, 0.3, 0.1)
_ENOUGH = 1e-4


class Number(NamedTuple):
    """One parameter of one effect that a fit moves."""

    effect: int
    parameter: int
    step: float
    reach: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """
    A model and how far it is from the recordings.

    Parameters
    ----------
    robot : RobotParams
        With effects.
    x : ndarray, shape (P,)
        Knobs.
    rows : ndarray, shape (R,)
        Of the model.
    cost : float
        Of the rows that are fitted, see Problem.cost.

    """

    robot: object
    x: np.ndarray
    rows: np.ndarray
    cost: float

    @classmethod
    def of(cls, problem, robot, x):
        """Return a robot with its knobs at ``x`` (P,) as it is."""
        rows = problem.rows(robot, x)
        return cls(robot, x, rows, problem.cost(rows, robot, x))


def numbers_of(robot, first=0):
    """Return the Numbers of all effects of a robot from the ``first`` on."""
    numbers = []
    for i, spec in enumerate(robot.effects[first:], start=first):
        kind = find(spec.name)
        bounds = zip(*bounds_of(kind, spec.joint, robot), strict=True)
        for k, (parameter, limits) in enumerate(zip(kind.parameters, bounds, strict=True)):
            if parameter.name in FIXED:
                continue
            angle = _ANGLES.get(parameter.name)
            usual = 0.1 if parameter.unit == '1' else 1e-6
            step = angle or _STEP * max(abs(spec.values[k]), usual)
            numbers.append(Number(i, k, step, (_ANGLE_REACH if angle else _REACH) * step,
                                  *limits))
    return numbers


def values_of(robot, numbers):
    """Return the values (V,) of parameters."""
    return np.array([robot.effects[n.effect].values[n.parameter] for n in numbers])


def at_values(robot, numbers, values):
    """Return a robot with parameters of its effects at values (V,), kept within bounds."""
    lists = [list(spec.values) for spec in robot.effects]
    for number, value in zip(numbers, values, strict=True):
        lists[number.effect][number.parameter] = float(np.clip(value, number.lower, number.upper))
    return replace(robot, effects=tuple(replace(spec, values=tuple(entries)) for spec, entries
                                        in zip(robot.effects, lists, strict=True)))


def effect_columns(problem, robot, x, rows, numbers):
    """Return derivatives (V, R) of the rows by parameters of effects."""
    values = values_of(robot, numbers)

    def column(i):
        at, step = values.copy(), numbers[i].step
        step = -step if at[i] + step > numbers[i].upper else step
        at[i] += step
        return (problem.rows(at_values(robot, numbers, at), x) - rows) / step
    return problem.each(column, range(len(numbers))).reshape(len(numbers), len(rows))


def fit(problem, robot, x, columns, first=0, iterations=3):
    """
    Move knobs and the parameters of effects from the ``first`` on to where rows are smallest.

    Parameters
    ----------
    problem : Problem
        The rows.
    robot : RobotParams
        Where to begin.
    x : ndarray, shape (P,)
        Knobs to begin with.
    columns : ndarray, shape (C, R)
        Derivatives that hardly change: by the knobs and, if they are known, by the first numbers
        of these effects; the others are taken anew each time.
    first : int
        Effects before are left as they are.
    iterations : int
        At most.

    Returns
    -------
    Fitted

    """
    rows, known = problem.rows(robot, x), len(columns) - len(x)
    cost = problem.cost(rows, robot, x)
    for _ in range(iterations):
        numbers = numbers_of(robot, first)
        values = values_of(robot, numbers)
        own = effect_columns(problem, robot, x, rows, numbers[known:])
        step = _step(problem, np.concatenate([columns, own]), rows, robot, x, values, numbers)
        for shrink in _SHRINK:
            other = at_values(robot, numbers, values + shrink * step[len(x):])
            knobs = x + shrink * step[:len(x)]
            moved = problem.rows(other, knobs)
            gain = cost - problem.cost(moved, other, knobs)
            if gain > 0.0:
                break
        else:
            break
        robot, x, rows, cost = other, knobs, moved, cost - gain
        if gain < _ENOUGH * cost:
            break
    return Fitted(robot, x, rows, cost)


def _step(problem, columns, rows, robot, x, values, numbers):
    bound = problem.bound_of(robot)
    used = columns[:, problem.fitted]
    reach = np.array([n.reach for n in numbers])
    low = np.concatenate([-bound - x,
                          np.maximum(np.array([n.lower for n in numbers]) - values, -reach)])
    high = np.concatenate([bound - x,
                           np.minimum(np.array([n.upper for n in numbers]) - values, reach)])
    return solve(used @ used.T, problem.slope(columns, rows, robot, numbers), low, high)
