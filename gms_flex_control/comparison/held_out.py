# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Friction models fitted to the first part of a recording and judged on the rest."""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.bags.reader import read_recording
from gms_flex_control.comparison.along import adapted, along, predicted
from gms_flex_control.comparison.contestants import CONTESTANTS
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.smoothing import low_pass
import numpy as np
from scipy.optimize import least_squares

# whether parameters are fitted, beginning at the friction of the robot's file
FITTED = {'none': False, 'stribeck': True, 'lugre': True, 'gms_paper': True, 'gms': True,
          'gms_desired': True, 'disturbance_observer': False, 'gms_adaptive': True}
NEEDS_REFERENCE = ('gms', 'gms_desired')
REMARKS = {'disturbance_observer': 'sees the torque that it predicts, late',
           'gms_adaptive': 'goes on adapting to the torque error while it is judged'}
_MOST_FIT = 40_000   # samples of a fit
_LEAST_SHARE = 0.05  # static above Coulomb friction, and viscous at v_s, where a fit begins
_BOUND = 3.0         # of the logarithm of what a fit scales


class Prediction(NamedTuple):
    """One compensation along a recording."""

    mode: str
    name: str
    torque: tuple     # of (T, n) per piece, behind the low-pass [N m]; empty where not asked
    error: list       # rms on the held-out part per joint [N m]; None where not asked
    fitted: list      # rms on the fitted part per joint [N m]
    remark: str


def split(pieces, share):
    """
    Return which samples are fitted.

    Parameters
    ----------
    pieces : sequence of Piece
        The recording.
    share : float
        Of its time from the beginning.

    Returns
    -------
    list of ndarray of bool, shape (T,)

    """
    begin, end = pieces[0].time[0], pieces[-1].time[-1]
    masks = [one.time < begin + share * (end - begin) for one in pieces]
    counts = sum(mask.sum() for mask in masks), sum((~mask).sum() for mask in masks)
    if min(counts) < 2 * max(one.window for one in pieces):
        raise IdentificationError(
            f'--fit {share:g}: leaves {counts[0]} samples to fit and {counts[1]} to judge, too '
            'few of one; record longer or divide in another place')
    return masks


class FitItem(NamedTuple):
    """One compensation to be fitted to a bag: an item of a batch."""

    path: str
    motors: tuple
    robot: object    # RobotParams
    gains: object    # ControllerParams
    share: float     # of the bag's time
    mode: str


def read_along(path, motors, robot):
    """Return a bag as `along.Along`; a recording without enough of it raises."""
    return along(read_recording(path, robot.joints, motors), robot)


def fit_item(item):
    """Return what `fit` finds for a FitItem, a list."""
    found = read_along(item.path, item.motors, item.robot)
    return fit(found, item.gains, item.mode, split(found.pieces, item.share)).ravel().tolist()


def modes_to_fit(has_reference):
    """Return the compensations that are fitted to a recording with or without reference."""
    return [mode for mode, fitted in FITTED.items()
            if fitted and mode != 'gms_adaptive' and (has_reference or not _lacks(mode))]


def _lacks(mode):
    return mode in NEEDS_REFERENCE


def compare_along(found, gains, share, fits):
    """
    Predict the friction torque of a recording with every compensation.

    Parameters
    ----------
    found : Along
        The recording.
    gains : ControllerParams
        Of the compensations' filters and slopes.
    share : float
        Of the recording that was fitted.
    fits : dict of str to ndarray
        What `fit` found, by `modes_to_fit`.

    Returns
    -------
    list of Prediction

    """
    masks, result = split(found.pieces, share), []
    for mode, name in CONTESTANTS.items():
        if _lacks(mode) and not found.has_reference:
            result.append(Prediction(mode, name, (), None, None, 'the bag has no reference'))
            continue
        robot, of = found.robot, 'gms_paper' if mode == 'gms_adaptive' else mode
        if FITTED[mode]:
            x = np.asarray(fits[of]).reshape(10, robot.n_joints)
            robot = replace(robot, friction=scaled(robot.friction, x))
        torque = _torques(found, robot, gains, mode)
        result.append(Prediction(
            mode, name, torque, _rms(found, torque, [~mask for mask in masks]),
            _rms(found, torque, masks), REMARKS.get(mode, '')))
    return result


