# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What signals say of themselves: resolution, derivatives without lag, signs of torque, waves."""

from collections.abc import Iterable
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.linalg import lstsq
from scipy.ndimage import correlate1d, uniform_filter1d
from scipy.optimize import nnls

# Windows of filters [s]. A local cubic fit, see `derivatives`:
RATE_WINDOW = 0.034    # from which residual torques take rates and accelerations
EFFECT_WINDOW = 0.05   # likewise known effects, where friction is fitted beside them
TORSION_WINDOW = 0.05  # rate of the deflection of a spring
AGREE_WINDOW = 0.2     # at least, where spring and motor torque are compared: a controller answers
#                        the steps of encoders with torque that is over before one sees it move
_CUBIC_WINDOWS = 0.02, 0.4  # of `smoothing_window`, which follows the noise
# Four moving averages, see `low_pass` and `smoothed`:
LINKS_WINDOW = 0.05    # at least, in the regression of an arm: the noise of encoders grows with
#                        the square of frequency, motion determines inertia far below 9 Hz, its end
UNSEEN_BAND = 1.0, 20.0  # in which the angle of a link without encoder is computed [Hz]
_BELL_WINDOWS = 0.1, 1.0  # of `derivative_window`, which follows the encoder's steps
SETTLED = 0.5          # at both ends of a recording, after which filters have settled

# Blocks of time: errors within one depend on each other, as long as friction remembers
BLOCK_TIME = 2.0       # [s]
FOLDS = 5              # one in so many blocks is left out, each in turn
FRICTION_FOLDS = 4     # likewise, where a fit of friction through the predictor is repeated

MOVING = 0.02        # below this part of the top speed a direction is not relied on
BESIDE = 5           # samples that give the speed beside others
_HELD = 0.1          # s, as often a slow source gives a reading: longer ones stand
_ORDER_STEPS = 20    # resolution steps a derivative window should travel at top speed
_SPEED_TIME = 0.25   # in which a speed is looked for [s]
NORMAL_MEDIAN = 0.6745  # of the size of a normal variable, in standard deviations


class Derivatives(NamedTuple):
    """A signal and its first two derivatives, all through the same zero-phase filter."""

    value: np.ndarray
    first: np.ndarray
    second: np.ndarray


class Fit(NamedTuple):
    """How much of a signal columns of one sign explain, as it is and with its sign reversed."""

    as_is: float          # share of the variance, 0 to 1
    opposite: float       # the same of the reversed signal
    weights: np.ndarray   # of the columns, as it is; 0 or above
    left: float           # share of the variance that the free columns leave to be explained


def quantum(values) -> float:
    """Return the smallest step of a signal (T,), 0 if it never changes; rounding is no step."""
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    steps = steps[steps > 1e-9 * np.ptp(known)] if known.size else steps
    return float(steps.min()) if steps.size else 0.0


def runs(where: np.ndarray) -> np.ndarray:
    """Return begin and end (R, 2) of each run in which a mask (T,) is true, ends left out."""
    return np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8))
                          ).reshape(-1, 2)


def derivative_window(time, position) -> float:
    """Return the length of a filter window, 0.1 to 1 s, that sees motion through encoder steps."""
    known = np.isfinite(position)
    t, q = time[known], position[known]
    blocks = np.flatnonzero(np.diff(np.floor(t / _SPEED_TIME), prepend=-1.0)) if len(t) else t
    if len(blocks) < 3:
        return _BELL_WINDOWS[0]
    travel = np.maximum.reduceat(q, blocks) - np.minimum.reduceat(q, blocks)
    top = np.quantile(travel, 0.9) / _SPEED_TIME
    wanted = _ORDER_STEPS * quantum(position) / top if top > 0 else np.inf
    return float(np.clip(wanted, *_BELL_WINDOWS))


