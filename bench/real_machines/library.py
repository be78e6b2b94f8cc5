# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The columns of least squares: what the friction of real machines is known to be made of.

The textbook has inertia, Coulomb and viscous friction, an offset and gravity. Beyond it are
friction of each direction, elasto-plastic elements, a low-speed shape, load and ripple.
"""

from typing import NamedTuple

from bench.real_machines.motion import low_pass, rms
import numpy as np

STANDS = 2e-3                   # of the peak speed: below, the sign of motion fades out
STOPS = 5                       # elasto-plastic elements
STOP_RANGE = (1e-4, 0.3)        # of the travel: least and largest yield
LOW_SPEEDS = (0.01, 0.03, 0.1)  # of the peak speed: v0 of sgn(v) exp(-|v| / v0)
WAVES = 3                       # ripple orders
FEWEST_WAVES = 3.0              # periods of a ripple in the travel, at least
_PEAK = 0.995                   # quantile of the speed that is called its peak
_SLOW = 0.1                     # of the usual speed: below, a ripple is not looked for
_PER_WAVE = 6                   # bins of the angle per period of the finest ripple
_FINER = 8                      # orders looked at per order that the travel resolves
_SEEN = 0.01                    # of the time: slower than v0, else its shape is not determined
_INERTIAL = ('inertia', 'gravity')


class Column(NamedTuple):
    """One regressor of the torque."""

    name: str
    group: str
    along: object            # function of a Motion, returns (S,)
    positive: bool = False   # its weight is never negative


def textbook(gravity):
    """Return the columns of inertia, Coulomb and viscous friction, offset, and gravity if any."""
    columns = (
        Column('inertia', 'inertia', lambda m: m.acceleration, True),
        Column('coulomb', 'friction', lambda m: m.filtered(sign(m)), True),
        Column('viscous', 'friction', lambda m: m.filtered(m.rate), True),
        Column('offset', 'offset', lambda m: np.ones(len(m.time))))
    if not gravity:
        return columns
    return (*columns,
            Column('gravity_sin', 'gravity', lambda m: m.filtered(np.sin(m.angle))),
            Column('gravity_cos', 'gravity', lambda m: m.filtered(np.cos(m.angle))))


def further(parts, plain=None):
    """
    Return the Columns beyond the textbook's, ripple left out.

    The Fit ``plain`` of the textbook's columns gives the load; without it the load is constant.
    """
    travel = max(float(np.ptp(m.angle[mask])) for m, mask in parts)
    top = max(peak(m) for m, _ in parts)
    speed = np.concatenate([np.abs(m.rate[mask]) for m, mask in parts])
    shapes = [v0 for v0 in top * np.array(LOW_SPEEDS) if np.mean(speed < v0) > _SEEN]
    load = () if plain is None else load_friction(plain)
    return (*by_direction(), *stops(travel), *low_speed(shapes), *load)


def by_direction():
    """Return Coulomb and viscous friction of each direction, beside that of both."""
    def side(way, value):
        return lambda m: m.filtered(np.where(way * m.rate > 0.0, value(m), 0.0))
    return tuple(Column(f'{name}_{word}', 'direction', side(way, value), True)
                 for name, value in (('coulomb', sign), ('viscous', lambda m: m.rate))
                 for word, way in (('forward', 1.0), ('backward', -1.0)))


def stops(travel):
    """Return elasto-plastic elements of unit force, yields even in their logarithm."""
    def element(reach):
        return lambda m: m.filtered(elasto_plastic(m.angle, reach))
    return tuple(Column(f'stop_{reach:.3g}', 'stops', element(reach), True)
                 for reach in travel * np.geomspace(*STOP_RANGE, STOPS))


def low_speed(shapes):
    """Return sgn(v) exp(-|v| / v0) for some v0 [rad/s]."""
    def shape(v0):
        return lambda m: m.filtered(sign(m) * np.exp(-np.abs(m.rate) / v0))
    return tuple(Column(f'low_speed_{v0:.3g}', 'low_speed', shape(v0))
                 for v0 in shapes)


def load_friction(plain):
    """Return |load| sgn(v), the load being inertia and gravity of a textbook Fit."""
    carried = [(column, weight) for column, weight in
               zip(plain.columns, plain.weights, strict=True) if column.group in _INERTIAL]

    def along(m):
        load = sum(weight * column.along(m) for column, weight in carried)
        return m.filtered(np.abs(low_pass(load, plain.band, m.period)) * sign(m))
    return (Column('load_friction', 'load', along, True),)


def ripple(orders):
    """Return sine and cosine of the angle at some orders [1/rad]."""
    def wave(function, order):
        return lambda m: m.filtered(function(order * m.angle))
    return tuple(Column(f'{name}_{order:.6g}', 'ripple', wave(function, order))
                 for order in orders for name, function in (('sin', np.sin), ('cos', np.cos)))


def sign(motion):
    """Return the sign of the rate (S,), fading to 0 at rest."""
    return np.tanh(motion.rate / (STANDS * peak(motion)))


def peak(motion):
    """Return the highest speed but for outliers [rad/s]."""
    return float(np.quantile(np.abs(motion.rate), _PEAK))


def elasto_plastic(angle, reach):
    """Return the force (S,) of a Maxwell element of unit force that yields at ``reach`` [rad]."""
    force, out = 0.0, np.empty(len(angle))
    for k, step in enumerate(np.diff(angle, prepend=angle[0]) / reach):
        force = min(max(force + step, -1.0), 1.0)
        out[k] = force
    return out


def ripple_orders(parts, residuals, band):
    """
    Return the `WAVES` orders [1/rad] at which a residual's spectrum over the angle is largest.

    ``residuals`` (S,) of each part [N m] are behind a low-pass of a ``band`` [Hz]: at the usual
    speed, finer ripple does not pass it.
    """
    span = max(float(np.ptp(m.angle[mask])) for m, mask in parts)
    speed = rms(np.concatenate([m.rate[mask] for m, mask in parts]))
    finest = 2.0 * np.pi * band / speed
    bins = int(np.ceil(_PER_WAVE * finest * span / (2.0 * np.pi)))
    length = 2 ** int(np.ceil(np.log2(_FINER * bins)))
    power = np.zeros(length // 2 + 1)
    for (m, mask), left in zip(parts, residuals, strict=True):
        place = (m.angle - m.angle[mask].min()) / span * bins
        place = np.clip(place.astype(int), 0, bins - 1)
        moving = mask & (np.abs(m.rate) > _SLOW * speed)
        for way in (moving & (m.rate > 0.0), moving & (m.rate < 0.0)):
            power += _spectrum(place[way], left[way], bins, length)
    orders = 2.0 * np.pi * np.arange(len(power)) / (length * span / bins)
    apart, found = 2.0 * np.pi / span, []
    power[(orders < FEWEST_WAVES * apart) | (orders > finest)] = 0.0
    while len(found) < WAVES and power.any():
        found.append(float(orders[np.argmax(power)]))
        power[np.abs(orders - found[-1]) < 2.0 * apart] = 0.0
    return tuple(found)


def _spectrum(place, left, bins, length):
    """Return the power over the angle (length / 2 + 1,) of values in bins of one direction."""
    count = np.bincount(place, minlength=bins)
    mean = np.bincount(place, left, bins) / np.maximum(count, 1)
    if count.any():  # friction differs from one direction to the other
        mean[count > 0] -= mean[count > 0].mean()
    return np.abs(np.fft.rfft(mean, length)) ** 2
