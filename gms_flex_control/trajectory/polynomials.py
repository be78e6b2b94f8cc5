# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""References: polynomials over time, joined, scaled, and held against the limits of an arm."""

from dataclasses import dataclass, replace
from functools import cache
from math import comb

from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.errors import TrajectoryError
from gms_flex_control.params.arm import Frames
import numpy as np

DERIVATIVES = 5
DEGREE = 9
COEFFICIENTS = DEGREE + 1
_SEGMENTED = ('start', 'scale', 'poly', 'envelope', 'amplitude', 'omega', 'phase')


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """A reference for n joints over m segments, the last endless; TrajectoryError if malformed."""

    start: np.ndarray      # (m,) when each segment begins, increasing [s]
    scale: np.ndarray      # (m,) time unit of the segment's polynomials, often its duration [s]
    poly: np.ndarray       # (m, 10, n) in powers of (t - start) / scale [rad, or N m of an effort]
    envelope: np.ndarray   # (m, 10) polynomial that multiplies the sinusoid
    amplitude: np.ndarray  # (m, n) of amplitude sin(omega (t - start) + phase) [rad]
    omega: np.ndarray      # (m, n) [rad/s]
    phase: np.ndarray      # (m, n) [rad]
    end: float = np.inf    # of the motion [s]
    quantity: str = 'motion'  # a link angle with derivatives, or 'effort', an open-loop torque

    def __post_init__(self):
        m, _, n = np.shape(self.poly)
        shapes = ((m,), (m,), (m, COEFFICIENTS, n), (m, COEFFICIENTS), (m, n), (m, n), (m, n))
        for name, shape in zip(_SEGMENTED, shapes, strict=True):
            value = np.ascontiguousarray(getattr(self, name), dtype=float)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise TrajectoryError(f'{name} of a trajectory must be finite with shape '
                                      f'{shape}, got {value}')
            object.__setattr__(self, name, value)
        if np.any(np.diff(self.start) < 0) or np.any(self.scale <= 0):
            raise TrajectoryError(f'segments must follow each other, got start {self.start} '
                                  f'and scale {self.scale}')

    @property
    def n_joints(self) -> int:
        """Return the number of joints."""
        return self.poly.shape[2]

    def sample(self, time) -> np.ndarray:
        """Return the reference and derivatives 1 to 4, (5, n_joints) or (T, 5, n_joints)."""
        times = np.atleast_1d(np.asarray(time, dtype=float))
        out = np.empty((len(times), DERIVATIVES, self.n_joints))
        _sample_all(times, *(getattr(self, name) for name in _SEGMENTED), out)
        return out if np.ndim(time) else out[0]

    def shifted(self, delay) -> 'Trajectory':
        """Return the same trajectory beginning ``delay`` seconds later."""
        return replace(self, start=self.start + delay, end=self.end + delay)

    def displaced(self, offset) -> 'Trajectory':
        """Return the trajectory with ``offset`` (n_joints,) added to its angle or torque."""
        poly = self.poly.copy()
        poly[:, 0, :] += np.asarray(offset, dtype=float)
        return replace(self, poly=poly)

    def part(self, segments) -> 'Trajectory':
        """Return the trajectory of a slice of its segments."""
        return replace(self, **{name: getattr(self, name)[segments] for name in _SEGMENTED})


def joined(parts, *, end) -> Trajectory:
    """Return the segments of Trajectories one after another, ending at ``end`` [s]."""
    return replace(parts[0], end=end, **{
        name: np.concatenate([getattr(part, name) for part in parts]) for name in _SEGMENTED})


@compiled_part
def _poly_derivatives(coefficients, x, rate, out):
    """Write value and time derivatives 1 to 4 of a polynomial in x, dx/dt = rate, to ``out``."""
    scale = 1.0
    for k in range(DERIVATIVES):
        total = 0.0
        for power in range(DEGREE, k - 1, -1):
            factor = 1.0
            for m in range(k):
                factor *= power - m
            total = total * x + factor * coefficients[power]
        out[k] = total * scale
        scale *= rate


@compiled_part
def _wave_derivatives(amplitude, omega, angle, out):
    """Write ``amplitude sin(angle)`` and its time derivatives 1 to 4 to ``out`` (5,)."""
    sine, cosine = amplitude * np.sin(angle), amplitude * np.cos(angle)
    for k in range(DERIVATIVES):
        out[k] = sine
        sine, cosine = omega * cosine, -omega * sine


@compiled
def _sample_all(times, start, scale, poly, envelope, amplitude, omega, phase, out):
    """Evaluate the segments at ``times`` (T,) into ``out`` (T, 5, n)."""
    shape, wave = np.empty(DERIVATIVES), np.empty(DERIVATIVES)
    binomial = np.array([[1, 0, 0, 0, 0], [1, 1, 0, 0, 0], [1, 2, 1, 0, 0], [1, 3, 3, 1, 0],
                         [1, 4, 6, 4, 1]])
    for i in range(times.shape[0]):
        m = max(np.searchsorted(start, times[i], side='right') - 1, 0)
        local = max(times[i] - start[m], 0.0)
        rate = 1.0 / scale[m]
        for j in range(poly.shape[2]):
            _poly_derivatives(poly[m, :, j], local * rate, rate, out[i, :, j])
            if amplitude[m, j] == 0.0:
                continue
            _poly_derivatives(envelope[m], local * rate, rate, shape)
            _wave_derivatives(amplitude[m, j], omega[m, j], omega[m, j] * local + phase[m, j],
                              wave)
            for k in range(DERIVATIVES):  # Leibniz rule
                for r in range(k + 1):
                    out[i, k, j] += binomial[k, r] * shape[r] * wave[k - r]


