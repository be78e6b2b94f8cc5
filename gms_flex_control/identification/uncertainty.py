# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
How far each parameter can be trusted: its interval, or why it has no interval.

Three things widen an interval. Chance: the innovations within a block of time depend on each other
as they like, only blocks are independent (sandwich covariance, clusters of blocks). The way of
looking: a right model gives the same parameters with another observer, with half of the samples
and from beside the minimum; what they move by is error. The model: what fits with other numbers
of blocks, which the data do not rule out, differ by. Where the last exceeds the first two and
the sum is no longer well known, the value is one of the model, and no interval is printed.
"""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import rms
from gms_flex_control.identification.coordinates import (
    Coordinates,
    MOST_BLOCKS,
    presliding_curve,
    STATICS,
    yields_of,
)
from gms_flex_control.identification.least_squares import jacobian, summed
from gms_flex_control.identification.outcome import (
    CONFIDENT,
    DEPENDS,
    Estimate,
    Interval,
    NO_INTERVAL,
    NOT_IDENTIFIABLE,
    WELL_KNOWN,
    widening,
)
from gms_flex_control.simulation.predictor import BLOCKS, PER_DIRECTION, VELOCITY
import numpy as np

_VAGUE = np.log(2.0)    # half an interval this wide in the logarithm says nothing
_NOTHING = 2e-3         # of the friction level: a part this small is at its bound
_BEYOND = 3.0           # times the reach of presliding: a block that slips later is not counted
_STILL_FALLS = 0.05     # of F_s - F_c, left at the highest velocity: F_c is beyond the data
_LONGEST_MEMORY = 2.0   # of an innovation that is looked for [s]
_LEAST_DETERMINED = 1e-3  # numbers
_LEAST_ELSEWHERE = 1e-3   # of what the data say of a number: less in all other blocks is rounding
_NAMES = ('static', 'coulomb', 'velocity', 'viscous')
_UNITS = ('N m', 'N m', 'rad/s', 'N m s/rad')
_NEEDS = {
    'static': 'motion slower than v_s and break-away from rest identify it',
    'coulomb': 'steady motion well above v_s identifies it',
    'velocity': 'steady velocities between rest and the flat part of the curve identify it',
    'viscous': 'faster motion identifies it',
    'attraction': 'velocity that varies within a second around v_s identifies it',
    'stiffness': 'slow torque ramps below break-away, with small loops, identify it',
}
_TOGETHER_NOTE = ('the numbers of a Stribeck curve are identified together, and these data leave '
                  'others of this curve open')
_DEPENDS_NOTE = ('models that explain the data as well or better (another number of blocks, or '
                 'fitted by the motion instead of the torque) have values farther off than chance '
                 'explains')


class Spread(NamedTuple):
    """Uncertainty of free numbers, of one model."""

    covariance: np.ndarray  # (P, P)
    determined: np.ndarray  # (P,), share that the data determine, the rest is prior


def spread_of(objective, fit) -> Spread:
    """Return the Spread of a JointFit at the minimum of an Objective."""
    coordinates, free, prior, evaluation = fit.coordinates, fit.free, fit.prior, fit.evaluation
    curvature, _ = summed(evaluation, free, prior)
    memory = objective.memory(coordinates, free, _LONGEST_MEMORY)
    inverse = inverse_of(curvature)
    scores = evaluation.weight[:, None] * evaluation.gradient
    determined = 1.0 - np.clip(prior.precision * np.diag(inverse), 0.0, 1.0)
    own = objective.finest ** 2 * np.tensordot(  # the predictor's error, alike through a block
        evaluation.weight ** 2 * evaluation.count, evaluation.curvature, 1)
    return Spread(clustered(inverse, scores, memory * evaluation.dispersion)
                  + inverse @ own @ inverse + np.diag(fit.sampling ** 2), determined)


def torque_spread(error, coordinates: Coordinates, free: np.ndarray, prior) -> Spread:
    """Return the Spread of a fit to the torque, ``error`` its TorqueError."""
    def left(x):
        return error(coordinates.parameters(x))
    off, slope = left(free), jacobian(left, free)
    noise = rms(off) ** 2 * error.memory
    curvature = slope.T @ slope / noise + np.diag(prior.precision)
    inverse = np.linalg.pinv(curvature, rcond=1e-12, hermitian=True)
    scores = block_sums(slope * off[:, None] / noise, error.block)
    determined = 1.0 - np.clip(prior.precision * np.diag(inverse), 0.0, 1.0)
    return Spread(clustered(inverse, scores, 1.0), determined)


def block_sums(rows: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the sums (B, P) of rows (S, P) of each block of time, ``block`` (S,) its number."""
    return np.stack([np.bincount(block, weights=column) for column in rows.T], axis=1)


