# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
From effects that were fitted to findings that are said: what each is worth, and what it is not.

A finding is judged by what would be left without it while all else is re-tuned, not by its size:
an effect that known parameters or other effects can take the place of is none.
"""

from typing import NamedTuple

from gms_flex_control.discrepancy.fit import Fitted, numbers_of
from gms_flex_control.discrepancy.library import least_cost
from gms_flex_control.discrepancy.result import Value
from gms_flex_control.discrepancy.search import without
from gms_flex_control.effects.registry import find
from gms_flex_control.identification.result import CONFIDENT
import numpy as np

_TAKEN = 0.003        # of its own rows: what else could take its place leaves less than this
_SURE = 0.05          # likewise: a small effect that others can make but for this is not named
_CONFUSABLE = 0.98    # cosine, all else re-tuned
_LITTLE = 0.05        # of the most that one effect explains
_RUNNERS = 6          # hypotheses tried in the place of a finding


class Judged(NamedTuple):
    """One effect of a model and what it is worth."""

    index: int         # among the robot's effects
    own: float         # sum of squares of the rows it makes
    loss: float        # of those that nothing else can make
    torque: float      # rms of what it contributes [N m]
    less: Fitted       # the model less it
    others: np.ndarray  # columns of all else

    @property
    def share(self):
        """Return the part of its rows that nothing else can make; 0 of none at all."""
        return min(self.loss / self.own, 1.0) if self.own > 0.0 else 0.0

    @property
    def alone(self):
        """Return the torque that nothing else can make, rms [N m]."""
        return self.torque * self.share ** 0.5

    @property
    def weight(self):
        """
        Return by what effects are ranked [N m]: between all its torque and what is its alone.

        A large effect that others can make the better part of is large all the same.
        """
        return (self.torque * self.alone) ** 0.5

    def is_trifle(self, most):
        """Return whether it explains but little beside the ``most`` that one effect does."""
        return self.loss < _LITTLE * most


def judged(problem, found, known):
    """
    Return what each effect is worth, the heaviest first.

    But one that explains little comes after those that explain more: its torque may be large where
    noise is, and then it is hardly known.

    Parameters
    ----------
    problem : Problem
        The rows.
    found : Found
        Of the search.
    known : int
        Effects the user knew of.

    Returns
    -------
    list of Judged

    """
    model, out = found.model, []
    for i in range(known, len(model.robot.effects)):
        less, others = without(problem, model, found.columns, known, i)
        change = (less.rows - model.rows)[problem.fitted]
        torque = problem.torque_rms(less.robot, model.x, model.robot)
        retuned = least_cost(problem, less, others)
        out.append(Judged(i, float(change @ change), max(retuned - model.cost, 0.0), torque, less,
                          others))
    most = max((one.loss for one in out), default=0.0)
    return sorted(out, key=lambda one: (one.is_trifle(most), -one.weight))


def largest_alone(entries):
    """Return the largest torque that one of the Judged alone can make, trifles left out [N m]."""
    most = max((one.loss for one in entries), default=0.0)
    return max((one.alone for one in entries if not one.is_trifle(most)), default=0.0)


def is_sure(one):
    """Return whether others could make only some of an effect's torque."""
    return one.share > _SURE


def stands_alone(one):
    """Return whether an effect is more than what known parameters or others could be."""
    return one.share > _TAKEN


def values_of(problem, found, known, index):
    """
    Return the Values of one effect, intervals by the curvature and what is unexplained.

    Or by how far runs in which nothing is missing scatter, if that is more: the curvature takes
    it that rows say each something of their own.
    """
    model, knobs = found.model, len(problem.knobs)
    numbers = numbers_of(model.robot, known)
    columns = found.columns[:, problem.fitted]
    scale = np.sqrt(np.maximum(np.sum(columns ** 2, axis=1), 1e-300))
    gram = (columns / scale[:, None]) @ (columns / scale[:, None]).T
    level = max(np.mean(model.rows[problem.fitted] ** 2) / problem.level, 1.0)
    inverse = np.linalg.pinv(gram, hermitian=True)
    scatter = inverse @ (columns / scale[:, None]) @ problem.clean[:, problem.fitted].T
    variance = np.maximum(np.diag(inverse) * level, np.mean(scatter ** 2, axis=1)) / scale ** 2
    spec, out = model.robot.effects[index], []
    for k, parameter in enumerate(find(spec.name).parameters):
        value, half = spec.values[k], 0.0
        for place, number in enumerate(numbers):
            if (number.effect, number.parameter) == (index, k):
                half = CONFIDENT * float(np.sqrt(variance[knobs + place]))
        out.append(Value(parameter.name, parameter.unit, float(value), float(value - half),
                         float(value + half)))
    return tuple(out)


def rivals(problem, found, one):
    """
    Return what could stand in the place of an effect: (name, joint, share), the best first.

    Parameters
    ----------
    problem : Problem
        The rows.
    found : Found
        Of the search.
    one : Judged
        The effect.

    Returns
    -------
    list of tuple
        Share of its loss that each hypothesis makes good, all else re-tuned.

    """
    spec = found.model.robot.effects[one.index]
    ranked = found.library.ranked(one.less, one.others)
    return [(other.spec.name, other.spec.joint, min(other.gain / max(one.loss, 1e-12), 1.0))
            for other in ranked[:_RUNNERS]
            if (other.spec.name, other.spec.joint) != (spec.name, spec.joint)]


def confusable(spec, others):
    """Return names that these data, or any, hardly tell from an effect."""
    names = {name for name, joint, share in others if share > _CONFUSABLE ** 2}
    kind = find(spec.name)
    names |= {name for name, _, share in others
              if name in kind.confusable and share > kind.declared_from}
    return tuple(sorted(names - {spec.name}))