@compiled
def extrapolate(reference, delay) -> np.ndarray:
    """Return a sampled reference (5, n_joints) a few samples later [s], by its Taylor series."""
    moved = np.zeros_like(reference)
    for k in range(DERIVATIVES):
        factor = 1.0
        for m in range(k, DERIVATIVES):
            for j in range(reference.shape[1]):
                moved[k, j] += factor * reference[m, j]
            factor *= delay / (m - k + 1)
    return moved


_STEP = 2e-3       # between the times at which a motion is sampled [s]
_MOST = 500        # samples of a polynomial, however long it lasts
_ROUNDING = 1e-6   # beyond a limit, relative
_PIECES = 8        # of a polynomial, each of which is bounded by its Bernstein coefficients


def require_within(trajectory: Trajectory, joints, frames: Frames | None, offset, *,
                   segments: int | None = None) -> None:
    """
    Raise TrajectoryError if a motion leaves the position or velocity limits of a URDF.

    ``offset`` (n_joints,) is what the URDF adds to the angles of the robot ``joints``. A robot
    that stands beyond a limit may move inwards. Without frames there are no limits; an open-loop
    torque is not checked. ``segments`` checks only so many at the beginning.

    Notes
    -----
    A polynomial lies between the least and the largest of its Bernstein coefficients. Only
    segments that these do not prove to be within the limits are sampled.

    """
    if frames is None or trajectory.quantity != 'motion':
        return
    begin = trajectory.sample(trajectory.start[0])[0] + offset
    upper, lower = np.maximum(frames.upper, begin), np.minimum(frames.lower, begin)
    duration = _durations(trajectory)[:segments]
    least, most, fastest = _bounds(trajectory, duration)
    doubtful = ((most + offset > upper) | (least + offset < lower)
                | (fastest > frames.velocity)).any(axis=1)
    for m in np.flatnonzero(doubtful):
        count = max(2, int(np.ceil(duration[m] / _STEP)) + 1)
        if not trajectory.amplitude[m].any():
            count = min(count, _MOST)
        time = trajectory.start[m] + np.linspace(0.0, duration[m], count)
        _judge(trajectory, time, joints, frames, offset, upper, lower)


def _judge(trajectory, time, joints, frames, offset, upper, lower):
    """Raise TrajectoryError for the first joint that is beyond a limit at one of the times."""
    angle, rate = np.moveaxis(trajectory.sample(time)[:, :2], 1, 0)
    angle = angle + offset
    for j, joint in enumerate(joints):
        unit = 'm' if frames.prismatic[j] else 'rad'
        fastest = frames.velocity[j]
        for verb, values, limit, beyond, per in (
                ('goes to', angle[:, j], upper[j], angle[:, j] - upper[j], ''),
                ('goes to', angle[:, j], lower[j], lower[j] - angle[:, j], ''),
                ('moves at', rate[:, j], fastest, np.abs(rate[:, j]) - fastest, '/s')):
            k = np.argmax(beyond)
            if beyond[k] > _ROUNDING * abs(limit):
                raise TrajectoryError(
                    f'{joint} {verb} {values[k]:.4g} {unit}{per} at '
                    f'{time[k] - trajectory.start[0]:.3g} s, beyond its limit of {limit:.4g} '
                    f'{unit}{per} in {frames.source}; reduce the motion of that joint, or give '
                    'it more time')


def _durations(trajectory):
    """Return how long each segment lasts (m,), the last one a period of its sinusoid [s]."""
    turning = trajectory.amplitude[-1] != 0.0
    last = (2.0 * np.pi / np.abs(trajectory.omega[-1][turning])).max(initial=0.0)
    return np.append(np.diff(trajectory.start), last)


def _bounds(trajectory, duration):
    """Return least and most value and largest rate of the first segments, each (m, n_joints)."""
    m = len(duration)
    scale = trajectory.scale[:m, None, None]
    reach = (duration[:, None] / trajectory.scale[:m, None]) ** np.arange(COEFFICIENTS)
    poly = trajectory.poly[:m]
    shape, amplitude = trajectory.envelope[:m, :, None], np.abs(trajectory.amplitude[:m])
    value, rate, envelope, change = (
        _hull() @ (coefficients * reach[:, :, None]) for coefficients in (
            poly, _derivative(poly) / scale, shape, _derivative(shape) / scale))
    wave = np.abs(envelope).max(axis=1) * amplitude
    turn = np.abs(change).max(axis=1) * amplitude + wave * np.abs(trajectory.omega[:m])
    return (value.min(axis=1) - wave, value.max(axis=1) + wave, np.abs(rate).max(axis=1) + turn)


def _derivative(coefficients):
    """Return the coefficients (m, 10, n) of the derivative of polynomials."""
    powers = np.arange(1, COEFFICIENTS)[:, None]
    return np.concatenate([coefficients[:, 1:] * powers, 0.0 * coefficients[:, :1]], axis=1)


@cache
def _hull():
    """Return the matrix from coefficients on [0, 1] to Bernstein coefficients of all pieces."""
    powers = range(COEFFICIENTS)
    bernstein = np.array([[comb(i, k) / comb(DEGREE, k) for k in powers] for i in powers])
    pieces = [np.array([[comb(p, k) * piece ** (p - k) / _PIECES ** p if p >= k else 0.0
                         for p in powers] for k in powers]) for piece in range(_PIECES)]
    return np.concatenate([bernstein @ piece for piece in pieces])
