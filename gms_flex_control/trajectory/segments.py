# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Every reference is a sequence of segments: a polynomial of degree 9 plus an enveloped sinusoid.

One compiled function evaluates all of them with their derivatives to the fourth, so the
trajectory node and the in-process simulation give the same bits.
"""

from dataclasses import dataclass, replace

from gms_flex_control.compiled import compiled
from gms_flex_control.errors import TrajectoryError
import numpy as np

DERIVATIVES = 5
DEGREE = 9
COEFFICIENTS = DEGREE + 1
_SEGMENTED = ('start', 'scale', 'poly', 'envelope', 'amplitude', 'omega', 'phase')


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """
    A reference for n joints over m segments; the last one goes on without end.

    TrajectoryError if a shape does not fit or the segments are out of order.
    """

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
        """
        Return the reference and its time derivatives 1 to 4.

        (5, n_joints) at a time, (T, 5, n_joints) at times (T,) [s]; before the first segment its
        beginning counts.
        """
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


@compiled
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


@compiled
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
            moved[k] += factor * reference[m]
            factor *= delay / (m - k + 1)
    return moved
