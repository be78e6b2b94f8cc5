# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Axes taken one by one that act on each other: what a fit leaves that goes with other axes."""

from gms_flex_control.identification.held_out import model_friction, rms
from gms_flex_control.identification.smoothing import low_pass
from gms_flex_control.identification.steady import friction_torque
import numpy as np

_SHARE = 0.25         # of what is left, on data held out, that others must account for
_WORTH = 0.02         # of the drive torque that must be left
_FEWEST = 100         # samples to fit and to judge by
_OWN, _SLOW = 6, 0.05  # columns of the axis itself; speed, of the usual, where its sign is clear


def coupling_sentences(objective, bundle, theta, names, chosen, apart=()):
    """
    Say whether other axes account for what the model leaves of a joint's torque.

    Parameters
    ----------
    objective : Objective
        Joint and the others' friction.
    bundle : Bundle
        The data; only of decoupled axes something is said.
    theta : ndarray
        Parameters of the joint.
    names : sequence of str
        Of the joints.
    chosen : callable
        Stretch -> bool (T,) of the samples held out.
    apart : sequence of Stretch
        Of recordings held out whole; they judge where there are any.

    Returns
    -------
    tuple of str
        A sentence, or none.

    Notes
    -----
    Least squares of the residual on the axis' own motion (what the others do had its share in what
    was fitted) and on the accelerations of the others, alone or with what their angles do to
    inertia; the share they account for is that of data they were not fitted to.
    Gravity of a chain would need many more columns, which short recordings do not tell apart.

    """
    joint = objective.joint
    others = [k for k in range(len(names)) if k != joint]
    if bundle.arm.kind != 'decoupled' or not others:
        return ()
    parts = [_left(objective, bundle, theta, stretch, others)
             for stretch in (*bundle.stretches, *apart)]
    out = [chosen(stretch) & (not apart) for stretch in bundle.stretches]
    out += [np.ones(len(stretch.angle), dtype=bool) for stretch in apart]
    kept = [part[2] for part in parts]
    left, columns, torque, out = (
        np.concatenate([values[keep] for values, keep in zip(group, kept, strict=True)])
        for group in ([part[0] for part in parts], [part[1] for part in parts],
                      [stretch.torque[:, joint] for stretch in (*bundle.stretches, *apart)], out))
    if min(out.sum(), (~out).sum()) < _FEWEST:
        return ()
    share = max(_share(left, columns[:, :width], out)
                for width in (_OWN + len(others), columns.shape[1]))
    if share < _SHARE or rms(left[out]) < _WORTH * rms(torque[out]):
        return ()
    return (f'{100 * share:.0f} % of what this model leaves of the torque of {names[joint]} goes '
            f'with the motion of {", ".join(names[k] for k in others)}: the axes act on each '
            'other (inertia, gravity), which a model of single axes lacks, so inertia, gravity '
            'and friction hold for this motion only; move one axis at a time, or describe the '
            'links as a planar arm or by a URDF whose masses are right',)


def _left(objective, bundle, theta, stretch, others):
    """Return what is left of the torque (T,), columns of the others, and where both count."""
    joint = objective.joint
    residual = friction_torque(stretch, bundle.arm)[:, joint] - model_friction(
        objective, stretch, theta, bundle.period)
    bend, cosine = stretch.acceleration, np.cos(np.nan_to_num(stretch.angle[:, others]))
    rate, angle = stretch.rate[:, joint], np.nan_to_num(stretch.angle[:, joint])
    own = [np.ones(len(rate)), bend[:, joint], rate, np.tanh(rate / (_SLOW * rms(rate) + 1e-12)),
           np.cos(angle), np.sin(angle)]
    columns = np.concatenate([np.stack(own, axis=1), bend[:, others], bend[:, others] * cosine,
                              bend[:, [joint]] * cosine], axis=1)
    keep = stretch.tested[:, joint] & np.isfinite(stretch.angle).all(axis=1)
    return low_pass(residual, stretch.window), low_pass(columns, stretch.window), keep


def _share(left, columns, out):
    """Return how much of the square of ``left`` others account for, beyond the axis itself."""
    rests = []
    for width in (0, _OWN, columns.shape[1]):
        part = columns[:, :width]
        fit = np.linalg.lstsq(part[~out], left[~out], rcond=1e-9)[0]
        rests.append(rms(left[out] - part[out] @ fit))
    return 1.0 - (rests[2] / max(min(rests[:2]), 1e-300)) ** 2
