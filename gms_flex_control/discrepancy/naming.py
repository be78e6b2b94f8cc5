# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Which of the effects that were found are named: those that help on data held out.

What explains little of what is missing, or helps torque and not motion, is not believed.
"""

from gms_flex_control.discrepancy import judge
import numpy as np

DETECTED = 0.3        # missing, see `Problem.missing`: below, nothing is
EXPLAINED = 0.05      # of what was missing: so little may be left of it
TOO_MUCH = 0.5        # likewise: with more left, no effect is named
_CERTAIN = 1.0        # missing: so much is no trifle, small as its torque is
_TRIFLE = 0.5         # of the practical torque
_PARTLY = 0.2         # of what was missing, where effects that explain most of it are named
_DOMINANT = 0.6       # share of an effect that explains most
_PART = 0.05          # share of an effect that is worth naming where much is left
_WITHOUT_OTHERS = 0.5  # of what an effect explains beside others that are not named
_FEWER = 2            # pairs, and effects alone, that are tried at last
_FEW = 3              # findings: so few are all named, small and like others though they be
_CLEAR = 0.85         # of what a small effect explains: no other explains so much
_NEARLY_ALL = 0.2     # of held-out torque: less is left of it
_GOOD_DEAL = ((0.95, 0.3), (0.35, 0.95), (_NEARLY_ALL, 1.1))  # of torque and stray squared
_CHANCE = 1.1         # of held-out torque, where an effect acts seldom
_FARTHEST = 1.02, 1.7, 4.0  # of squared free runs, by how many excuses they have; see `helps`
_WORSE = 1.02         # of squares of torque or of free runs: effects that make more are not added
_SIGNIFICANT = 2.0    # standard errors of the mean of free runs


def helps(gap, much, strictly=False):
    """
    Return whether effects help on data held out.

    Neither torque nor free runs may be worse; torque may be a little worse by chance where an
    effect acts seldom, as an end stop does, and free runs, whose starts are only nearly known,
    where torque is nearly explained or where but few of them stray farther, more so where both.
    Asked to help ``much`` they must do more: free runs stray far less, or torque is explained for
    the better part and they stray no farther, as with an error of an encoder, which moves
    nothing. ``strictly``, free runs must not stray farther at all: where links are not seen
    nothing else speaks for them.
    """
    torque, stray = gap.energy_ratio, strayed(gap)
    if strictly and stray >= 1.0:
        return False
    if much:
        return any(torque < most and stray < farthest for most, farthest in _GOOD_DEAL)
    excuses = sum((bool(torque < _NEARLY_ALL), bool(gap.free_farther < _SIGNIFICANT)))
    farthest = _FARTHEST[excuses]
    return min(torque, stray) < 1.0 and torque < _CHANCE and stray < farthest


def makes_worse(gap):
    """
    Return whether torque or free runs are farther off with the effects than without, by 1 % rms.

    Such effects may still be there: a truth that makes a link break loose a moment sooner or later
    may lead free runs astray. But a model is not made worse for the sake of a name. Free runs that
    stray no farther than those of a run of the model itself, its floor, are as good as can be.
    """
    at_floor = np.sum(gap.free_after ** 2) <= np.sum(gap.free_floor ** 2)
    return bool(gap.energy_ratio > _WORSE or (strayed(gap) > _WORSE and not at_floor))


def strayed(gap):
    """Return the squared strays of free runs, after over before; 1 if there are no runs."""
    before, after = (float(np.sum(errors ** 2)) for errors in (gap.free_before, gap.free_after))
    return after / before if before > 0.0 else 1.0


def explains_alone(entries, judged):
    """
    Return whether effects explain without the others about what they explained beside them.

    Effects that nearly cancel each other each explain much, and none of them is there.
    """
    return (max(one.loss for one in judged)
            > _WITHOUT_OTHERS * max(one.loss for one in entries))


def choices(entries, left, whole, by_gain):
    """
    Return which of the effects may be named, the best choice first, and how much they must help.

    Where much is ``left`` unexplained, effects may but resemble what is there: those that explain
    most of it are named if they help, others only if they help much. At last the first of those
    ``by_gain``, which gained most when nothing else was there, may be named if it helps much, with
    another or alone: many that share what it does leave it little to explain beside them.
    """
    if left <= EXPLAINED:
        return (entries, False), (entries[:1], False), (by_gain[:1], True)
    if left > TOO_MUCH:
        return ()
    missed = sorted(entries, key=lambda one: -one.loss)
    entries = [one for one in entries if one.loss > _PART * whole]
    strong = [one for one in entries if one.loss > _DOMINANT * whole and left < _PARTLY]
    fewer = [*([first, other] for first in by_gain[:1] for other in missed[:_FEWER]
               if other is not first), *([one] for one in by_gain[:_FEWER])]
    return (entries, True), (entries[:1], True), (strong, False), *((few, True) for few in fewer)


def grouped(findings, entries):
    """
    Return findings that are named, small ones, and those whose names are one of several; tuples.

    Among many, an effect that these data tell from no other is named only if it is the largest,
    and a small one only if they tell it clearly.
    """
    groups, few = ([], [], []), len(findings) <= _FEW
    for finding, one in zip(findings, entries, strict=True):
        named = few or not finding.confusable_with
        if finding.main:
            groups[0 if named or not groups[0] else 2].append(finding)
        else:
            clear = (named and judge.is_sure(one)
                     and finding.runner_up_score < _CLEAR * finding.score)
            groups[1 if few or clear else 2].append(finding)
    return tuple(tuple(group) for group in groups)


def matters(problem, gap, before, practical):
    """
    Return whether something is left where no effect was found.

    Parameters
    ----------
    problem : Problem
        The rows.
    gap : Gap
        On data held out.
    before : float
        What is missing, see `Problem.missing`.
    practical : float
        Torque that matters, as a share of Coulomb friction.

    Returns
    -------
    bool
        What is significant and no trifle of torque: where a motion tells block stiffnesses that
        are a little off, that is no effect.

    """
    level = practical * np.array([problem.level_of(joint) for joint in gap.joints])
    above = np.sqrt(np.maximum(gap.retuned ** 2 - gap.floor ** 2, 0.0))
    return bool(before > DETECTED * problem.caution
                and (before > _CERTAIN * problem.caution or np.any(above > _TRIFLE * level)))
