# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What is left where no effect of the catalogue explains it: described, not named."""

from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.discrepancy.result import Signature
from gms_flex_control.discrepancy.units import torque_scale
import numpy as np

_BINS = 24
_PERIODS = 8          # fewer in a recording are no tone
VARIABLES = ('time', 'link angle', 'motor angle', 'link rate', 'motor rate', 'twist', 'torque',
             'link acceleration', 'time since reversal')


def variables(path, j):
    """Return what a residual of joint ``j`` may depend on: dict of str to (S,)."""
    motion = path.motion
    rate = motion[:, 1, j]
    since = np.zeros(len(rate))
    for k in range(1, len(rate)):
        since[k] = 0.0 if rate[k] * rate[k - 1] < 0.0 else since[k - 1] + path.period
    return dict(zip(VARIABLES, (
        path.time - path.time[0], motion[:, 0, j], motion[:, 3, j], rate, motion[:, 4, j],
        motion[:, 3, j] - motion[:, 0, j], path.drive[:, j], motion[:, 2, j], since),
        strict=True))


def of_others(path, j):
    """Return where the other joints are and how fast: dict of str to (S,)."""
    return {f'{name} of {joint}': path.motion[:, place, k]
            for k, joint in enumerate(path.joints) if k != j
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


def signature_of(problem, model, share):
    """
    Return the Signature of what a model leaves in the recording in which it leaves most.

    Parameters
    ----------
    problem : Problem
        The rows.
    model : Fitted
        The model.
    share : float
        How much of what was missing is left.

    Returns
    -------
    Signature

    """
    n, shapes = problem.robot.n_joints, [one.scale.shape for one in problem.whitenings]
    parts = np.split(model.rows, np.cumsum([np.prod(shape) for shape in shapes]))[:-1]
    squares = [np.mean(part.reshape(shape) ** 2, axis=0)
               for part, shape in zip(parts, shapes, strict=True)]
    worst = int(np.argmax([one.max() for one in squares]))
    path, whitening = problem.paths[worst], problem.whitenings[worst]
    channel = int(np.argmax(squares[worst]))
    equation, j = ('link', channel) if channel < n else ('motor', channel - n)
    residual = whitening.torque_rows(unexplained(path, problem.constants(
        model.robot, model.x)))[:, channel]
    at = np.clip(np.searchsorted(path.time - path.time[0], whitening.time), 0,
                 len(path.time) - 1)
    shares = {name: dependence(values[at], residual)
              for name, values in (variables(path, j) | of_others(path, j)).items()}
    variable = max(shares, key=shares.get)
    frequency, line = tone(residual, whitening.row_period)
    rms = float(np.sqrt(np.mean(residual ** 2)))
    joint = problem.robot.joints[j]
    scale = torque_scale(rms)
    text = (f'{scale.told(rms)} {scale.unit} rms are left in the {equation} equation of '
            f'{joint}')
    if np.mean(residual) ** 2 > 0.5 * rms ** 2:
        text += ', most of it constant'
        variable = 'constant'
    elif line > 0.5 and frequency * len(residual) * whitening.row_period > _PERIODS:
        text += f', most of it a tone of {frequency:.2f} Hz'
        variable = 'time'
    elif shares[variable] > 0.2:
        text += f', {100 * shares[variable]:.0f} % of it a function of {variable}'
    else:
        text += ', which follows none of position, speed, twist, torque or time alone'
    return Signature(float(share), equation, joint, variable, text + '.')
