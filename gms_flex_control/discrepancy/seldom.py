# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Effects that act seldom: other blocks of time are held out if none of the usual ones shows them.

An end stop that was met thrice is no better and no worse on data in which it was not met.
"""

from gms_flex_control.discrepancy import judge
from gms_flex_control.discrepancy.library import Library
from gms_flex_control.discrepancy.search import refitted, retuned
import numpy as np

_SELDOM = 0.02        # of what an effect changes: so little of it is held out
_MOST = 0.6           # likewise: with more of it held out, too little is left to fit


def where_it_acts(problem, found, entries, known, without=()):
    """
    Return a search's end with blocks held out in which the largest of its effects acts.

    Parameters
    ----------
    problem : Problem
        The rows.
    found : Found
        The search's end.
    entries : list of Judged
        Its effects.
    known : int
        Effects the user knew of.
    without : collection of str
        Effects that are left out of the library.

    Returns
    -------
    problem : Problem
    found : Found
        Fitted anew if other blocks are held out.
    entries : list of Judged

    """
    if not entries:
        return problem, found, entries
    one = max(entries, key=lambda one: one.loss)
    change = (one.less.rows - found.model.rows) ** 2
    whole = change.sum()
    if change[problem.held_out].sum() >= _SELDOM * whole:
        return problem, found, entries
    others = [problem.with_held_out(turn) for turn in range(problem.turns)]
    shares = np.array([change[other.held_out].sum() for other in others]) / whole
    turn = int(np.argmin(np.abs(shares - 1.0 / len(shares))))
    if not _SELDOM < shares[turn] < _MOST:
        return problem, found, entries
    problem = others[turn]
    before, knobs = retuned(problem, found.before.robot, found.before.x)
    model, columns = refitted(problem, found.model.robot, found.model.x,
                              found.columns[:len(problem.knobs)], known)
    found = found._replace(before=before, model=model, columns=columns,
                           library=Library(problem, before, knobs, without))
    return problem, found, judge.judged(problem, found, known)
