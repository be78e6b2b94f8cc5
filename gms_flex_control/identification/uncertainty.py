# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
How far each parameter can be trusted: two kinds of intervals, and flags.

From the Jacobian: the inverse of the curvature, larger by as many samples as an innovation
remembers. From a bootstrap: blocks of time drawn again with replacement, one Gauss-Newton step
each. The first believes that innovations are noise of that memory, the second only that blocks
are alike; where they disagree, something in the data repeats that the model lacks. Both are
widened by what fits from beside each other differ, and by what a fit moves when only every
other sample is used: no statistics of the innovations show that.
"""

from typing import NamedTuple

from gms_flex_control.identification.coordinates import MOST_BLOCKS, presliding_curve
from gms_flex_control.identification.refine import summed
from gms_flex_control.identification.result import CONFIDENT, Estimate, Interval
from gms_flex_control.simulation.predictor import BLOCKS, PER_DIRECTION, STATIC
import numpy as np

REPLICATES = 400
_LOW, _HIGH = 2.5, 97.5
_VAGUE = np.log(2.0)    # half an interval this wide in the logarithm tells nothing
_FARTHEST = 5.0         # step of a replicate in the logarithm: beyond nothing is known anyway
_DISAGREE = 2.5         # ratio of widths of the two intervals
_NOTHING = 2e-3         # of the friction level: a part this small is at its bound
_BEYOND = 3.0           # times the reach of presliding: a block that slips later is none of it
_LONGEST_MEMORY = 2.0   # of an innovation that is looked for [s]
_NAMES = ('static', 'coulomb', 'velocity', 'viscous')
_UNITS = ('N m', 'N m', 'rad/s', 'N m s/rad')
_TELLS = {
    'static': 'motion slower than v_s and break-away from rest tell it',
    'coulomb': 'steady motion well above v_s tells it',
    'velocity': 'steady velocities between rest and the flat part of the curve tell it',
    'viscous': 'faster motion tells it',
    'attraction': 'velocity that varies within a second around v_s tells it',
    'stiffness': 'slow torque ramps below break-away, with small loops, tell it',
}


class Spread(NamedTuple):
    """Uncertainty of free numbers."""

    covariance: np.ndarray  # (P, P), from the Jacobian
    replicates: np.ndarray  # (REPLICATES, P), from the bootstrap
    told: np.ndarray        # (P,), share of each number that the data tell, the rest is prior


class Drawn(NamedTuple):
    """Blocks of time drawn again and again, and what each block says of the free numbers."""

    times: np.ndarray      # (R, B) int, how often each block was drawn for each replicate
    scores: np.ndarray     # (B, P), about their mean
    curvature: np.ndarray  # (B, P, P)
    precision: np.ndarray  # (P,), of the prior


def draw(evaluation, prior, rng):
    """
    Return what all replicates of a fit are made of, so that they can be made anywhere.

    Parameters
    ----------
    evaluation, prior
        Of the fit, at its minimum.
    rng : numpy.random.Generator
        Draws the blocks.

    Returns
    -------
    Drawn

    """
    scores = evaluation.weight[:, None] * evaluation.gradient
    blocks = len(scores)
    times = np.stack([np.bincount(rng.integers(blocks, size=blocks), minlength=blocks)
                      for _ in range(REPLICATES)])
    return Drawn(times, scores - scores.mean(axis=0),
                 evaluation.weight[:, None, None] * evaluation.curvature, prior.precision)


def steps_of(drawn):
    """Return the Gauss-Newton step (R, P) of each replicate of a Drawn."""
    steps = np.empty((len(drawn.times), len(drawn.precision)))
    for row, times in zip(steps, drawn.times, strict=True):
        again = np.tensordot(times, drawn.curvature, 1) + np.diag(drawn.precision)
        row[:] = np.clip(_inverse(again) @ (times @ drawn.scores), -_FARTHEST, _FARTHEST)
    return steps


def spread_of(objective, coordinates, free, evaluation, prior, sampling, rng, steps):
    """
    Return the Spread of a fit.

    Parameters
    ----------
    objective, coordinates, free, evaluation, prior
        Of the fit, at its minimum.
    sampling : ndarray, shape (P,)
        What the numbers move by from fit to fit, see default_method.
    rng : numpy.random.Generator
        The one that drew the blocks.
    steps : ndarray, shape (REPLICATES, P)
        From `steps_of`.

    Returns
    -------
    Spread

    """
    curvature, _ = summed(evaluation, free, prior)
    memory = objective.memory(coordinates, free, _LONGEST_MEMORY)
    inverse = _inverse(curvature)
    replicates = free + steps + sampling * rng.standard_normal(steps.shape)
    told = 1.0 - np.clip(prior.precision * np.diag(inverse), 0.0, 1.0)
    covariance = memory * evaluation.dispersion * inverse + np.diag(sampling ** 2)
    return Spread(covariance, replicates, told)


def _inverse(curvature):
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    return np.linalg.pinv(curvature * np.outer(scale, scale), rcond=1e-12,
                          hermitian=True) * np.outer(scale, scale)


def estimates_of(joint, coordinates, free, spread, reach, travel=np.inf, units=_UNITS):
    """
    Return the Estimates of one joint's friction.

    Parameters
    ----------
    joint : str
        Link name.
    coordinates : Coordinates
        What ``free`` stands for.
    free : ndarray, shape (P,)
        The fit.
    spread : Spread
        Its uncertainty.
    reach : float
        Farthest displacement in presliding [rad]; 0 if there was none.
    travel : float
        Farthest displacement at all [rad].
    units : tuple of str
        Of static, coulomb, velocity and viscous.

    Returns
    -------
    tuple of Estimate

    """
    theta, directions = coordinates.unpack(free)
    variance = np.einsum('ip,pq,iq->i', directions, spread.covariance, directions)
    thetas = np.stack([coordinates.unpack(row)[0] for row in spread.replicates])
    low, high = np.percentile(thetas, [_LOW, _HIGH], axis=0)
    told = spread.told
    rows = []
    for k, direction in enumerate(('forward', 'backward')):
        for i, (name, unit) in enumerate(zip(_NAMES, units, strict=True)):
            rows.append((f'friction.{joint}.{direction}.{name}', unit, PER_DIRECTION * k + i,
                         told[PER_DIRECTION * k + (1 if name == 'static' else
                                                   0 if name == 'coulomb' else i)], name))
    rows.append((f'friction.{joint}.attraction', 'N m/s', 8, told[8], 'attraction'))
    order = _order(theta, coordinates.n_blocks)
    for number, i in enumerate(order):
        rows.append((f'friction.{joint}.stiffness[{number}]', 'N m/rad', BLOCKS + i,
                     told[coordinates.yields][i], 'stiffness'))
    return tuple(_estimate(row, theta, variance, low, high, (reach, travel)) for row in rows)


def _order(theta, n_blocks):
    """Return the blocks from soft to stiff."""
    return np.argsort(theta[BLOCKS:BLOCKS + n_blocks], kind='stable')


def _estimate(row, theta, variance, low, high, reaches):
    name, unit, i, told, kind = row
    value = float(theta[i])
    relative = float(np.sqrt(variance[i]) / value) if value > 0.0 else np.inf
    wide = np.exp(min(CONFIDENT * relative, 50.0))
    interval = Interval(value / wide, value * wide)
    bootstrap = Interval(float(low[i]), float(high[i]))
    flags, notes = [], []
    if kind == 'viscous' and value * 1.0 < _NOTHING * theta[1]:
        flags.append('at bound')
        notes.append('no viscous part is seen')
    if kind == 'static' and value - theta[i + 1] < _NOTHING * value:
        flags.append('at bound')
        notes.append('static and Coulomb friction are the same')
    vague = bootstrap.high > np.exp(2.0 * _VAGUE) * max(bootstrap.low, 0.0)
    if told < 0.5 or CONFIDENT * relative > _VAGUE or vague:
        flags.append('not identifiable')
        notes.append(_TELLS[kind])
    if kind == 'stiffness':
        weight = theta[i + MOST_BLOCKS]
        late = _slips_late(weight * theta[[STATIC, PER_DIRECTION + STATIC]].mean() / value,
                           *reaches)
        flags += ['not identifiable'] if late else []
        notes += [late] if late else []
    if _differ(interval, bootstrap):
        flags.append('intervals disagree')
        notes.append('the bootstrap over blocks of time says otherwise than the Jacobian: '
                     'something repeats in the data that the model lacks')
    return Estimate(name, unit, value, interval, bootstrap, tuple(dict.fromkeys(flags)),
                    '; '.join(notes))


def _slips_late(yielding, reach, travel):
    """Return what is to be said of a block that slips after presliding or never, '' if none."""
    if reach == 0.0:
        return 'no presliding is in the data, which alone tells stiffnesses'
    if yielding > travel:
        return (f'slips only after {yielding:.3g} rad, farther than the joint ever moved '
                f'({travel:.3g} rad): it never slipped, so that these data tell no break-away')
    if yielding > _BEYOND * reach:
        return (f'slips only after {yielding:.3g} rad, beyond the {reach:.3g} rad of presliding '
                'in the data: a slow rise of friction after reversals, not a stiffness of '
                'presliding')
    return ''


def _differ(one, other):
    widths = [max(pair.high - pair.low, 1e-300) for pair in (one, other)]
    return max(widths) / min(widths) > _DISAGREE


def curve_of(coordinates, free, spread, displacement):
    """
    Return the presliding curve with its 95 % interval from the bootstrap.

    Parameters
    ----------
    coordinates, free, spread
        As `estimates_of`.
    displacement : ndarray, shape (D,)
        [rad].

    Returns
    -------
    tuple of ndarray, shape (D,)
        Displacement, torque, low and high [N m].

    """
    curves = np.stack([presliding_curve(coordinates.unpack(row)[0], displacement)
                       for row in spread.replicates])
    low, high = np.percentile(curves, [_LOW, _HIGH], axis=0)
    return displacement, presliding_curve(coordinates.unpack(free)[0], displacement), low, high
