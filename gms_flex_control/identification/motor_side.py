# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Stiffness, motor inertia and joint damping from the motor's equation, link friction unseen.

``u = J q2'' + K (q2 - q1) + d (q2' - q1')`` by linear regression of channels that pass through
one zero-phase filter. Columns of a constant and of the velocity stand by: a motor's own
friction, and an encoder that is read late, which adds ``K delay q'`` and looks like damping.
"""

from typing import NamedTuple

from gms_flex_control.data.signals import derivative_window, smoothed
from gms_flex_control.identification.result import CONFIDENT
from gms_flex_control.identification.rigid_body import held_torque, robust
import numpy as np

_BLOCK = 2.0
_FEWEST = 60
_EXPLAINED = 0.9   # of the torque's variance, for stiffness and motor inertia to be believed
_SMALLEST = 0.005  # of the torque: a smaller part is not told from what the model lacks
_SKEWED = 0.3      # part of the twist's torque that goes with the velocity, at most


class MotorFit(NamedTuple):
    """The motor's side of one flexible joint."""

    motor_inertia: float   # J [kg m^2]
    stiffness: float       # K [N m/rad]
    damping: float         # d [N m s/rad]
    error: np.ndarray      # (3,), standard errors
    explained: float       # share of the torque's variance
    skew: float            # torque that goes with the velocity, of that of the twist
    share: np.ndarray      # (3,), torque of each part over the whole

    @property
    def believed(self):
        """Return which of J, K and d the data tell, bool (3,)."""
        values = np.array(self[:3])
        told = (values > CONFIDENT * self.error) & (self.share > _SMALLEST)
        return told & (self.explained > _EXPLAINED) & (self.skew < _SKEWED)


def fit_motor(recordings, joint):
    """
    Fit the motor's equation of one joint.

    Parameters
    ----------
    recordings : sequence of Recording
        All data, both sides and the torque measured.
    joint : int
        Which joint.

    Returns
    -------
    MotorFit or None
        None if there are too few samples.

    """
    drive, parts, used = held_torque(joint), [], 0
    for recording in recordings:
        angles = recording.q_motor[:, joint], recording.q_link[:, joint]
        window = max(derivative_window(recording.time, angle) for angle in angles)
        time, motor, link, torque = smoothed(
            recording.time, [recording.time, *angles, drive(recording)], window)
        if len(time.value):
            block = used + ((time.value - time.value[0]) / _BLOCK).astype(int)
            used = block[-1] + 1
            twist, rate = motor.value - link.value, motor.first - link.first
            parts.append(np.stack([torque.value, motor.second, twist, rate,
                                   np.ones(len(twist)), link.first, np.sign(link.first), block]))
    if not parts or sum(part.shape[1] for part in parts) < _FEWEST:
        return None
    table = np.concatenate(parts, axis=1)
    target, columns, block = table[0], table[1:7].T, table[7].astype(int)
    weights, _ = robust(columns, target)
    root = np.sqrt(weights)
    scaled = columns * root[:, None]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    values = inverse @ (scaled.T @ (target * root))
    scores = scaled * (target * root - scaled @ values)[:, None]
    blocks = np.stack([np.bincount(block, weights=column) for column in scores.T], axis=1)
    error = np.sqrt(np.diag(inverse @ (blocks.T @ blocks) @ inverse))[:3]
    explained = 1.0 - np.var(target - columns @ values) / max(np.var(target), 1e-300)
    skew = abs(values[4]) * np.std(columns[:, 4]) / max(
        abs(values[1]) * np.std(columns[:, 1]), 1e-300)
    share = np.abs(values[:3]) * np.std(columns[:, :3], axis=0) / max(np.std(target), 1e-300)
    return MotorFit(*map(float, values[:3]), error, float(explained), float(skew), share)