def _torques(found, robot, gains, mode):
    factor = np.ones(robot.friction.stiffness.shape)
    return tuple(low_pass(
        adapted(one, robot, factor) if mode == 'gms_adaptive' else predicted(
            one, robot, gains, mode), one.window) for one in found.pieces)


def _rms(found, torques, masks):
    errors = np.concatenate([(torque - one.friction)[mask] for torque, one, mask in zip(
        torques, found.pieces, masks, strict=True)])
    return np.sqrt(np.mean(errors ** 2, axis=0)).tolist()


def scaled(friction, x):
    """
    Return friction with what a fit changes.

    Parameters
    ----------
    friction : FrictionParams
        Where it begins.
    x : ndarray, shape (10, n)
        Logarithms of factors: Coulomb level, static above it, Stribeck velocity and viscous of
        forward, then of backward motion; stiffness of all blocks; attraction.

    Returns
    -------
    FrictionParams

    """
    def way(steady, x):
        above = np.maximum(steady.static / steady.coulomb - 1.0, _LEAST_SHARE)
        coulomb = steady.coulomb * np.exp(x[0])
        viscous = np.maximum(steady.viscous, _LEAST_SHARE * steady.coulomb)
        return replace(steady, coulomb=coulomb, static=coulomb * (1.0 + above * np.exp(x[1])),
                       velocity=steady.velocity * np.exp(x[2]), viscous=viscous * np.exp(x[3]))

    return replace(friction, forward=way(friction.forward, x[:4]),
                   backward=way(friction.backward, x[4:8]),
                   stiffness=friction.stiffness * np.exp(x[8])[:, None],
                   attraction=friction.attraction * np.exp(x[9]))


def fit(found, gains, mode, masks):
    """
    Return the change of friction with which a compensation fits the first part best.

    Parameters
    ----------
    found : Along
        The recording.
    gains : ControllerParams
        Of filters and slopes.
    mode : str
        The compensation, driven by the recorded motion.
    masks : list of ndarray of bool
        What is fitted, from `split`.

    Returns
    -------
    ndarray, shape (10, n)
        For `scaled`.

    Notes
    -----
    Joints do not act on each other here, so one step of the derivative serves all of them. The
    filters at the end of a piece see a little of what is held out: half a window of it.

    """
    n = found.robot.n_joints
    used = [(one, mask) for one, mask in zip(found.pieces, masks, strict=True) if mask.any()]
    thin = max(1, sum(mask.sum() for _, mask in used) // _MOST_FIT)
    size = np.maximum(np.sqrt(np.mean(np.concatenate(
        [one.friction[mask] for one, mask in used]) ** 2, axis=0)), 1e-12)

    def errors(x):
        robot = replace(found.robot, friction=scaled(found.robot.friction, x.reshape(10, n)))
        parts = [(low_pass(predicted(one, robot, gains, mode), one.window) - one.friction)[mask]
                 for one, mask in used]
        return np.concatenate(parts)[::thin] / size

    def jacobian(x):
        base, step = errors(x), 1e-4
        columns = np.zeros((*base.shape, 10, n))
        for k in range(10):
            moved = x.reshape(10, n).copy()
            moved[k] += step
            change = (errors(moved.ravel()) - base) / step
            for j in range(n):
                columns[:, j, k, j] = change[:, j]
        return columns.reshape(base.size, 10 * n)

    best = least_squares(lambda x: errors(x).ravel(), np.zeros(10 * n), jacobian,
                         bounds=(-_BOUND, _BOUND), max_nfev=25)
    return best.x.reshape(10, n)
