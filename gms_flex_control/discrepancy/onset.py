# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Whether what looks like a drift grows with time, or sets in at a moment.

Of all that changes with time the catalogue knows what grows evenly. A change from one moment to
the next resembles it, and is none of it.
"""

from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.search import LEAST_GAIN
from gms_flex_control.effects.registry import find
import numpy as np

_MOMENTS = 15         # at which a change is tried, evenly over a recording


def steady(problem, found, entries):
    """
    Return the effects that may be named, and what is said of those that may not.

    Parameters
    ----------
    problem : Problem
        The rows.
    found : Found
        Of the search.
    entries : list of Judged
        Its effects, the heaviest first.

    Returns
    -------
    list of Judged
        Without drifts that are sudden; none if the heaviest is: the others were found beside it.
    str
        A sentence for each sudden one, '' if there is none.

    """
    kept, words = [], []
    for one in entries:
        spec, moment = found.model.robot.effects[one.index], onset(problem, found, one)
        if moment is None:
            kept.append(one)
        else:
            words.append(f'What resembles {spec.name} of {spec.joint} sets in about '
                         f'{moment:.0f} s after the beginning and does not grow evenly.')
    return (kept if kept[:1] == entries[:1] else []), ' '.join(words)


def onset(problem, found, one):
    """
    Return the moment [s] at which an effect sets in, None if it grows with time or has no time.

    The torque of a drift is ``b(t) t``, along this motion. A change at ``t0`` has ``b(t)`` from
    there on. It is one if, all else re-tuned, it explains more.
    """
    if find(found.model.robot.effects[one.index].name).evidence != 'time':
        return None
    others = np.linalg.qr(one.others[:, problem.fitted].T)[0]

    def own(rows):
        """Return what nothing else can make of rows (R,)."""
        used = rows[problem.fitted]
        return used - others @ (others.T @ used)

    missing = own(one.less.rows)

    def gain(course):
        """Return what a torque would explain that is ``b(t)`` times a course of time."""
        rows = own(problem.rows_of(
            [base * course(path.time)[:, None] for base, path in zip(bases, problem.paths,
                                                                     strict=True)]))
        return float(rows @ missing) ** 2 / max(float(rows @ rows), 1e-300)

    with_it, without = (problem.constants(model.robot, found.model.x)
                        for model in (found.model, one.less))
    bases = [(unexplained(path, without) - unexplained(path, with_it))
             / np.maximum(path.time, path.period)[:, None] for path in problem.paths]
    ends = max(path.time[-1] for path in problem.paths)
    moments = np.linspace(0.0, ends, _MOMENTS + 2)[1:-1]
    gains = [gain(lambda time, at=at: (time > at).astype(float)) for at in moments]
    best = int(np.argmax(gains))
    sudden = gains[best] > gain(lambda time: time) + LEAST_GAIN
    return float(moments[best]) if sudden else None
