# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is left where no effect of the catalogue explains it: described, not named."""

from gms_flex_control.discrepancy.describe import torque_scale
from gms_flex_control.discrepancy.result import Signature
import numpy as np

_BINS = 24
_PERIODS = 8          # fewer in a recording are no tone
VARIABLES = ('time', 'link angle', 'motor angle', 'link rate', 'motor rate', 'torsion', 'torque',
             'link acceleration', 'time since reversal')


def variables(motion, j):
    """Return what a residual of joint ``j`` may depend on: dict of str to (S,)."""
    states = motion.states
    rate = states[:, 1, j]
    since = np.zeros(len(rate))
    for k in range(1, len(rate)):
        since[k] = 0.0 if rate[k] * rate[k - 1] < 0.0 else since[k - 1] + motion.period
    return dict(zip(VARIABLES, (
        motion.time - motion.time[0], states[:, 0, j], states[:, 3, j], rate, states[:, 4, j],
        states[:, 3, j] - states[:, 0, j], motion.drive[:, j], states[:, 2, j], since),
        strict=True))


def of_others(motion, j):
    """Return where the other joints are and how fast: dict of str to (S,)."""
    return {f'{name} of {joint}': motion.states[:, place, k]
            for k, joint in enumerate(motion.joints) if k != j
            for place, name in enumerate(('link angle', 'link rate'))}


def dependence(values, residual):
    """Return the share of a residual's (S,) variance that bins of values explain."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
    places = np.searchsorted(edges, values)
    count = np.maximum(np.bincount(places, minlength=_BINS), 1)
    means = np.bincount(places, weights=residual, minlength=_BINS) / count
    return float(np.sum(count * (means - residual.mean()) ** 2)
                 / max(np.sum((residual - residual.mean()) ** 2), 1e-300))


def tone(rows, period):
    """Return frequency [Hz] and share of power of the strongest line of a residual (S,)."""
    power = np.abs(np.fft.rfft((rows - rows.mean()) * np.hanning(len(rows)))) ** 2
    k = int(np.argmax(power[1:])) + 1
    near = power[max(k - 2, 1):k + 3].sum()
    return k / (len(rows) * period), float(near / max(power.sum(), 1e-300))


def signature_of(likelihood, model, share, free=None):
    """
    Return the Signature of what a model leaves, in the equation in which it leaves most.

    Parameters
    ----------
    likelihood : Likelihood
        Of the recordings.
    model : Fitted
        With all that was found.
    share : float
        How much of what was missing is left.
    free : Free, optional
        The function of one variable that explains most of it.

    Returns
    -------
    Signature

    """
    joints, n = likelihood.robot.joints, likelihood.robot.n_joints
    if free is not None:
        scale, variable = torque_scale(free.torque), free.variable
        column = joints.index(free.joint) + n * (free.equation == 'motor')
        left = np.concatenate([one[:, column] for one in likelihood.torque(model)])
        if variable == 'time' and np.mean(left) ** 2 > 0.5 * np.mean(left ** 2):
            variable = 'constant'
        return Signature(
            float(share), free.equation, free.joint, variable,
            f'{scale.text(free.torque)} {scale.unit} rms in the {free.equation} equation of '
            f'{free.joint} are '
            + ('constant.' if variable == 'constant' else f'a function of {variable}.'))
    channel = int(np.argmax(likelihood.excess_torque(model) / np.tile(likelihood.coulomb, 2)))
    equation, j = ('link', channel) if channel < n else ('motor', channel - n)
    squares = [np.mean(left[:, channel] ** 2) for left in likelihood.torque(model)]
    worst = int(np.argmax(squares))
    motion, whitening = likelihood.motions[worst], likelihood.whitenings[worst]
    residual = likelihood.torque(model)[worst][:, channel]
    at = np.clip(np.searchsorted(motion.time - motion.time[0], whitening.time), 0,
                 len(motion.time) - 1)
    shares = {name: dependence(values[at], residual)
              for name, values in (variables(motion, j) | of_others(motion, j)).items()}
    variable = max(shares, key=shares.get)
    frequency, line = tone(residual, whitening.row_period)
    rms = float(np.sqrt(np.mean(residual ** 2)))
    scale = torque_scale(rms)
    text = (f'{scale.text(rms)} {scale.unit} rms are left in the {equation} equation of '
            f'{joints[j]}')
    if np.mean(residual) ** 2 > 0.5 * rms ** 2:
        text += ', most of it constant'
        variable = 'constant'
    elif line > 0.5 and frequency * len(residual) * whitening.row_period > _PERIODS:
        text += f', most of it a tone of {frequency:.2f} Hz'
        variable = 'time'
    elif shares[variable] > 0.2:
        text += f', {100 * shares[variable]:.0f} % of it a function of {variable}'
    else:
        text += ', which follows none of position, speed, torsion, torque or time alone'
        variable = ''
    return Signature(float(share), equation, joints[j], variable, text + '.')