def clustered(inverse: np.ndarray, scores: np.ndarray, dispersion: float) -> np.ndarray:
    """
    Return the covariance (P, P) of numbers whose errors are independent between blocks of time.

    ``inverse`` (P, P) is that of the curvature, ``scores`` (B, P) the slope of the cost of each
    block; the inverse times ``dispersion`` is the covariance if all samples are alike: no number
    is said to be better known, since few blocks agree by chance. As wide as Student's
    distribution for that many blocks requires.
    """
    off, blocks = scores - scores.mean(axis=0), max(len(scores), 2)
    few = blocks / (blocks - 1) * widening(blocks - 1) ** 2
    half, alike = off @ inverse, dispersion * inverse
    sandwich = few * half.T @ half + 1e-12 * alike  # never singular
    least = np.maximum(np.diag(alike), 0.0)
    own = np.maximum(np.diag(sandwich), 1e-12 * least + 1e-300)
    wider = np.sqrt(np.maximum(least / own, 1.0))
    covariance = sandwich * np.outer(wider, wider)
    np.fill_diagonal(covariance, np.maximum(least, own))  # rounding may have made it negative
    return covariance


def unshrunk(scores: np.ndarray, share: np.ndarray) -> np.ndarray:
    """
    Return the scores (B, P) of blocks as if none had drawn the fit to itself.

    A fit follows the noise of the very data it is judged by: the more, the larger a part of a
    number one block determines. ``share`` (B, P, P) is what each block adds to the curvature, of
    numbers scaled so that the sum is one. With independent errors alike, the mean square is then
    right (bias-reduced linearization, Bell and McCaffrey 2002).
    """
    out = np.empty(scores.shape)
    for k, own in enumerate(share):
        size, axes = np.linalg.eigh(own)
        out[k] = axes @ (axes.T @ scores[k] / np.sqrt(np.maximum(1.0 - size, _LEAST_ELSEWHERE)))
    return out


def memory_of(inverse: np.ndarray, precision: np.ndarray, scores: np.ndarray,
              kept=slice(None)) -> float:
    """
    Return how many samples count as one, by numbers ``kept``, see `clustered`.

    What only priors of ``precision`` (P,) determine does not scatter with the data, and says
    nothing.
    """
    scatter = np.diag(clustered(inverse, scores, 0.0)) / np.diag(inverse)
    determined = 1.0 - precision @ inverse ** 2 / np.diag(inverse)
    return float(np.sum(scatter[kept]) / max(np.sum(determined[kept]), _LEAST_DETERMINED))


def inverse_of(curvature: np.ndarray) -> np.ndarray:
    """
    Return the inverse of a curvature (P, P) whose numbers have very different scales.

    What rounding hides is as uncertain as rounding allows.
    """
    half = root_of_inverse(curvature)
    return half @ half.T


