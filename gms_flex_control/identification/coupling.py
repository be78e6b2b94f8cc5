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


def coupling_sentences(objective, bundle, theta, names, chosen):
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

    Returns
    -------
    tuple of str
        A sentence, or none.

    Notes
    -----
    Least squares of the residual on accelerations of the others and on cosines and sines of
    their angles and of the sums with its own, as inertia and gravity of a chain have them; the
    share it accounts for is that of data it was not fitted to.

    """
    joint = objective.joint
    others = [k for k in range(len(names)) if k != joint]
    if bundle.arm.kind != 'decoupled' or not others:
        return ()
    left, columns, torque, out = [], [], [], []
    for stretch in bundle.stretches:
        keep = stretch.tested[:, joint] & np.isfinite(stretch.angle).all(axis=1)
        residual = friction_torque(stretch, bundle.arm)[:, joint] - model_friction(
            objective, stretch, theta, bundle.period)
        left.append(low_pass(residual, stretch.window)[keep])
        columns.append(_columns(stretch, joint, others)[keep])
        torque.append(stretch.torque[keep, joint])
        out.append(chosen(stretch)[keep])
    left, columns, torque, out = map(np.concatenate, (left, columns, torque, out))
    if out.sum() < 2 * columns.shape[1] or (~out).sum() < 2 * columns.shape[1]:
        return ()
    fit = np.linalg.lstsq(columns[~out], left[~out], rcond=1e-9)[0]
    before, after = rms(left[out]), rms(left[out] - columns[out] @ fit)
    share = 1.0 - (after / max(before, 1e-300)) ** 2
    if share < _SHARE or before < _WORTH * rms(torque):
        return ()
    return (f'{100 * share:.0f} % of what this model leaves of the torque of {names[joint]} goes '
            f'with the motion of {", ".join(names[k] for k in others)}: the axes act on each '
            'other (inertia, gravity), which a model of single axes lacks, so inertia, gravity '
            'and friction hold for this motion only; move one axis at a time, or describe the '
            'links as a planar arm',)


def _columns(stretch, joint, others):
    """Return what inertia and gravity of other links make of the motion, shape (T, 1 + 5 O)."""
    own, columns = np.nan_to_num(stretch.angle[:, joint]), [np.ones(len(stretch.angle))]
    for k in others:
        angle = np.nan_to_num(stretch.angle[:, k])
        columns += [stretch.acceleration[:, k], np.cos(angle), np.sin(angle),
                    np.cos(own + angle), np.sin(own + angle)]
    return low_pass(np.stack(columns, axis=1), stretch.window)
