# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
One axis of a recording as the equations of motion see it, for models and least squares alike.

Everything the bench takes from the inside of `gms_flex_control.discrepancy` is imported here.
"""

from dataclasses import dataclass, replace

from gms_flex_control.discrepancy import motion as equations
from gms_flex_control.discrepancy.residuals import unexplained
from gms_flex_control.identification.assumed_robot import rigid_joints
from gms_flex_control.simulation.plant import constants_of
import numpy as np
from scipy.signal import butter, sosfiltfilt

EDGE = 0.5      # at both ends, where filters are not settled [s]
_ORDER = 4      # of the low-pass, run forward and backward
_GAIN = 'torque_gain'  # the effect that scales what is measured
_DRIVEN = 0     # the axis; recordings are of one joint


@dataclass(frozen=True, eq=False)
class Motion:
    """The measured motion of one axis."""

    time: np.ndarray  # (S,), evenly spaced [s]
    period: float  # [s]
    angle: np.ndarray  # (S,), of the side the drive acts on, smoothed [rad]
    rate: np.ndarray  # (S,), likewise [rad/s]
    # (S,), from second differences of the readings [rad/s^2], and the torque held meanwhile [N m],
    # both behind one filter
    acceleration: np.ndarray
    torque: np.ndarray
    # (S,), whether the encoder saw nothing move for a fifth of a second, bool
    standing: np.ndarray
    weight: float  # on both neighbours: what that filter does to a function of the motion
    source: str  # the recording

    def filtered(self, column):
        """Return a function of the motion (S,) as the filter of the torque shows it."""
        return equations.filtered_alike(column, self.weight)

    @property
    def used(self):
        """
        Return which samples are used, bool (S,).

        Not the ends, which filters still feel, and not where the axis stands: there friction is
        whatever holds it, and no function of the motion.
        """
        inside = (self.time >= EDGE) & (self.time <= self.time[-1] - EDGE)
        return inside & ~self.standing


def driven_side(recording):
    """Return a recording of a rigid axis at the angle of its motor, or of its link without one."""
    q_motor = recording.q_motor
    if not np.isfinite(q_motor).any():
        return recording
    return replace(recording, q_link=q_motor, dq_link=recording.dq_motor,
                   q_motor=np.full_like(q_motor, np.nan),
                   dq_motor=np.full_like(q_motor, np.nan))


def motion_of(recording, fine=False):
    """Return the Motion of a recording of one joint, every 4 ms or, ``fine``, at every sample."""
    full = _measured(driven_side(recording), rigid_joints(recording.joints), fine)
    return Motion(
        time=full.time - full.time[0], period=full.period, angle=full.states[:, 0, _DRIVEN],
        rate=full.states[:, 1, _DRIVEN], acceleration=full.second[:, 0, _DRIVEN],
        torque=full.drive[:, _DRIVEN], standing=full.standing[:, _DRIVEN],
        weight=equations.weight_of_neighbours(full.factor), source=recording.source)


def residual_torque(recording, robot, fine=False):
    """
    Return what a model leaves of the drive's torque (S,) [N m] at the times of `motion_of`.

    Measured less modelled. Of a flexible joint the sum of both equations, in which its spring has
    no part. In torque as measured: a model that has the drive's gain smaller misses no less for
    it.
    """
    missing = unexplained(_measured(recording, robot, fine), constants_of(robot))
    gain = 1.0 + sum(spec.values[0] for spec in robot.effects if spec.name == _GAIN)
    return -missing.sum(axis=1) / gain


def low_pass(values, band, period):
    """Return values (S, ...) behind a Butterworth low-pass of a band [Hz], without phase."""
    return sosfiltfilt(butter(_ORDER, band, fs=1.0 / period, output='sos'), values, axis=0)


def rms(values):
    """Return the root of the mean of squares."""
    return float(np.sqrt(np.mean(np.square(values))))


def _measured(recording, robot, fine):
    motion = equations.motion_of(recording, robot)
    return equations.at_full_rate(motion) if fine else motion