def root_of_inverse(curvature: np.ndarray) -> np.ndarray:
    """Return the (P, P) whose product with its transpose is `inverse_of`."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    values, vectors = np.linalg.eigh(curvature * np.outer(scale, scale))
    return scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))


def estimates_of(joint: str, coordinates: Coordinates, free: np.ndarray, spread: Spread,
                 reach: float, travel=np.inf, rivals: Sequence = (), top=np.inf) -> tuple:
    """
    Return the Estimates of one joint's friction.

    ``reach`` is the farthest displacement in presliding [rad], 0 without it, ``travel``
    that at all; ``rivals`` are parameters of other models that the data do not rule out; a curve
    that still falls at ``top``, the highest velocity [rad/s], has no F_c in the data.
    """
    theta, directions = coordinates.unpack(free)
    variance = np.einsum('ip,pq,iq->i', directions, spread.covariance, directions)
    error = np.sqrt(variance) / np.maximum(theta, 1e-300)
    off = _model_dependence(theta, coordinates.n_blocks, rivals)
    determined, rows = spread.determined.copy(), []
    for at in (0, PER_DIRECTION):
        if np.exp(-(top / theta[at + VELOCITY]) ** 2) > _STILL_FALLS:
            determined[[at, at + VELOCITY]] = 0.0
    for k, direction in enumerate(('forward', 'backward')):
        for i, (name, unit) in enumerate(zip(_NAMES, _UNITS, strict=True)):
            rows.append((f'friction.{joint}.{direction}.{name}', unit, PER_DIRECTION * k + i,
                         determined[PER_DIRECTION * k + (1 if name == 'static' else
                                                         0 if name == 'coulomb' else i)], name))
    rows.append((f'friction.{joint}.attraction', 'N m/s', 8, determined[8], 'attraction'))
    soft_to_stiff = np.argsort(theta[BLOCKS:BLOCKS + coordinates.n_blocks], kind='stable')
    for number, i in enumerate(soft_to_stiff):
        rows.append((f'friction.{joint}.stiffness[{number}]', 'N m/rad', BLOCKS + i,
                     determined[coordinates.yields][i], 'stiffness'))
    return _known_together(f'friction.{joint}.', [
        _estimate(row, theta, error, off, (reach, travel)) for row in rows])


def _known_together(prefix, estimates):
    """
    Return Estimates as a tuple, without those that need others of their curve.

    With F_c unknown, the whole curve is: a wide Stribeck part takes its place, and that of the
    viscous part. F_s and v_s need each other, and a lag behind the curve (C) needs one of both.
    """
    rows = {one.name.removeprefix(prefix): one for one in estimates}

    def lost(name):
        return bool({NOT_IDENTIFIABLE, DEPENDS} & set(rows[name].flags))

    def without(names):
        for name in names:
            if not lost(name):
                one = rows[name]
                rows[name] = one._replace(
                    interval=NO_INTERVAL, flags=(*one.flags, NOT_IDENTIFIABLE), note='; '.join(
                        filter(None, (one.note, _TOGETHER_NOTE))))
    for side in ('forward', 'backward'):
        if lost(f'{side}.coulomb'):
            without(f'{side}.{name}' for name in _NAMES)
        elif lost(f'{side}.static') or lost(f'{side}.velocity'):
            without((f'{side}.static', f'{side}.velocity'))
    if lost('forward.velocity') and lost('backward.velocity'):
        without(['attraction'])
    return tuple(rows.values())


def _model_dependence(theta, n_blocks, rivals):
    """
    Return how far rivals are from parameters, rms of the logarithm, shape as ``theta``.

    A block has no counterpart among another number of blocks: compared is the torque of
    presliding where it yields.
    """
    off = np.zeros(len(theta))
    if not rivals:
        return off
    yields, _ = yields_of(theta)

    def seen(one):
        return np.log(np.maximum(np.concatenate([one[:BLOCKS], presliding_curve(one, yields)]),
                                 1e-300))
    off[:BLOCKS + n_blocks] = np.sqrt(np.mean(
        [(seen(rival) - seen(theta)) ** 2 for rival in rivals], axis=0))
    return off


def _estimate(row, theta, error, off, reaches):
    name, unit, i, determined, kind = row
    value, chance, half = float(theta[i]), error[i], CONFIDENT * np.hypot(error[i], off[i])
    found = []  # flags, and what is said of each
    if kind == 'viscous' and value < _NOTHING * theta[1]:
        found.append(('at bound', 'no viscous part is seen'))
    if kind == 'static' and value - theta[i + 1] < _NOTHING * value:
        found.append(('at bound', 'static and Coulomb friction are the same'))
    depends = off[i] > CONFIDENT * chance and half > WELL_KNOWN
    if determined < 0.5 or CONFIDENT * chance > _VAGUE or (half > _VAGUE and not depends):
        found.append((NOT_IDENTIFIABLE, _NEEDS[kind]))
    elif depends:
        found.append((DEPENDS, _DEPENDS_NOTE))
    if kind == 'stiffness':
        late = _slips_late(theta[i + MOST_BLOCKS] * theta[STATICS].mean() / value, *reaches)
        found += [(NOT_IDENTIFIABLE, late)] if late else []
    flags = tuple(dict.fromkeys(flag for flag, _ in found))
    wide = np.nan if {NOT_IDENTIFIABLE, DEPENDS} & set(flags) else np.exp(half)
    return Estimate(name, unit, value, Interval(float(value / wide), float(value * wide)), flags,
                    '; '.join(note for _, note in found))


def _slips_late(yielding, reach, travel):
    """Return what is to be said of a block that slips after presliding or never, '' if none."""
    if reach == 0.0:
        return 'no presliding is in the data, which alone identifies stiffnesses'
    if yielding > travel:
        return (f'slips only after {yielding:.3g} rad, farther than the joint ever moved '
                f'({travel:.3g} rad): it never slipped, so these data hold no break-away')
    if yielding > _BEYOND * reach:
        return (f'slips only after {yielding:.3g} rad, beyond the {reach:.3g} rad of presliding '
                'in the data: a slow rise of friction after reversals, not a stiffness of '
                'presliding')
    return ''


def curve_of(fit, spread: Spread, displacement: np.ndarray) -> tuple:
    """Return displacement, torque, low and high end of 95 % (D,) of a JointFit's presliding."""
    coordinates, free, rivals = fit.coordinates, fit.free, fit.rivals

    def at(numbers):
        return presliding_curve(coordinates.parameters(numbers), displacement)
    torque = at(free)
    slopes = jacobian(at, free)
    variance = np.einsum('dp,pq,dq->d', slopes, spread.covariance, slopes)
    if rivals:
        variance += np.mean([(presliding_curve(rival, displacement) - torque) ** 2
                             for rival in rivals], axis=0)
    wide = np.exp(CONFIDENT * np.sqrt(variance) / np.maximum(torque, 1e-300))
    return displacement, torque, torque / wide, torque * wide


def shown_displacements(estimates: Sequence[Estimate], static: float, step: float,
                        points: int) -> np.ndarray:
    """
    Return displacements [rad] from the first to the last yield of identifiable blocks.

    Below the first, stiffer blocks would make the curve, of which the data say nothing, and
    below a ``step`` of the encoder [rad] nothing is seen; ``static`` is the mean F_s [N m]. A
    block alone makes a line from a step on. Empty where no stiffness is identifiable, or only one
    of several, or all yield within a step.
    """
    blocks = [one for one in estimates if '.stiffness[' in one.name]
    yields = np.array([static / len(blocks) / max(one.value, 1e-300) for one in blocks])
    known = ~np.array([bool({NOT_IDENTIFIABLE, DEPENDS} & set(one.flags)) for one in blocks])
    least = yields[known].min(initial=np.inf) if len(blocks) > 1 else 0.0
    first, last = max(least, step), yields[known].max(initial=0.0)
    return np.geomspace(first, last, points) if first < last else np.zeros(0)
