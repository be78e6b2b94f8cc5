# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
A single joint by linear regression of its torque: inertia, gravity, ripple.

``u = I q'' + a cos q + b sin q + friction(q')`` holds for torque, angle and its derivatives alike
when all pass through the same zero-phase filter. Only moving samples count. Friction stands by
as regressors of its own, each direction for itself: Coulomb, viscous, and a part that fades with
speed, so that the rise at low speed does not end up in inertia or gravity. A constant torque
looks like friction that differs between the directions, and stays with it, unless friction would
then have to be several times larger one way than the other.

Friction that grows with the torque carried has a column as well where gravity acts: weight loads
the transmission at all speeds, so that it is neither viscous friction nor inertia.

A ripple, a torque periodic in the angle as gears, screws and motors make, is no friction, but
where it is as large as what separates presliding from the Stribeck curve it replaces both. So it
is looked for with the inertia, before friction is fitted.
"""

from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import NamedTuple

from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.effects.catalogue.drive import TorqueRipple
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.outcome import CONFIDENT
from gms_flex_control.identification.prediction_error import FEWEST_WAVES
from gms_flex_control.identification.robust_regression import held_out_error, SLOWEST, solution
from gms_flex_control.params.robot import EffectSpec
import numpy as np
from scipy.optimize import minimize_scalar

RIPPLE = TorqueRipple.name
FEWEST = 60        # samples, moving
_SURELY = 3.0      # standard errors, and part of an inertia, by which a wider filter must show
_LARGER = 0.25     # more of it
_WIDEST = 4        # times the usual filter
_ONE_WAY = 4       # of friction_regressors
COULOMB = [0, _ONE_WAY]  # likewise, those of Coulomb friction forward and backward
_FADING = (0.15, 0.5)  # speeds at which the fading parts of friction fade, of the usual speed
_NARROW = 1.0      # range of angles in which gravity is hardly separable from a constant [rad]
_CLEAR = 0.5       # of the held-out error: gravity must help this much there, or if cancelled
_WORTH = 0.97      # of the held-out error, or of what another explains: helps less, is not there
_CONSTANT = 1e-6   # of a torque: rounding
_LOPSIDED = 0.5    # of the friction the other way: below this there is a constant torque
_LEAST = 0.02      # of the torque: friction to begin with, and friction by load, at least
_RIPPLE_CLEAR = 3.0   # standard errors: a ripple below is not there
_RIPPLE_ROUNDS = 4    # of order and all else in turn
_ABOUT = 0.5       # of a wave over the range of angles: how far an order is looked for
_PLACES = (1, 2)   # orders of friction that varies with the angle, beside friction by load
_LOADINGS = 3      # rounds of the torque carried and what friction it makes


class AxisSamples(NamedTuple):
    """Filtered samples of one axis."""

    angle: np.ndarray         # (S,) [rad]
    rate: np.ndarray          # (S,) [rad/s]
    acceleration: np.ndarray  # (S,) [rad/s^2]
    torque: np.ndarray        # (S,) [N m]
    block: np.ndarray         # (S,) int, number of its block of time
    wider: int = 1            # than counts of the encoder ask for: their filter


class AxisFit(NamedTuple):
    """Inertia and gravity of one axis."""

    inertia: float         # about the joint, motor of a rigid joint included [kg m^2]
    cosine: float          # gravity torque a cos q [N m]; 0 where none is seen
    sine: float            # gravity torque b sin q [N m]
    constant: float        # torque that friction cannot explain, needed both ways [N m]; or 0
    friction: float        # usual friction, mean of both directions [N m]
    error: np.ndarray      # (4,), standard errors of the first four
    has_gravity: bool
    explained: float       # share of the torque's variance
    inertia_known: bool    # whether the inertia is clearly above zero
    share: float           # torque of the inertia, of the whole
    left: np.ndarray       # (S,), torque that is not explained; 0 where the axis hardly moves
    rippling: np.ndarray   # (S,), torque of the ripple; likewise
    wave: np.ndarray       # (2,), needed torque per sine and cosine of a ripple [N m]
    wave_error: float      # standard error of its amplitude [N m]
    off: float             # robust error on data held out [N m]
    per_load: float        # friction per torque carried, 0 where it does not grow

    @property
    def gravity_torque(self) -> float:
        """Return the largest gravity torque [N m]."""
        return float(np.hypot(self.cosine, self.sine))

    @property
    def offset(self) -> float:
        """Return the angle of the centre of mass from the horizontal where q is 0 [rad]."""
        return float(np.arctan2(-self.sine, self.cosine)) if self.has_gravity else 0.0


class Ripple(NamedTuple):
    """A ripple of one axis: y += amplitude sin(order q + phase), pushing forward."""

    amplitude: float  # [N m]
    order: float      # [1/rad]
    phase: float      # [rad]
    amplitude_error: float  # standard errors of these
    order_error: float

    def effect(self, joint) -> EffectSpec:
        """Return the EffectSpec that puts it into a model."""
        return EffectSpec(name=RIPPLE, joint=joint,
                          values=(self.amplitude, self.order, self.phase))


def filtered(recordings: Sequence, signals_of: Callable, wider: int = 1) -> Generator[tuple]:
    """
    Yield Derivatives of angles and others of each recording, and blocks of time (S,).

    Their filter is so many times ``wider`` than counts of encoders ask for.
    """
    used = 0
    for recording in recordings:
        angles, others = signals_of(recording)
        window = wider * max(analysis.derivative_window(recording.time, angle) for angle in angles)
        time, *signals = analysis.smoothed(
            recording.time, [recording.time, *angles, *others], window)
        if len(time.value):
            block = used + ((time.value - time.value[0]) / analysis.BLOCK_TIME).astype(int)
            used = block[-1] + 1
            yield signals, block


def axis_samples(recordings: Sequence, drive: Callable, joint: int, wider: int = 1) -> AxisSamples:
    """Return `filtered` AxisSamples, moving or not, ``drive`` Recording -> torque (T,)."""
    parts = [(motion.value, motion.first, motion.second, torque.value, block)
             for (motion, torque), block in filtered(recordings, lambda one: (
                 [one.q_link[:, joint]], [drive(one)]), wider)]
    if not parts:
        raise IdentificationError('no recording is long enough to identify the inertia')
    return AxisSamples(*(np.concatenate(part) for part in zip(*parts, strict=True)), wider)


def samples_that_agree(recordings: Sequence, drive: Callable, joint: int,
                       turns: bool) -> AxisSamples:
    """
    Return `axis_samples` behind the least filter whose inertia a wider one confirms.

    What holds for torque and motion holds behind every filter. Where a joint, or what carries it,
    swings on a spring that nothing measures, it does not near the resonance: the inertia looks
    smaller there, and gravity, where the axis ``turns``, hides in what is left.
    """
    samples = axis_samples(recordings, drive, joint)
    inertia, error = _any_inertia(samples, turns)
    while samples.wider < _WIDEST and np.isfinite(inertia):
        wider = axis_samples(recordings, drive, joint, 2 * samples.wider)
        other, other_error = _any_inertia(wider, turns)
        if not other - inertia > max(_SURELY * np.hypot(error, other_error), _LARGER * inertia):
            break
        samples, inertia, error = wider, other, other_error
    return samples


def _any_inertia(samples, turns):
    """Return the inertia beside all that may be there, and its error; NaN of few samples."""
    moves = _in_motion(samples)
    if moves.sum() < FEWEST:
        return np.nan, np.nan
    rate, angle = samples.rate[moves], samples.angle[moves]
    gravity = [np.cos(angle), np.sin(angle)] if turns else []
    values, errors = solution(
        np.column_stack([samples.acceleration[moves], *gravity, friction_regressors(rate)]),
        samples.torque[moves], samples.block[moves])
    return values[0], errors[0]


def held_torque(joint: int) -> Callable:
    """Return a function Recording -> motor torque (T,) at the stamps, not over a sample."""
    # one is of the sample that ended there
    return lambda recording: analysis.means_to_next(recording.tau_motor[:, joint])


def spring_torque(joint: int, stiffness: float, damping=0.0) -> Callable:
    """Return a function Recording -> torque (T,) of the joint's spring."""
    def drive(recording):
        torsion = recording.q_motor[:, joint] - recording.q_link[:, joint]
        rate = np.gradient(torsion, recording.time) if damping else 0.0
        return stiffness * torsion + damping * rate
    return drive


def friction_regressors(rate: np.ndarray, usual: float | None = None) -> np.ndarray:
    """Return regressors of friction (S, 8), by direction; some fade by ``usual`` (rms)."""
    usual = float(np.sqrt(np.mean(rate ** 2))) if usual is None else usual
    regressors = []
    for sign in (1.0, -1.0):
        on = sign * (np.sign(rate) == sign)
        regressors += [on, on * np.abs(rate), *(
            on * np.exp(-np.abs(rate) / (part * usual)) for part in _FADING)]
    return np.stack(regressors, axis=1)


def alike(friction: np.ndarray) -> np.ndarray:
    """Return regressors (S, 4) of friction alike both ways, of `friction_regressors` or such."""
    samples, count = friction.shape
    return friction.reshape(samples, count // _ONE_WAY, _ONE_WAY).sum(axis=1)


class _Model(NamedTuple):
    """Columns (S, C): inertia, gravity, friction, ripple, friction by load, by angle."""

    regressors: np.ndarray
    gravity: slice
    friction: slice
    wave: slice
    load: slice
    placed: slice
    off: float    # robust error on data held out [N m]


def fit_axis(samples: AxisSamples, joint: str, source: str, wave: np.ndarray | None = None,
             turns: bool = True) -> AxisFit:
    """Fit inertia and, where it ``turns``, gravity of an axis, beside the ``wave`` of a ripple."""
    moving = _moving(samples, joint, source)
    samples = AxisSamples(*(part[moving] for part in samples[:-1]))
    wave = np.empty((len(samples.rate), 0)) if wave is None else wave[moving]
    model = _model(samples, wave, turns)
    values, error = solution(model.regressors, samples.torque, samples.block)
    known = values[0] > CONFIDENT * error[0]
    if not known:  # what is no inertia must not bend the rest
        kept, wide = solution(model.regressors[:, 1:], samples.torque, samples.block)
        values, error = np.append(0.0, kept), np.append(error[0], wide)

    def torque_of(part):
        return model.regressors[:, part] @ values[part]
    rest = samples.torque - torque_of(slice(None))
    left, rippling = np.zeros((2, len(moving)))
    left[moving], rippling[moving] = rest, torque_of(model.wave)
    found = np.zeros((2, 4))
    count = model.gravity.stop
    found[:, :count] = values[:count], error[:count]
    friction = torque_of(model.friction) + torque_of(model.placed)
    seen = [np.sum(sign * samples.rate > 0.0) >= FEWEST for sign in (1.0, -1.0)]
    if all(seen) and _is_lopsided(_levels(friction + torque_of(model.load), samples.rate)):
        constant, off = _constant_of(model, samples)
        if abs(constant) > _SURELY * off:
            found[:, 3] = constant, off
    torque = float(np.std(samples.torque)) or 1.0
    levels = np.array(_levels(friction, samples.rate))
    return AxisFit(
        *map(float, found[0]), error=found[1], has_gravity=count > 1,
        friction=max(float(np.mean(levels[seen] if any(seen) else levels)), _LEAST * torque),
        explained=float(1.0 - np.var(rest) / torque ** 2), inertia_known=bool(known),
        share=float(values[0] * np.std(samples.acceleration) / torque), left=left,
        rippling=rippling, wave=values[model.wave], off=model.off,
        wave_error=float(np.sqrt(np.sum(error[model.wave] ** 2))),
        per_load=float(values[model.load].sum()))


def _constant_of(model, samples):
    """Return the torque beside friction that is alike both ways, and its standard error."""
    friction, own = model.friction, model.regressors
    regressors = np.column_stack([np.ones(len(own)), own[:, :friction.start],
                                  alike(own[:, friction]), own[:, friction.stop:]])
    values, errors = solution(regressors, samples.torque, samples.block)
    return values[0], errors[0]


def _moving(samples, joint, source):
    """Return which samples move, bool (S,); IdentificationError where that shows none."""
    moving = _in_motion(samples)
    if moving.sum() < FEWEST:
        raise IdentificationError(f'{source}: {joint} moves in {moving.sum()} samples only; '
                                  'record longer motion to identify its inertia')
    torque = samples.torque[moving]
    if np.ptp(torque) <= _CONSTANT * np.abs(torque).max():
        raise IdentificationError(f'{source}: the torque of {joint} never changes '
                                  f'({torque[0]:.3g} N m) while it moves, which shows no '
                                  'inertia; record the torque that its drive gives, or leave '
                                  f'{joint} out (--joints)')
    return moving


def _in_motion(samples):
    """Return which samples move, bool (S,)."""
    return np.abs(samples.rate) > SLOWEST * np.sqrt(np.mean(samples.rate ** 2))


def _model(samples, wave, turns):
    """Return the _Model of samples that move, gravity and friction by load where they help."""
    regressors, off, has_gravity = _regressors_of(samples, wave, turns)
    plain, count = regressors.shape[1], 3 if has_gravity else 1
    if has_gravity:
        regressors, off = _with_load(regressors, samples, off)
    ends = [1, count, plain - wave.shape[1], plain, min(plain + 1, regressors.shape[1]),
            regressors.shape[1]]
    return _Model(regressors, *map(slice, ends[:-1], ends[1:]), off)


def _regressors_of(samples, waves, turns):
    """
    Return the regressors of the torque, their held-out error, and whether gravity is there.

    Inertia comes first, then cosine and sine of gravity, friction, and ``waves`` (S, W).
    """
    gravity = np.stack([np.cos(samples.angle), np.sin(samples.angle)], axis=1)
    inertia, friction = samples.acceleration[:, None], friction_regressors(samples.rate)
    even, constant = alike(friction), np.ones((len(samples.rate), 1))
    tries = [
        np.concatenate([inertia, *parts, waves], axis=1) for parts in (
            (gravity, friction), (gravity, even), (friction,), (constant, even))]
    both, both_even, others, _ = tries
    with_gravity, with_even, off, level_off = (
        held_out_error(one, samples.torque, samples.block) for one in tries)
    worth = _WORTH if np.ptp(samples.angle) > _NARROW else _CLEAR
    cancelled = _is_cancelled(both, others, samples, waves.shape[1])
    if turns and with_gravity < (_CLEAR if cancelled else worth) * off:
        return both, with_gravity, True
    # what a constant torque takes away is no gravity, unless friction alike both ways leaves it
    if not (turns and cancelled and with_even < worth * min(off, level_off)):
        return others, off, False
    if with_gravity < _WORTH * with_even:
        return both, with_gravity, True
    return both_even, with_even, True


def _is_cancelled(both, others, samples, waves):
    """
    Return whether friction is lopsided with gravity (``both``) and is not without.

    A constant torque then takes away most of it: gravity bends the least where it is largest.
    """
    lopsided = []
    for regressors, count in ((others, 1), (both, 3)):
        values = solution(regressors, samples.torque, samples.block)[0]
        friction = slice(count, regressors.shape[1] - waves)
        torque = regressors[:, friction] @ values[friction]
        lopsided.append(_is_lopsided(_levels(torque, samples.rate)))
    return lopsided[1] and not lopsided[0]


def _with_load(regressors, samples, off):
    """
    Return the regressors and their held-out error, with that of friction by load if it is there.

    After it stand those of friction that varies with the angle, where they help beside it.

    What is carried is the torque that they explain, not the measured one, whose noise
    would explain itself. Friction that varies with the angle must not explain clearly more of the
    variance, unless friction by load is sure and helps beside it: under gravity both change
    together, and its four numbers follow whatever else there is.
    """
    carried = regressors @ solution(regressors, samples.torque, samples.block)[0]
    count = regressors.shape[1]
    for _ in range(_LOADINGS):
        grown = np.column_stack([regressors, np.abs(carried) * np.sign(samples.rate)])
        values, error = solution(grown, samples.torque, samples.block)
        carried = grown @ values
    if values[count] < max(CONFIDENT * error[count], _LEAST):
        return regressors, off
    placed = np.sign(samples.rate)[:, None] * np.column_stack([
        wave(order * samples.angle) for order in _PLACES for wave in (np.cos, np.sin)])
    beside = np.column_stack([grown, placed])
    with_load, rival, both = (held_out_error(one, samples.torque, samples.block) for one in (
        grown, np.column_stack([regressors, placed]), beside))
    explained, rivals = (off ** 2 - one ** 2 for one in (with_load, rival))
    values, error = solution(beside, samples.torque, samples.block)
    if values[count] > max(_SURELY * error[count], _LEAST) and both < _WORTH * rival:
        return (beside, both) if both < _WORTH * with_load else (grown, with_load)
    is_there = with_load < _WORTH * off and explained > _WORTH * rivals
    return (grown, with_load) if is_there else (regressors, off)


def _is_lopsided(levels):
    """Return whether friction forward and backward differs so much that a torque is constant."""
    return min(levels) < _LOPSIDED * max(levels)


def _levels(friction, rate):
    """Return the usual friction forward and backward, against the motion [N m]."""
    return [float(np.median(sign * friction[np.sign(rate) == sign]))
            if (np.sign(rate) == sign).any() else 0.0 for sign in (1.0, -1.0)]


def fit_axis_with_ripple(recordings: Sequence, samples: AxisSamples, joint: int, name: str,
                         source: str, turns: bool = True) -> tuple:
    """Return `fit_axis` with its largest Ripple, and that, None where none helps held-out data."""
    axis, span = fit_axis(samples, name, source, turns=turns), float(np.ptp(samples.angle))
    orders = analysis.standing_out([samples.angle], [axis.left], [samples.rate],
                                   2.0 * np.pi * FEWEST_WAVES / max(span, 1e-300))
    if not orders:
        return axis, None
    found, order = axis, orders[0]
    waves_at = partial(_waves_of, recordings, joint, samples.wider)
    for _ in range(_RIPPLE_ROUNDS):
        order = _nearest_best(waves_at, found.left + found.rippling, order, span)
        found = fit_axis(samples, name, source, waves_at(order), turns)
    size = float(np.hypot(*found.wave))
    if found.off > _WORTH * axis.off or size < _RIPPLE_CLEAR * found.wave_error:
        return axis, None
    phase_error = found.wave_error / size * np.sqrt(12.0) / span  # a line through the phase
    return found, Ripple(size, order, float(np.arctan2(-found.wave[1], -found.wave[0])),
                         found.wave_error, float(phase_error))


def _nearest_best(waves_at, torque, order, span):
    """Return the order near one that explains most of a torque (S,)."""
    moves = torque != 0.0
    target = torque[moves]

    def unexplained(trial):
        waves = waves_at(trial)[moves]
        return np.sum((target - waves @ np.linalg.lstsq(waves, target, rcond=None)[0]) ** 2)
    reach = 2.0 * np.pi * _ABOUT / span
    return float(minimize_scalar(unexplained, bounds=(order - reach, order + reach),
                                 method='bounded', options={'xatol': 1e-3 * reach}).x)


def _waves_of(recordings, joint, wider, order):
    """Return sine and cosine of ``order`` times the angle, filtered as those are, (S, 2)."""
    parts = []
    for recording in recordings:
        angle = recording.q_link[:, joint]
        signals = analysis.smoothed(
            recording.time, [np.sin(order * angle), np.cos(order * angle)],
            wider * analysis.derivative_window(recording.time, angle))
        parts.append(np.stack([signal.value for signal in signals], axis=1))
    return np.concatenate(parts)
