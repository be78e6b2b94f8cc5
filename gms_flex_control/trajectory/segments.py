# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Every reference is a row of segments: a polynomial of degree 9 plus an enveloped sinusoid.

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """
    A reference for n joints over m segments; the last one goes on without end.

    Parameters
    ----------
    start : ndarray, shape (m,)
        When each segment begins, increasing [s].
    scale : ndarray, shape (m,)
        Time unit of the segment's polynomials, usually its duration [s].
    poly : ndarray, shape (m, 10, n_joints)
        Coefficients in powers of (t - start) / scale [rad, or N m for an effort].
    envelope : ndarray, shape (m, 10)
        Polynomial that multiplies the sinusoid.
    amplitude, omega, phase : ndarray, shape (m, n_joints)
        Sinusoid ``amplitude sin(omega (t - start) + phase)`` [rad, rad/s, rad].
    end : float
        When the motion has come to its end; infinite if it never does [s].
    quantity : {'motion', 'effort'}
        A link angle with derivatives, or an open-loop torque.

    Raises
    ------
    TrajectoryError
        If a shape does not fit or the segments are out of order.

    """

    start: np.ndarray
    scale: np.ndarray
    poly: np.ndarray
    envelope: np.ndarray
    amplitude: np.ndarray
    omega: np.ndarray
    phase: np.ndarray
    end: float = np.inf
    quantity: str = 'motion'

    def __post_init__(self):
        m, _, n = np.shape(self.poly)
        shapes = {'start': (m,), 'scale': (m,), 'poly': (m, COEFFICIENTS, n),
                  'envelope': (m, COEFFICIENTS), 'amplitude': (m, n), 'omega': (m, n),
                  'phase': (m, n)}
        for name, shape in shapes.items():
            value = np.ascontiguousarray(getattr(self, name), dtype=float)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise TrajectoryError(f'{name} of a trajectory must be finite with shape '
                                      f'{shape}, got {value}')
            object.__setattr__(self, name, value)
        if np.any(np.diff(self.start) < 0) or np.any(self.scale <= 0):
            raise TrajectoryError(f'segments must follow each other, got start {self.start} '
                                  f'and scale {self.scale}')

    @property
    def n_joints(self):
        """Return the number of joints."""
        return self.poly.shape[2]

    def sample(self, time):
        """
        Return the reference and its derivatives.

        Parameters
        ----------
        time : float or ndarray, shape (T,)
            Time [s]; before the first segment its beginning counts.

        Returns
        -------
        ndarray, shape (5, n_joints) or (T, 5, n_joints)
            Value and time derivatives 1 to 4.

        """
        times = np.atleast_1d(np.asarray(time, dtype=float))
        out = np.empty((len(times), DERIVATIVES, self.n_joints))
        sample_all(times, self.start, self.scale, self.poly, self.envelope, self.amplitude,
                   self.omega, self.phase, out)
        return out if np.ndim(time) else out[0]

    def shifted(self, delay):
        """Return the same trajectory beginning ``delay`` seconds later."""
        return replace(self, start=self.start + delay, end=self.end + delay)


@compiled
def poly_derivatives(coefficients, x, rate, out):
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
def wave_derivatives(amplitude, omega, angle, out):
    """Write ``amplitude sin(angle)`` and its time derivatives 1 to 4 to ``out`` (5,)."""
    sine, cosine = amplitude * np.sin(angle), amplitude * np.cos(angle)
    for k in range(DERIVATIVES):
        out[k] = sine
        sine, cosine = omega * cosine, -omega * sine


@compiled
def sample_all(times, start, scale, poly, envelope, amplitude, omega, phase, out):
    """Evaluate the segments at ``times`` (T,) into ``out`` (T, 5, n)."""
    shape, wave = np.empty(DERIVATIVES), np.empty(DERIVATIVES)
    binomial = np.array([[1, 0, 0, 0, 0], [1, 1, 0, 0, 0], [1, 2, 1, 0, 0], [1, 3, 3, 1, 0],
                         [1, 4, 6, 4, 1]])
    for i in range(times.shape[0]):
        m = max(np.searchsorted(start, times[i], side='right') - 1, 0)
        local = max(times[i] - start[m], 0.0)
        rate = 1.0 / scale[m]
        for j in range(poly.shape[2]):
            poly_derivatives(poly[m, :, j], local * rate, rate, out[i, :, j])
            if amplitude[m, j] == 0.0:
                continue
            poly_derivatives(envelope[m], local * rate, rate, shape)
            wave_derivatives(amplitude[m, j], omega[m, j], omega[m, j] * local + phase[m, j],
                             wave)
            for k in range(DERIVATIVES):  # Leibniz rule
                for r in range(k + 1):
                    out[i, k, j] += binomial[k, r] * shape[r] * wave[k - r]


@compiled
def extrapolate(reference, delay):
    """
    Return a sampled reference moved in time by its Taylor series.

    Parameters
    ----------
    reference : ndarray, shape (5, n_joints)
        Value and derivatives 1 to 4.
    delay : float
        How much later, a few samples at most [s].

    Returns
    -------
    ndarray, shape (5, n_joints)

    """
    moved = np.zeros_like(reference)
    for k in range(DERIVATIVES):
        factor = 1.0
        for m in range(k, DERIVATIVES):
            moved[k] += factor * reference[m]
            factor *= delay / (m - k + 1)
    return moved
