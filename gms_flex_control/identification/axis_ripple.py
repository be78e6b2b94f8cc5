# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Ripple of a single axis: a torque periodic in its angle, as gears, screws and motors make.

It is no friction, but where it is as large as what tells presliding and the Stribeck curve apart
it takes the place of both. So it is looked for with the inertia, before friction is fitted.
"""

from typing import NamedTuple

from gms_flex_control.data.signals import derivative_window, smoothed, standing_out
from gms_flex_control.effects.catalogue.torque_ripple import TorqueRipple
from gms_flex_control.identification.held_out import model_friction
from gms_flex_control.identification.rigid_body import fit_axis
from gms_flex_control.identification.steady import friction_torque
from gms_flex_control.params.robot import EffectSpec
import numpy as np
from scipy.optimize import minimize_scalar

NAME = TorqueRipple.name
_FEWEST = 6.0      # waves in the range of angles: with fewer it may be gravity or friction
_MUCH = 0.1        # of the squares of what is left: a ripple below is not worth a word
_WORTH = 0.97      # of the error on data held out: a ripple that helps less is not there
_CLEAR = 3.0       # standard errors: likewise
_ROUNDS = 4        # of order and all else in turn
_ABOUT = 0.5       # of a wave over the range of angles: how far an order is looked for


class Ripple(NamedTuple):
    """A ripple of one axis: y += amplitude sin(order q + phase), pushing forward."""

    amplitude: float  # [N m]
    order: float      # [1/rad]
    phase: float      # [rad]
    amplitude_error: float  # standard errors of these
    order_error: float

    def effect(self, joint):
        """Return the EffectSpec that puts it into a model."""
        return EffectSpec(name=NAME, joint=joint, values=(self.amplitude, self.order, self.phase))


def fit_axis_with_ripple(recordings, rows, joint, name, source):
    """
    Fit an axis with the largest ripple that these data show.

    Parameters
    ----------
    recordings : sequence of Recording
        All data.
    rows : Rows
        Made of them.
    joint : int
        Which axis.
    name, source : str
        For messages.

    Returns
    -------
    axis : AxisFit
    ripple : Ripple or None
        None where none helps on data held out.

    Raises
    ------
    IdentificationError
        If the axis hardly moves.

    """
    axis, span = fit_axis(rows, name, source), float(np.ptp(rows.angle))
    orders = standing_out([rows.angle], [axis.left], [rows.rate],
                          2.0 * np.pi * _FEWEST / max(span, 1e-300))
    if not orders:
        return axis, None
    found, order = axis, orders[0]
    for _ in range(_ROUNDS):
        order = _nearest_best(recordings, joint, found.left + found.rippling, order, span)
        found = fit_axis(rows, name, source, waves_of(recordings, joint, order))
    size = float(np.hypot(*found.wave))
    if found.off > _WORTH * axis.off or size < _CLEAR * found.wave_error:
        return axis, None
    doubt = found.wave_error / size * np.sqrt(12.0) / span  # a line through the phase
    return found, Ripple(size, order, float(np.arctan2(-found.wave[1], -found.wave[0])),
                         found.wave_error, float(doubt))


def ripple_sentences(objective, bundle, theta, name):
    """
    Say whether a ripple is in what a fit leaves of a joint's torque.

    Parameters
    ----------
    objective : Objective
        Joint and the others' friction.
    bundle : Bundle
        The data.
    theta : ndarray
        Parameters of the joint.
    name : str
        Of the joint.

    Returns
    -------
    tuple of str
        A sentence, or none.

    """
    joint, parts = objective.joint, []
    for stretch in bundle.stretches:
        keep = stretch.tested[:, joint] & np.isfinite(stretch.angle[:, joint])
        if keep.any():
            left = friction_torque(stretch, bundle.arm)[:, joint] - model_friction(
                objective, stretch, theta, bundle.period)
            parts.append((stretch.angle[keep, joint], left[keep], stretch.rate[keep, joint]))
    angles, torques, rates = zip(*parts, strict=True)
    span = max(float(np.ptp(angle)) for angle in angles)
    orders = standing_out(angles, torques, rates, 2.0 * np.pi * _FEWEST / max(span, 1e-300))
    if not orders:
        return ()
    angle, torque = np.concatenate(angles), np.concatenate(torques)
    waves = np.stack([np.sin(orders[0] * angle), np.cos(orders[0] * angle)], axis=1)
    size = float(np.hypot(*np.linalg.lstsq(waves, torque, rcond=None)[0]))
    if 0.5 * size ** 2 < _MUCH * np.mean(torque ** 2):
        return ()
    return (f'A ripple of about {size:.2g} N m, {orders[0]:.4g} periods per revolution of {name}, '
            'is in what this model leaves of the torque. `gms_flex discrepancy` sizes it and adds '
            'it to the robot file; identified again with that file, friction is free of it',)


def _nearest_best(recordings, joint, torque, order, span):
    """Return the order near one that explains most of a torque (S,)."""
    moves = torque != 0.0
    target = torque[moves]

    def unexplained(trial):
        waves = waves_of(recordings, joint, trial)[moves]
        return np.sum((target - waves @ np.linalg.lstsq(waves, target, rcond=None)[0]) ** 2)
    reach = 2.0 * np.pi * _ABOUT / span
    return float(minimize_scalar(unexplained, bounds=(order - reach, order + reach),
                                 method='bounded', options={'xatol': 1e-3 * reach}).x)


def waves_of(recordings, joint, order):
    """Return sine and cosine of ``order`` times the angle, filtered as rows_of does, (S, 2)."""
    parts = []
    for recording in recordings:
        angle = recording.q_link[:, joint]
        signals = smoothed(recording.time, [np.sin(order * angle), np.cos(order * angle)],
                           derivative_window(recording.time, angle))
        parts.append(np.stack([signal.value for signal in signals], axis=1))
    return np.concatenate(parts)