def top_speed(time, angle) -> float:
    """Return about how fast an angle (T,) moves at most [rad/s]."""
    across = np.abs(angle[2 * BESIDE:] - angle[:-2 * BESIDE]) / (time[2 * BESIDE:]
                                                                 - time[:-2 * BESIDE])
    across = across[np.isfinite(across)]
    # a jump adds but a tenth of itself to this
    return 1.5 * float(across.max()) if across.size else 0.0


def jumps(time, angle, period) -> tuple[np.ndarray, float]:
    """
    Return the samples (K,) to which an angle (T,) jumps, worst first, and its most in a period.

    All angles are known.
    """
    changed = np.flatnonzero(np.concatenate([[True], np.diff(angle) != 0.0])[:len(angle)])
    if len(changed) < 20:
        return changed[:0], 0.0
    # what a source slower than the log has moved since its last reading comes at once
    gaps, time, angle = np.diff(time)[changed[1:] - 1], time[changed], angle[changed]
    since = np.minimum(np.diff(time), _HELD)
    steps = np.diff(angle) * np.minimum(period / since, 1.0)
    odd = np.abs(steps - np.median(_beside(steps), axis=0))
    top = period * top_speed(time, angle)
    limit = max(3 * np.quantile(odd, 0.99), 4 * quantum(angle), 2 * top)
    # where the clock is wrong, so are the steps
    trusted = np.minimum(np.min(_beside(gaps), axis=0), gaps) > 0.5 * period
    found = np.flatnonzero((odd > limit) & trusted & (gaps < 5 * period))
    return changed[found[np.argsort(-odd[found], kind='stable')] + 1], top


def _beside(values):
    """Return the two values before and behind each of (T,), shape (4, T)."""
    padded = np.pad(values, 2, mode='edge')
    return np.array([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])


def stamped_amiss(time, angle, period) -> np.ndarray:
    """
    Return the samples (K,) at which a known angle (T,) seems to jump because of their stamps.

    To the sample and from it the angle moves one way, and in both gaps together as fast as before
    and after them: the sample was taken at another time between. A jump would add to that way.
    """
    found = []
    for row in jumps(time, angle, period)[0]:
        for at in (row, row - 1):  # too early, or the one before too late
            if not BESIDE < at < len(angle) - BESIDE - 1:
                continue
            places = at + np.array([-1 - BESIDE, -1, 1, 1 + BESIDE])
            before, across, after = np.diff(angle[places]) / np.diff(time[places])
            way = np.sign(across)
            slowest, fastest = sorted((way * before, way * after))
            if 0.5 * slowest < abs(across) < 1.5 * fastest and (
                    way * np.diff(angle[at - 1:at + 2]) >= 0.0).all():
                found.append(at)
                break
    return np.array(found, dtype=int)


