# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Friction against velocity (Fig. 3): the Stribeck curve through it, and where a fit begins.

A Stribeck curve falls with speed and viscous friction is straight, so that no GMS model has
friction that rises steeply at first and less later, as of a lubricant that thins as it is
sheared. What a fit leaves of the torque shows it; it is then fitted along with friction.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple
import warnings

from gms_flex_control.data.signal_analysis import low_pass, rms
from gms_flex_control.effects import base as sig
from gms_flex_control.effects.catalogue.friction_shape import ShearThinning
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.coordinates import DROP, LAG, MOST_BLOCKS
from gms_flex_control.identification.criterion import WORTH
from gms_flex_control.identification.objective import (
    blocks_of,
    friction_torque,
    Objective,
    torque_memory,
)
from gms_flex_control.identification.outcome import (
    CONFIDENT,
    Estimate,
    estimated,
    FrictionMap,
    WIDE,
)
from gms_flex_control.identification.prediction_error import simple_friction
from gms_flex_control.identification.robust_regression import first_coefficient, held_out_error
from gms_flex_control.identification.segments import filled, Segment
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import EffectSpec
from gms_flex_control.simulation.predictor import parameter_rows
import numpy as np
from scipy.optimize import least_squares, nnls

N_SPREAD = 8        # blocks with fixed yields that find the shape of the presliding curve
_WINDOW = 0.25      # of one point of the map, at most [s]
_SHORTEST = 4       # samples of one
_UNSTEADY = 0.25    # relative change of velocity within a window that still counts as steady
_SAME_SPEED = 0.02  # relative, of strokes that repeat each other
_LAGGING = 2        # windows at the beginning of one
_SLOWEST_STEPS = 3  # encoder steps a window must travel
_FEWEST = 4         # points of a direction for a Stribeck curve; below, Coulomb and viscous only
_FEWEST_WINDOWS = 3  # of motion in a direction
_NARROW = 0.02      # of the top velocity: v_s of a straight curve
_LEAST = 0.05       # of the largest torque: F_c of a straight curve
_FAINT = 0.1        # factor of friction that effects leave, at least: less says nothing of it
_FINEST = 0.25      # of an encoder step: smallest yield of the spread
_WIDEST = 0.3       # largest yield of the spread [rad], or the joint's travel
_BENDS = np.geomspace(0.05, 2.0, 8)  # of the usual speed: where viscosity begins to fall


class Stribeck(NamedTuple):
    """Steady friction of one direction, Eq. (6)."""

    static: float    # F_s [N m]
    coulomb: float   # F_c [N m]
    velocity: float  # v_s [rad/s]
    viscous: float   # sigma_2 [N m s/rad]


class Start(NamedTuple):
    """
    Rough parameters of one joint.

    A Stribeck part as wide as the motion is fast bends like viscous friction: the cost has a
    local minimum with each in the other's place, and a fit begins from both.
    """

    forward: Stribeck
    backward: Stribeck
    attraction: float    # [N m/s]
    yields: np.ndarray   # (N_SPREAD,), of the spread [rad]
    straight: tuple      # of Stribeck, forward and backward: the Stribeck part is narrow
    unmoved: int | None = None  # direction without motion: 0 forward, 1 backward

    def both(self) -> tuple[np.ndarray, np.ndarray]:
        """Return steady parameters (4, 2) forward and backward, as fitted and as straight."""
        return tuple(np.array(pair).T for pair in ((self.forward, self.backward), self.straight))


