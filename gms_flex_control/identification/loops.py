# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Presliding motion in the data: how far it reaches, and its hysteresis loops (Fig. 4)."""

from gms_flex_control.dynamics.chain import inverse_dynamics
from gms_flex_control.identification.result import Loop
import numpy as np

PRESLIDING = 'presliding'
_MOST_LOOPS, _LONGEST_LOOP = 6, 4000
_SHORTEST = 1.0       # of a loop that is shown [s]
_LOADED = 0.98        # of F_s: presliding is what stays below


def standing_torque(stretch, arm):
    """
    Return the torque that friction holds at rest, shape (T, n_joints) [N m].

    In presliding the links accelerate too little to tell it from the encoders' steps.
    """
    still = np.zeros_like(stretch.rate)
    return stretch.torque - inverse_dynamics(np.nan_to_num(stretch.angle), still, still, arm)


def presliding_pieces(stretch, joint, static, torque, period):
    """
    Yield slices of a stretch in which the joint is in presliding.

    Parameters
    ----------
    stretch : Stretch
        The data; its phases where they are known.
    joint : int
        Which joint.
    static : float
        F_s of the weaker direction [N m].
    torque : ndarray, shape (T,)
        Friction torque of the joint [N m].
    period : float
        Sample [s].

    """
    if (stretch.phase != '').any():
        inside = (stretch.phase == PRESLIDING) & stretch.tested[:, joint]
    else:  # friction below break-away for a while
        width = max(round(_SHORTEST / period), 1)
        loaded = np.convolve(np.abs(torque) > _LOADED * static, np.ones(width), 'same') > 0.5
        inside = ~loaded
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if (end - begin) * period >= _SHORTEST:
            yield slice(begin, end)


def presliding_reach(bundle, joint, theta):
    """Return how far the joint went in one piece of presliding, at most [rad]."""
    reach = 0.0
    for stretch in bundle.stretches:
        torque = standing_torque(stretch, bundle.arm)[:, joint]
        for rows in presliding_pieces(stretch, joint, min(theta[[0, 4]]), torque, bundle.period):
            angle = stretch.angle[rows, joint]
            reach = max(reach, float(np.nanmax(angle) - np.nanmin(angle)))
    return reach


def loops_of(objective, bundle, theta):
    """
    Return the Loops of the joint with the widest displacement.

    Parameters
    ----------
    objective : Objective
        Joint and the others' friction.
    bundle : Bundle
        The data.
    theta : ndarray
        Parameters of the joint.

    Returns
    -------
    tuple of Loop
        At most six, long ones thinned.

    """
    joint, loops = objective.joint, []
    none = np.zeros((len(theta), 0))
    for stretch in bundle.stretches:
        torque = standing_torque(stretch, bundle.arm)[:, joint]
        pieces = list(presliding_pieces(stretch, joint, min(theta[[0, 4]]), torque,
                                        bundle.period))
        if not pieces:
            continue
        predicted = objective.predict(stretch, theta, none, 1.0)[0][:, joint]
        for rows in pieces:
            thin = slice(rows.start, rows.stop, max(1, (rows.stop - rows.start) // _LONGEST_LOOP))
            origin = np.nanmean(stretch.angle[rows, joint])
            loops.append(Loop(
                stretch.angle[thin, joint] - origin, torque[thin], predicted[thin] - origin,
                f'{stretch.source}, {stretch.begin + rows.start * bundle.period:.1f} s'))
    loops.sort(key=lambda loop: -np.nanmax(np.abs(loop.torque)))
    return tuple(loops[:_MOST_LOOPS])