def smoothed(time, signals, window) -> list[Derivatives]:
    """
    Filter signals (T,) alike and without lag, with their derivatives, on a coarse even grid.

    Uneven stamps ``time`` (T,) [s] are interpolated, and NaN is bridged by it. The filter is
    bell-shaped, four moving averages in a row, ``window`` [s] long; each of the Derivatives has
    one value per quarter window, none for a short recording. A linear relation between signals and
    derivatives holds for the filtered ones exactly, so nothing is lost by filtering them, and
    noise is never differentiated by itself.
    """
    step = float(np.median(np.diff(time)))
    count = int((time[-1] - time[0]) / step * (1 + 1e-12)) + 1
    grid = time[0] + step * np.arange(count)
    short = max(3, round(window / 4 / step))
    box = np.full(short, 1.0 / short)
    bell = np.convolve(np.convolve(box, box), np.convolve(box, box))
    kernels = [kernel[::-1] for kernel in (
        np.pad(bell, 1), np.convolve(bell, [0.5, 0.0, -0.5]) / step,
        np.convolve(bell, [1.0, -2.0, 1.0]) / step ** 2)]
    length, result = len(kernels[0]), []
    inside = np.arange(-(-(length - 1) // short), (count - 1) // short + 1)
    around = short * inside[:, None] + np.arange(1 - length, 1)
    for signal in signals:
        known = np.isfinite(signal)
        even = np.interp(grid, time[known], signal[known]) if known.any() else np.zeros(count)
        # the mean is taken off: the second derivative of a large offset is rounding
        mean = even.mean()
        seen = (even - mean)[around]
        value, first, second = (np.cumsum(seen * kernel, axis=1)[:, -1] for kernel in kernels)
        result.append(Derivatives(value + mean, first, second))
    return result


def sign_fit(signal, positive, free) -> Fit:
    """Fit columns to a signal (S,) and to its reverse: ``positive`` ones, beside ``free`` ones."""
    basis = np.linalg.qr(np.stack(free, axis=1))[0]
    both = np.stack([signal, *positive], axis=1)
    whole = np.sum((signal - signal.mean()) ** 2)
    both = both - basis @ (basis.T @ both)
    norms = np.sqrt(np.sum(both ** 2, axis=0))
    if norms[0] ** 2 <= 1e-18 * np.sum(signal ** 2):
        return Fit(0.0, 0.0, np.zeros(len(positive)), 0.0)
    scale = np.where(norms > 0, norms, 1.0)
    unit = both / scale
    weights, rest = nnls(unit[:, 1:], unit[:, 0])
    _, rest_reversed = nnls(unit[:, 1:], -unit[:, 0])
    return Fit(1 - rest ** 2, 1 - rest_reversed ** 2, weights * norms[0] / scale[1:],
               float(norms[0] ** 2 / whole) if whole > 0 else 1.0)


def friction_columns(velocity) -> tuple:
    """Return sign, softened below MOVING of the top speed, and value of a velocity (S,)."""
    top = float(np.abs(velocity).max(initial=0.0))
    return np.tanh(velocity / (MOVING * top)) if top > 0 else velocity, velocity


def is_moving(velocity) -> np.ndarray:
    """Return where a velocity (S,) is above MOVING of its largest."""
    return np.abs(velocity) > MOVING * np.abs(velocity).max(initial=0.0)


def derivative_slope(time, position, velocity) -> tuple[float, float] | None:
    """
    Compare what a velocity adds up to with the way gone, over 0.1 s, 20 samples or 20 steps.

    Return what the velocity [rad/s] is of the derivative of the position [rad], and their
    correlation; None where there is too little motion for the encoder's steps.
    """
    good = np.isfinite(position) & np.isfinite(velocity)
    t, q, v = time[good], position[good], velocity[good]
    if len(t) < 50:
        return None
    step = float(np.median(np.diff(t)))
    width = max(20, int(np.ceil(derivative_window(t, q) / step)))
    added = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    gone, expected = q[width:] - q[:-width], added[width:] - added[:-width]
    whole = t[width:] - t[:-width] < 1.5 * width * step  # without gaps
    gone, expected = gone[whole], expected[whole]
    if len(gone) < 10 or not gone.any() or not expected.any():
        return None
    if np.sqrt(np.mean(gone ** 2)) < 3 * quantum(q):
        return None
    return (float(np.dot(gone, expected) / np.dot(gone, gone)),
            float(np.dot(gone, expected)
                  / np.sqrt(np.dot(gone, gone) * np.dot(expected, expected))))


MOST = 3              # waves per joint
_FASTEST = 20.0       # a wave that passes more often at the usual speed is not looked for [Hz]
_PER_WAVE = 8.0       # bins of the angle per wave, at least
_MOST_BINS = 2 ** 22
_FINER = 8            # orders looked at per order that the span resolves
_SLOW = 0.1           # of the usual speed: below this a joint does not move
_STANDS_OUT = 20.0    # power over the median about it; noise alone reaches 10
_ABOUT = 1.5          # the median is taken from an order over this to one times this


def standing_out(angles, torques, rates, coarsest, fastest=_FASTEST) -> tuple:
    """
    Return the orders [1/rad], floats, at which the spectrum of torque over angle stands out.

    Behind a gear, or on a slide in metres, the teeth of a wave generator or the lead of a screw
    make hundreds of waves per radian or metre. The spectrum over the angle, not over time, shows
    them: passes at any speed add up there. Of each recording motor angle [rad], what is left of
    the torque [N m], and rate [rad/s], (S,) each; ``coarsest`` is the least order [1/rad].
    """
    span = max(float(np.ptp(angle)) for angle in angles)
    speed = float(np.sqrt(np.mean(np.concatenate(rates) ** 2)))
    if span <= 0.0 or speed <= 0.0:
        return ()
    finest = 2.0 * np.pi * fastest / speed
    bins = int(np.ceil(_PER_WAVE * finest * span / (2.0 * np.pi)))
    if finest <= coarsest or bins > _MOST_BINS:
        return ()
    width, length = span / bins, 2 ** int(np.ceil(np.log2(_FINER * bins)))
    power = 0.0
    for angle, torque, rate in zip(angles, torques, rates, strict=True):
        moving = np.abs(rate) > _SLOW * speed
        place = np.minimum(((angle - angle.min()) / width).astype(int), bins - 1)[moving]
        forward = rate[moving] > 0.0
        for way in (forward, ~forward):  # friction jumps from one to the other
            count = np.bincount(place[way], minlength=bins)
            if not count.any():
                continue
            mean = np.bincount(place[way], torque[moving][way], bins) / np.maximum(count, 1)
            mean[count > 0] -= mean[count > 0].mean()
            power = power + np.abs(np.fft.rfft(mean, length)) ** 2
    orders = 2.0 * np.pi * np.arange(length // 2 + 1) / (length * width)
    return _peaks(orders, np.broadcast_to(power, orders.shape), coarsest, finest,
                  2.0 * np.pi / span)


def _peaks(orders, power, lowest, highest, apart):
    """Return where power stands out of what is about it, peaks ``apart`` at least."""
    inside, found = (orders >= lowest) & (orders <= highest), []
    power = np.where(inside, power, 0.0)
    while len(found) < MOST and power.any():
        best = int(np.argmax(power))
        about = (orders > orders[best] / _ABOUT) & (orders < orders[best] * _ABOUT) & inside
        if power[best] < _STANDS_OUT * np.median(power[about]):
            break
        found.append(float(orders[best]))
        power[np.abs(orders - orders[best]) < 2.0 * apart] = 0.0
    return tuple(found)


_ORDER = 3            # of the local fit of `derivatives`
_TORQUE_NOISE = 0.02  # of the usual torque: what noise of the acceleration may amount to
_BANDWIDTH = 0.226  # of four moving averages in a row, times the length of one
_CUBIC_NOISE = np.sqrt(720.0)  # of a second derivative, times window^-2.5 and step^-2


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square, NaN of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def second_difference(angle: np.ndarray, period: float) -> np.ndarray:
    """Return the central second difference of angles (T, ...), zero at both ends."""
    out = np.zeros_like(angle)
    out[1:-1] = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / period ** 2
    return out


def held_triangle(torque: np.ndarray) -> np.ndarray:
    """
    Return torques (T, n) held from sample k to k + 1 as a second difference sees them.

    Under a force held over each sample, ``q[k+1] - 2 q[k] + q[k-1]`` is exactly the mean of both
    samples' accelerations times the squared period.
    """
    out = torque.copy()
    out[1:] = 0.5 * (torque[1:] + torque[:-1])
    return out


def means_to_next(values: np.ndarray) -> np.ndarray:
    """Return the means (T, ...) of each sample and the next, the last one as it is."""
    return np.concatenate([0.5 * (values[1:] + values[:-1]), values[-1:]])


def smoothing_window(period: float, noise: float, inertia: float, torque: float) -> int:
    """
    Return the samples of a window behind which the acceleration's noise is a small torque.

    Odd, at least 5. ``noise`` is the standard deviation of the angle [rad], that of a count its
    step over sqrt(12); ``inertia`` [kg m^2] times the acceleration is compared with the usual
    ``torque`` [N m]; sample ``period`` [s].
    """
    allowed = max(_TORQUE_NOISE * torque, 1e-300)
    length = (_CUBIC_NOISE * noise * inertia / allowed / period ** 2) ** 0.4
    shortest, longest = _CUBIC_WINDOWS
    return odd_window(np.clip(length, shortest / period, longest / period))


def odd_window(length: float) -> int:
    """Return an odd number of samples near a length, 5 at least."""
    return max(2 * round(length / 2) + 1, 5)


def white_noise_of(signal: np.ndarray) -> float:
    """Return the standard deviation of the white noise of a smooth signal (T,); few jumps pass."""
    return float(np.nanmedian(np.abs(np.diff(signal, 3)))) / np.sqrt(20.0) / NORMAL_MEDIAN


def noise_of(angle: np.ndarray) -> float:
    """Return the standard deviation of an angle's noise (T,), rounding included [rad]."""
    known = angle[np.isfinite(angle)]
    spread = float(np.std(np.diff(known, 3))) / np.sqrt(20.0)
    return max(min(spread, quantum(known) / np.sqrt(12.0)), white_noise_of(known), 1e-12)


def low_pass(values: np.ndarray, window: int) -> np.ndarray:
    """
    Return values (T, ...) through a zero-phase low-pass that hides what `derivatives` do.

    Four moving averages in a row, half of the ``window`` of `derivatives` each: the passband, to
    `low_pass_bandwidth`, is where the local cubic fit leaves motion as it is. Torque and model
    compared behind it differ by the model, not by the filter.
    """
    size = max(window // 2, 1)
    for k in range(4):  # of an even size, each is half a sample late or early: in turn
        values = uniform_filter1d(values, size, axis=0, mode='nearest',
                                  origin=0 if size % 2 else -(k % 2))
    return values


def low_pass_bandwidth(window: int, period: float) -> float:
    """Return the frequency [Hz] at which `low_pass` has lost 3 dB."""
    return _BANDWIDTH / (max(window // 2, 1) * period)


def low_pass_window(bandwidth: float, period: float) -> int:
    """Return the window whose `low_pass_bandwidth` is nearest to a frequency [Hz]."""
    return 2 * max(round(_BANDWIDTH / (bandwidth * period)), 1)


def derivatives(values: np.ndarray, period: float, window: int,
                orders: Iterable[int] = range(3)) -> tuple:
    """
    Return values (T, ...), evenly sampled without gaps, and two derivatives, all without lag.

    All three through the same local cubic fit (Savitzky-Golay) of ``window`` samples, odd; or
    only those ``orders`` of derivative that are asked for.
    """
    window = min(window, 2 * ((len(values) - 1) // 2) + 1)
    half, out = window // 2, []
    for order in orders:
        rows = _local_fit(window, min(_ORDER, window - 1), order) / period ** order
        one = correlate1d(values, rows[half], axis=0, mode='constant')
        if half:
            one[:half] = np.tensordot(rows[:half], values[:window], 1)
            one[-half:] = np.tensordot(rows[half + 1:], values[-window:], 1)
        out.append(one)
    return tuple(out)


@lru_cache(maxsize=64)
def _local_fit(window, degree, order):
    """Return the derivatives (W, W) at each of W samples, of period 1, of the fit to all."""
    powers, places = np.arange(degree + 1), np.arange(float(window))
    wanted = float(factorial(order)) * (powers == order)
    return np.array([lstsq((places - at) ** powers[:, None], wanted)[0] for at in range(window)])