def friction_map(segments: Sequence[Segment], arm: ArmParams, joint: int, period: float,
                 half: float) -> FrictionMap:
    """Return the friction of one joint in windows of a quarter second, or less, one way each."""
    size = max(round(_WINDOW / period), _SHORTEST)
    found = _in_windows(segments, arm, joint, period, half, size)
    if moves(found):
        return found
    while size > _SHORTEST and min(_seen(found)) < _FEWEST_WINDOWS:
        size = max(size // 2, _SHORTEST)
        found = _in_windows(segments, arm, joint, period, half, size)
    return found


def _in_windows(segments, arm, joint, period, half, size):
    """Return the friction in windows of ``size`` samples."""
    rows = [table[good] for table, good in (
        _windows(segment, arm, joint, period, half, size, segment.tested[:, joint])
        for segment in segments if len(segment.rate) >= size)]
    table = np.concatenate(rows) if rows else np.zeros((0, 3))
    return FrictionMap(table[:, 0], table[:, 1], table[:, 2] > 0)


def _windows(segment, arm, joint, period, half, size, chosen):
    """Return (W, 3) mean rate, friction, steadiness of windows, and which (W,) are of use."""
    count = len(segment.rate) // size
    cut = slice(0, count * size)
    rates, torque, angle, chosen = (values[cut].reshape(count, size) for values in (
        segment.rate[:, joint],
        friction_torque(segment, arm)[:, joint] / np.maximum(segment.factor[:, joint], _FAINT),
        filled(segment.angle[:, joint:joint + 1])[:, 0], chosen))
    mean = rates.mean(axis=1)
    one_way = (np.abs(rates).min(axis=1) > 0.0) & (np.abs(np.sign(rates).sum(axis=1)) == size)
    good = one_way & (np.ptp(angle, axis=1) > 2 * _SLOWEST_STEPS * half) & chosen.all(axis=1)
    steady = np.ptp(rates, axis=1) < _UNSTEADY * np.abs(mean) + 4.0 * half / (size * period)
    return np.stack([mean, torque.mean(axis=1), steady], axis=1), good


def _fit_stribeck(velocity, torque):
    """Return the Stribeck of one direction, Eq. (6), by least squares with a soft-L1 loss."""
    top, level = velocity.max(), max(float(np.median(torque)), 1e-12)
    slow = max(float(np.quantile(velocity, 0.1)), 1e-9)
    if len(velocity) < _FEWEST:
        return Stribeck(1.02 * level, level, slow, 1e-3 * level / top)
    noise = max(1.5 * float(np.median(np.abs(torque - np.median(torque)))), 1e-3 * level)

    def residual(x):
        coulomb, viscous = x[0] * level, x[3] * level / top
        drop = x[1] * coulomb  # at most F_s = 2 F_c: else a curve that bends is no Stribeck curve
        return coulomb + drop * np.exp(-fading(x)) + viscous * velocity - torque

    def derivatives(x):
        faded = fading(x)
        decay = np.exp(-faded)
        return level * np.stack([1.0 + x[1] * decay, x[0] * decay,
                                 2.0 * x[0] * x[1] * faded * decay, velocity / top], axis=1)

    def fading(x):
        return np.minimum((velocity / np.exp(x[2])) ** 2, 50.0)

    best = min((least_squares(
        residual, [0.9, 0.1, np.log(start), 0.1], derivatives, loss='soft_l1', f_scale=0.3 * noise,
        bounds=([1e-3, 1e-4, np.log(0.3 * slow), 0.0], [3.0, 1.0, np.log(top), 3.0]))
        for start in np.geomspace(slow, top, 4)), key=lambda fit: fit.cost)
    coulomb = best.x[0] * level
    return Stribeck(coulomb + best.x[1] * coulomb, coulomb, float(np.exp(best.x[2])),
                    best.x[3] * (level / top))


def _straight(velocity, torque):
    """
    Return Coulomb and viscous friction of one direction, its Stribeck part narrow.

    Where friction falls with velocity, without viscous part.
    """
    top = velocity.max()
    level, rise = nnls(np.stack([np.ones(len(velocity)), velocity / top], axis=1), torque)[0]
    level = max(level, _LEAST * float(np.abs(torque).max()), 1e-12)
    return Stribeck((1.0 + DROP) * level, level, _NARROW * top, max(rise, 1e-3 * level) / top)


def start_of(friction_map: FrictionMap, travel: float, resolution: float, joint: str, source: str,
             level: float | None = None) -> Start:
    """
    Return where the fit of a joint begins.

    ``travel`` is the range of its angle, ``resolution`` the encoder step or noise [rad];
    ``joint`` and ``source`` are for messages; ``level`` is friction [N m] to begin with where
    inertia and gravity are only roughly known, so that what is left of the torque can drive the
    joint instead of braking it: a warning then says so. Without it half of what both ways differ
    by is that level, and other torque the rest. Of motion one way, friction of the other way
    begins alike, and a warning says that, too. Raises IdentificationError if the joint hardly
    moves, or friction drives it both ways together and there is no ``level``.
    """
    seen, ways = _seen(friction_map), ((1.0, 'forward'), (-1.0, 'backward'))
    if not moves(friction_map):
        raise IdentificationError(
            f'{source}: {joint} moves steadily forward {seen[0]} times and backward {seen[1]} '
            f'times only: record motion both ways, each at least {_FEWEST_WINDOWS} times')
    unmoved = int(np.argmin(seen)) if min(seen) < _FEWEST_WINDOWS else None
    if unmoved is not None:
        warnings.warn(
            f'{source}: {joint} moves steadily {ways[unmoved][1]} {seen[unmoved]} times only: '
            'friction that way is set to that of the other way', stacklevel=2)
    moved = {name: _steady(friction_map, sign) for k, (sign, name) in enumerate(ways)
             if k != unmoved}
    medians = [float(np.median(torque)) for _, torque in moved.values()]
    if level is None and len(moved) == 2 and sum(medians) > 0.0:
        level = 0.5 * sum(medians)
    directions, lines = [], []
    for (name, (velocity, torque)), median in zip(moved.items(), medians, strict=True):
        if median <= 0.0 and level is not None:
            warnings.warn(
                f'{source}: what inertia and gravity leave of the torque of {joint} drives its '
                f'{name} motion as often as it brakes it: other forces (links that act on each '
                'other, gravity) hide its friction; trust it only as far as the error on data '
                'held out', stacklevel=2)
            directions.append(Stribeck(1.02 * level, level, float(velocity.max()), 1e-3 * level))
            lines.append(directions[-1])
        elif median <= 0.0:
            raise IdentificationError(
                f'{source}: friction of {joint} would drive its {name} motion (median '
                f'{median:.4g} N m); check the sign of the torque, the inertia and '
                'gravity of the robot file')
        else:
            directions.append(_fit_stribeck(velocity, torque))
            lines.append(_straight(velocity, torque))
    finest = max(_FINEST * resolution, 1e-6 * travel, 1e-9)
    widest = max(min(_WIDEST, travel), 20.0 * finest)
    if unmoved is not None:
        directions, lines = 2 * directions, 2 * lines
    return Start(*directions, attraction=directions[0].coulomb / LAG,
                 yields=np.geomspace(finest, widest, N_SPREAD), straight=tuple(lines),
                 unmoved=unmoved)


def moves(friction_map: FrictionMap) -> bool:
    """Return whether a joint moves often enough for its friction to show, one way at least."""
    return max(_seen(friction_map)) >= _FEWEST_WINDOWS


def _seen(friction_map):
    """Return in how many windows a joint moves forward, and backward."""
    return [int(np.sum(sign * friction_map.velocity > 0.0)) for sign in (1.0, -1.0)]


def _steady(friction_map, sign):
    """Return speed and friction one way, (W,) each, in steady windows where they are enough."""
    rows = np.sign(friction_map.velocity) == sign
    steady = rows & friction_map.steady
    rows = steady if steady.sum() >= _FEWEST_WINDOWS else rows
    return sign * friction_map.velocity[rows], sign * friction_map.torque[rows]


def repeatability(segments: Sequence[Segment], arm: ArmParams, joint: int, period: float,
                  half: float) -> float:
    """Return the deviation of friction among strokes of equal velocity [N m], NaN without any."""
    size, groups = max(round(0.5 * _WINDOW / period), _SHORTEST), {}
    for segment in segments:
        steady = segment.tested[:, joint] & (segment.phase == 'constant_velocity')
        if len(steady) < size or not steady.any():
            continue
        table, good = _windows(segment, arm, joint, period, half, size, steady)
        rows = np.flatnonzero(good & (table[:, 2] > 0))
        speeds = np.round(np.log(np.abs(table[rows, 0])) / _SAME_SPEED)
        keys = [(np.sign(table[row, 0]), speed) for row, speed in zip(rows, speeds, strict=True)]
        ends = [0, *(k for k in range(1, len(rows)) if rows[k] > rows[k - 1] + 1
                     or keys[k] != keys[k - 1]), len(rows)]
        for begin, end in pairwise(ends):  # of a stroke; friction lags behind its beginning
            if end > begin + _LAGGING:
                groups.setdefault(keys[begin], []).append(
                    table[rows[begin + _LAGGING:end], 1].mean())
    spreads = [np.var(values, ddof=1) for values in groups.values() if len(values) > 1]
    return float(np.sqrt(np.mean(spreads))) if spreads else float('nan')


def thinned_friction(thinning: EffectSpec, rate: np.ndarray) -> np.ndarray:
    """Return the friction torque (T,) at rates (T,) [N m]."""
    signals = {sig.DQ_LINK: rate, sig.FRICTION: np.zeros(len(rate))}
    ShearThinning.apply(signals, thinning.values, None, 0.0)
    return signals[sig.FRICTION]


def thinning_of(objective: Objective, joint: str, theta: np.ndarray,
                step: float) -> EffectSpec | None:
    """
    Return the ShearThinning in the torque that parameters leave, None where none predicts more.

    ``step`` is the encoder step or noise [rad].
    """
    rates = np.concatenate([one.rate[:, objective.joint] for one in objective.bundle.segments])
    usual, fastest = rms(rates), float(objective.fastest)
    tries = [EffectSpec(name=ShearThinning.name, joint=joint,
                        values=(1.0, float(share * usual), fastest)) for share in _BENDS]
    columns, left, block = (np.concatenate(part) for part in zip(*(
        _left(objective, segment, theta, step, tries) for segment in objective.bundle.segments),
        strict=True))
    beside = columns[:, len(tries):]
    with_one = [np.column_stack([columns[:, k], beside]) for k in range(len(tries))]
    errors = [held_out_error(one, left, block) for one in with_one]
    best = int(np.argmin(errors))
    if not errors[best] < WORTH * held_out_error(beside, left, block):
        return None
    period, windows = objective.bundle.period, [one.window for one in objective.bundle.segments]
    torque, error = first_coefficient(with_one[best], left, block, torque_memory(period, windows))
    return _times(tries[best], torque) if torque > CONFIDENT * error else None


def _left(objective, segment, theta, step, tries):
    """
    Return columns (T, C), the torque that is left (T,) and numbers of blocks, where it judges.

    Columns are those of ``tries``, of Coulomb and viscous friction by direction, inertia and
    what else is fitted along with friction.
    """
    joint, bundle = objective.joint, objective.bundle
    keep, rate = bundle.judged(segment, joint, step), segment.rate[:, joint]
    columns = np.column_stack([
        *(segment.factor[:, joint] * thinned_friction(one, rate) for one in tries),
        simple_friction(segment, joint), segment.acceleration[:, joint], objective.extra(segment)])
    left = objective.measured(segment) - objective.resistance(segment, theta)
    return (low_pass(columns, segment.window)[keep], low_pass(left, segment.window)[keep],
            blocks_of(segment, bundle.period)[keep])


def _times(thinning, factor):
    torque, *others = thinning.values
    return replace(thinning, values=(float(factor * torque), *others))


def fitted_thinning(thinning: EffectSpec | None, theta: np.ndarray) -> EffectSpec | None:
    """Return the ShearThinning of fitted parameters that began with one, None without any."""
    share = theta[parameter_rows(MOST_BLOCKS, 0)] if thinning else 0.0
    return _times(thinning, share) if share > 0.0 else None


def thinning_estimate(thinning: EffectSpec, error: float) -> Estimate:
    """Return the Estimate of a ShearThinning whose torque has a standard error [N m]."""
    torque, velocity, speed = thinning.values
    known = CONFIDENT * error < WIDE * torque
    note = (f'viscous friction bends: at most this above the straight line up to {speed:.3g} '
            f'rad/s, where it begins to at about {velocity:.2g} rad/s')
    return estimated(f'effects.{thinning.joint}.{thinning.name}.torque', 'N m', torque, error,
                     note if known else ShearThinning.discriminated_by, known)
