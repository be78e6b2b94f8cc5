# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Peers of the workflow on the same library: sparse regression, and forward selection by R^2.

Both get what the workflow's first scan has: whitened residuals, weighted by their noise, and for
every guess of every effect what it would change of them, the known parameters re-tuned in all.
What they lack is what comes after: evidence, fits of the effects themselves, held-out data.
"""

from importlib.util import find_spec

import numpy as np

FORWARD, SPARSE = 'forward R^2', 'sparse regression'
NO_PYSINDY = ('sparse regression is skipped: pysindy is not installed; '
              "pip install '.[peers]'")
_LEAST_R2 = 0.01        # that a further effect must explain
_MOST = 8
_THRESHOLD, _RIDGE = 0.1, 0.05  # of coefficients of columns scaled to unit length


def can_regress():
    """Return whether PySINDy is installed."""
    return find_spec('pysindy') is not None


def names():
    """Return the names of the peers that can be asked, tuple of str."""
    return (FORWARD, SPARSE) if can_regress() else (FORWARD,)


def ask(case, without=()):
    """
    Return what the peers name in a Case, the strongest first: peer -> [(effect, joint), ...].

    Effects ``without`` are left out of the library; without PySINDy only the forward selection
    answers.
    """
    names, groups, triangle, target = library_of(case, without)
    answers = {FORWARD: forward(names, groups, triangle, target)}
    if can_regress():
        answers[SPARSE] = sparse(names, groups, triangle, target)
    return answers


def library_of(case, without):
    """
    Return the regression problem, rows reduced to as many as columns.

    Names (effect, joint) of the guesses, their columns (slices), the triangle (C + 1, C) of
    columns scaled to unit length, what the known parameters explain taken out, and the residual
    likewise.
    """
    from gms_flex_control.discrepancy.dictionary import Dictionary
    from gms_flex_control.discrepancy.fitting import retuned
    from gms_flex_control.discrepancy.likelihood import Likelihood
    from gms_flex_control.discrepancy.motion import motion_of

    likelihood = Likelihood([motion_of(case.recording, case.nominal)], case.nominal)
    model, own = retuned(likelihood, case.nominal, np.zeros(len(likelihood.nuisances)))
    dictionary = Dictionary(likelihood, model, without)
    root = np.sqrt(likelihood.weights(model.sums.groups))
    basis, _ = np.linalg.qr((own * root).T)
    columns = np.concatenate([dictionary.derivatives, -model.whitened[None]]) * root
    columns = columns - (columns @ basis) @ basis.T
    length = np.linalg.norm(columns, axis=1, keepdims=True)
    columns = columns / np.where(length > 0.0, length, 1.0)
    small = np.linalg.qr(columns.T, mode='r')
    ends = np.cumsum([0, *(len(guess.probes) for _, _, guess in dictionary.guesses)])
    groups = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return ([(name, joint) for name, joint, _ in dictionary.guesses], groups, small[:, :-1],
            small[:, -1])


def forward(names, groups, columns, target):
    """Return the (effect, joint) that forward selection by R^2 takes, in its order."""
    taken, left, columns = [], target.copy(), columns.copy()
    while len(taken) < _MOST:
        gains = [gain_of(columns[:, group], left) for group in groups]
        best = int(np.argmax(gains))
        if gains[best] < _LEAST_R2 * (target @ target):
            break
        if names[best] not in taken:
            taken.append(names[best])
        basis = span_of(columns[:, groups[best]])
        left = left - basis @ (basis.T @ left)
        columns = columns - basis @ (basis.T @ columns)
    return taken


def span_of(columns):
    """Return an orthonormal basis (R, k) of columns (R, c), what is nearly nothing left out."""
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return basis[:, sizes > 1e-4]


def gain_of(columns, left):
    """Return the sum of squares of ``left`` (R,) that columns (R, c) explain."""
    along = span_of(columns).T @ left
    return float(along @ along)


def sparse(names, groups, columns, target):
    """Return the (effect, joint) that PySINDy's thresholded least squares keeps, largest first."""
    from pysindy import STLSQ
    fit = STLSQ(threshold=_THRESHOLD, alpha=_RIDGE).fit(columns, target[:, None])
    weight = np.abs(np.ravel(fit.coef_))
    largest = {}
    for name, group in zip(names, groups, strict=True):
        largest[name] = max(largest.get(name, 0.0), float(weight[group].max()))
    return sorted((name for name, size in largest.items() if size > 0.0),
                  key=lambda name: -largest[name])
