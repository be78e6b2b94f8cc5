# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Errors on data that took no part in a fit, beside Coulomb and viscous friction alone.

Measured and predicted torque pass through one zero-phase low-pass, below the frequencies at
which the smoothing of the acceleration shows: the error then is the model's, not the filter's.
"""

from gms_flex_control import records
from gms_flex_control.dynamics import chain
from gms_flex_control.friction import gms
from gms_flex_control.identification.coordinates import Coordinates, MOST_BLOCKS
from gms_flex_control.identification.result import HeldOut, Trace
from gms_flex_control.identification.smoothing import low_pass, low_pass_bandwidth
from gms_flex_control.identification.steady import friction_torque
from gms_flex_control.simulation import plant, predictor
import numpy as np

HORIZON = 0.5       # of a free simulation [s]
_STRIDE = 1.0       # from one start to the next [s]
_STANDING = 3.0     # encoder steps per 50 ms: slower is no motion for the simple model
_SMALL, _FAST = 1e-3, 10.0  # least friction, of the other way; speed [rad/s]
_LONGEST_TRACE = 20_000


def model_friction(objective, stretch, theta, period):
    """Return friction of the joint (T,) along the smoothed motion, further torques included."""
    angle = smooth_angle(stretch, period)
    tau = gms.replay(angle, stretch.rate, period, objective.friction(theta))[:, objective.joint]
    extra = objective.extra(stretch)
    return tau - extra @ theta[len(theta) - extra.shape[1]:]


def smooth_angle(stretch, period):
    """Return the angles (T, n) whose derivative is the smoothed rate."""
    steps = 0.5 * (stretch.rate[1:] + stretch.rate[:-1]) * period
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def coulomb_viscous(objective, stretches, arm, joint, step, chosen):
    """
    Fit Coulomb and viscous friction alone, each direction its own, by least squares.

    Parameters
    ----------
    objective : Objective
        For the further torques.
    stretches : sequence of Stretch
        The data.
    arm : ArmParams
        Inertia and gravity, the same as of the full model.
    joint : int
        Which joint.
    step : float
        Encoder step or noise [rad].
    chosen : callable
        Stretch -> bool (T,) of samples to fit.

    Returns
    -------
    ndarray, shape (4 + R,)
        Coulomb forward and backward [N m], viscous forward and backward [N m s/rad], and the
        coefficients of further torques.

    """
    rows, targets = [], []
    for stretch in stretches:
        rate = stretch.rate[:, joint]
        keep = chosen(stretch) & (np.abs(rate) > standing(step)) & stretch.tested[:, joint]
        columns = np.concatenate([simple_columns(rate), -objective.extra(stretch)], axis=1)
        rows.append(low_pass(columns, stretch.window)[keep])
        targets.append(low_pass(friction_torque(stretch, arm)[:, joint], stretch.window)[keep])
    fit, *_ = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)
    return fit


def standing(step):
    """Return the velocity below which nothing is said to move [rad/s]."""
    return _STANDING * step / 0.05


def simple_columns(rate):
    """Return the regressors (T, 4) of Coulomb and viscous friction."""
    forward, backward = rate > 0.0, rate < 0.0
    return np.stack([forward, -1.0 * backward, forward * rate, backward * rate], axis=1)


def simple_free(fit, displacement, n_extra):
    """
    Return Coulomb and viscous friction as Coordinates and free numbers.

    Its only block yields at ``displacement`` [rad].
    """
    coulomb = np.maximum(fit[:2], _SMALL * np.abs(fit[:2]).max())
    viscous = np.maximum(fit[2:4], 1e-3 * coulomb / _FAST)
    coordinates = Coordinates(1, n_extra=n_extra)
    free = coordinates.pack(coulomb * 1.001, coulomb, np.full(2, 1e-3), viscous,
                            coulomb.mean() / 0.01, [displacement], extra=fit[4:])
    return coordinates, free


def free_run_error(objective, bundle, theta, chosen):
    """
    Return the rms error of the link angle over free simulations of HORIZON.

    Parameters
    ----------
    objective : Objective
        Joint and the others' friction.
    bundle : Bundle
        The data.
    theta : ndarray
        Parameters of the joint.
    chosen : callable
        Stretch -> bool (T,); a simulation counts if all of its samples are chosen.

    Returns
    -------
    float
        [rad]; NaN if no piece is long enough.

    """
    horizon, stride = round(HORIZON / bundle.period), round(_STRIDE / bundle.period)
    links, joint, total, count = chain.constants_of(bundle.arm), objective.joint, 0.0, 0
    for stretch in bundle.stretches:
        samples, n = stretch.angle.shape
        first = stride
        starts = max((samples - 1 - horizon - first) // stride + 1, 0)
        keep = chosen(stretch) & stretch.tested[:, joint]
        if not starts or not keep.any():
            continue
        extra = objective.extra(stretch)
        predicted = np.empty((starts, horizon, n))
        blocks = gms.state_layout(n, MOST_BLOCKS)
        predictor.simulate_freely(
            np.ascontiguousarray(stretch.angle), np.ascontiguousarray(stretch.rate[0]),
            stretch.torque, extra, theta[len(theta) - extra.shape[1]:], bundle.period, links,
            objective.friction(theta), joint, bundle.observer_gains(), bundle.half, first,
            stride, horizon, records.build(blocks), records.build(blocks), plant.workspace(n),
            predicted)
        for start in range(starts):
            rows = slice(first + start * stride, first + start * stride + horizon)
            measured = stretch.angle[rows, joint]
            known = np.isfinite(measured) & keep[rows]
            if known.all():
                total += np.sum((predicted[start, :, joint] - measured) ** 2)
                count += horizon
    return float(np.sqrt(total / count)) if count else np.nan


def held_out_errors(objective, bundle, theta, simple, chosen, step, repeatability):
    """
    Return the HeldOut errors of one joint.

    Parameters
    ----------
    objective : Objective
        Joint and the others' friction.
    bundle : Bundle
        The data.
    theta : ndarray
        Parameters of the joint, fitted without the chosen samples.
    simple : ndarray
        Likewise, of Coulomb and viscous friction with one stiff block, see fit_choice.
    chosen : callable
        Stretch -> bool (T,) of the samples held out.
    step : float
        Encoder step or noise [rad].
    repeatability : float
        Of the torque [N m].

    Returns
    -------
    HeldOut

    """
    joint, period = objective.joint, bundle.period
    off, plain, torque, noise, innovations = [], [], [], [], []
    for stretch in bundle.stretches:
        keep = chosen(stretch) & stretch.tested[:, joint]
        if not keep.any():
            continue
        window = stretch.window
        innovations.append(objective.predict(stretch, theta, np.zeros((len(theta), 0)), 1.0)[1][
            keep, joint])
        keep &= moving(stretch, joint, step, bundle.half[joint])
        measured = friction_torque(stretch, bundle.arm)[:, joint]
        for errors, parameters in ((off, theta), (plain, simple)):
            model = model_friction(objective, stretch, parameters, period)
            errors.append(low_pass(measured - model, window)[keep])
        drive = stretch.torque + stretch.constant
        torque.append(low_pass(drive[:, joint], window)[keep])
        noise.append(torque_noise(stretch.torque[:, joint], window)[keep])
    off, plain, torque, noise, innovations = (
        np.concatenate(part) for part in (off, plain, torque, noise, innovations))
    usual = rms(torque)
    return HeldOut(
        torque_rms=rms(off), relative=rms(off) / usual, coulomb_viscous=rms(plain) / usual,
        free_run_rms=free_run_error(objective, bundle, theta, chosen),
        free_run_coulomb_viscous=free_run_error(objective, bundle, simple, chosen),
        horizon=HORIZON, innovation_rms=rms(innovations), noise_floor=rms(noise),
        repeatability=repeatability, bandwidth=low_pass_bandwidth(
            max(stretch.window for stretch in bundle.stretches), period))


def moving(stretch, joint, step, half):
    """
    Return where the motion of a joint tells its torque, bool (T,).

    Within one count of an encoder stiff blocks take up most of F_s: a motion seen through counts
    says nothing of the torque of a joint at rest. There the innovations judge.
    """
    if half == 0.0:
        return np.ones(len(stretch.rate), dtype=bool)
    return np.abs(stretch.rate[:, joint]) > standing(step)


def torque_noise(torque, window):
    """Return white noise of a torque (T,) like its own, behind the low-pass [N m]."""
    rough = np.diff(torque, 2, prepend=torque[:1], append=torque[-1:]) / np.sqrt(6.0)
    usual = rough[np.abs(rough) <= np.quantile(np.abs(rough), 0.99)]  # no jumps of the torque
    level = rms(usual)
    pulse = np.zeros(4 * window + 1)
    pulse[2 * window] = 1.0
    gain = np.sqrt(np.sum(low_pass(pulse, window) ** 2))
    return np.full(len(torque), level * gain)


def rms(values):
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def traces_of(objective, bundle, theta, chosen):
    """Return a Trace of each piece in which the joint is tested, thinned for drawing."""
    traces = []
    for stretch in bundle.stretches:
        keep = np.flatnonzero(stretch.tested[:, objective.joint])
        if not len(keep):
            continue
        thin = keep[::max(1, len(keep) // _LONGEST_TRACE)]
        model = low_pass(model_friction(objective, stretch, theta, bundle.period),
                         stretch.window)
        measured = low_pass(friction_torque(stretch, bundle.arm)[:, objective.joint],
                            stretch.window)
        traces.append(Trace(
            stretch.begin + bundle.period * thin, stretch.rate[thin, objective.joint],
            measured[thin], model[thin],
            chosen(stretch)[thin], stretch.source))
    return tuple(traces)
