# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The motor's side of a flexible joint: stiffness, motor inertia and joint damping by regression.

``u = J q2'' + K (q2 - q1) + d (q2' - q1')`` holds with link friction unseen. A constant and the
velocity stand by as regressors: a motor's own friction, and an encoder that is read late, which
adds ``K delay q'`` and looks like damping.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.data.signal_analysis import noise_of, rms
from gms_flex_control.identification.axis_fit import FEWEST, filtered, held_torque
from gms_flex_control.identification.outcome import CONFIDENT, Estimate, estimated
from gms_flex_control.identification.robust_regression import solution
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import RobotParams
import numpy as np

_SKEWED = 0.3      # part of the deflection's torque that goes with the velocity, at most
_NOISE_SD = 0.5    # to which the share of the torsion's variance that is noise is known
_EXPLAINED = 0.9   # of the torque's variance, for stiffness and motor inertia to be believed
_SMALLEST = 0.005  # of the torque: a smaller part may be what the model lacks
_READ = 100        # angles and torques, at least, where they were measured
_NEEDS_MOTION = ('a motion that makes the motor swing against the link identifies it, both '
                 'encoders sampled at one time')


class MotorFit(NamedTuple):
    """The motor's side of one flexible joint."""

    motor_inertia: float   # J [kg m^2]
    stiffness: float       # K [N m/rad]
    damping: float         # d [N m s/rad]
    error: np.ndarray      # (3,), standard errors
    explained: float       # share of the torque's variance
    skew: float            # torque that goes with the velocity, of that of the deflection
    share: np.ndarray      # (3,), torque of each part over the whole

    @property
    def believed(self) -> np.ndarray:
        """Return which of J, K and d are identifiable, bool (3,)."""
        values = np.array(self[:3])
        known = (values > CONFIDENT * self.error) & (self.share > _SMALLEST)
        return known & (self.explained > _EXPLAINED) & (not self.is_skewed)

    @property
    def is_skewed(self) -> bool:
        """Return whether too much of the torsion goes with the velocity."""
        return not self.skew < _SKEWED


class SpringFit(NamedTuple):
    """What the motor's equation says of a spring, the inertia being known."""

    stiffness: float       # [N m/rad]
    error: float           # its standard error
    left: Callable         # stiffness -> rms torque that any leaves [N m]
    constant: float        # torque that the motor gives and neither side takes [N m]
    constant_error: float  # its standard error


class MotorEquation(NamedTuple):
    """Samples of the motor's equation of one joint, all through one filter."""

    torque: np.ndarray      # (S,) of the motor [N m]
    regressors: np.ndarray  # (S, 6) of J, K, d, a constant, and the motor's own friction
    block: np.ndarray       # (S,) int, of time
    noise: np.ndarray       # (S,) like that of the torsion [rad]

    def fit(self) -> MotorFit:
        """Fit inertia, stiffness and damping."""
        values, error = solution(self.regressors, self.torque, self.block)
        spread, sizes = np.std(self.torque), np.std(self.regressors, axis=0)
        left = self.torque - self.regressors @ values
        explained = 1.0 - np.var(left) / max(np.var(self.torque), 1e-300)
        skew = abs(values[4]) * sizes[4] / max(abs(values[1]) * sizes[1], 1e-300)
        share = np.abs(values[:3]) * sizes[:3] / max(spread, 1e-300)
        return MotorFit(*map(float, values[:3]), error[:3], float(explained), float(skew), share)

    def fit_spring(self, inertia: float, sd: float) -> SpringFit | None:
        """Fit the spring, ``inertia`` known to ``sd`` [kg m^2]; None where noise hides it."""
        target, others = self.torque - inertia * self.regressors[:, 0], self.regressors[:, 1:]
        values, errors = solution(others, target, self.block)
        alone = np.column_stack([target, others[:, 0], self.regressors[:, 0]])
        alone -= others[:, 1:] @ np.linalg.lstsq(others[:, 1:], alone, rcond=None)[0]
        torque, torsion, motor = alone.T
        noise = self.noise @ self.noise
        seen = torsion @ torsion - noise  # noise of the torsion would make it softer
        if seen <= 0.0:
            return None
        stiffness, by_inertia = torque @ torsion / seen, motor @ torsion / seen
        by_noise = _NOISE_SD * stiffness * noise / seen
        return SpringFit(
            float(stiffness),
            float(np.sqrt(errors[0] ** 2 + (by_inertia * sd) ** 2 + by_noise ** 2)),
            lambda other: float(rms(torque - other * torsion)), float(values[2]),
            float(errors[2]))


def motor_equation_of(recordings: Sequence, joint: int) -> MotorEquation | None:
    """Return the MotorEquation of a joint; None where too little was measured of it."""
    if not _is_measured(recordings, joint):
        return None
    drive, rng = held_torque(joint), np.random.default_rng(joint)

    def signals(one):
        sides = [one.q_motor[:, joint], one.q_link[:, joint]]
        noise = np.hypot(*map(noise_of, sides)) * rng.standard_normal(len(one.time))
        return sides, [drive(one), noise]
    parts = [np.stack([torque.value, motor.second, motor.value - link.value,
                       motor.first - link.first, np.ones(len(block)), link.first,
                       np.sign(link.first), block, noise.value])
             for (motor, link, torque, noise), block in filtered(recordings, signals)]
    if not parts or sum(part.shape[1] for part in parts) < FEWEST:
        return None
    table = np.concatenate(parts, axis=1)
    return MotorEquation(table[0], table[1:7].T, table[7].astype(int), table[8])


def _is_measured(recordings, joint):
    """Return whether both sides and the torque of a joint were measured."""
    return all(np.isfinite(getattr(recording, name)[:, joint]).sum() > _READ
               for recording in recordings for name in ('q_link', 'q_motor', 'tau_motor'))


def with_motors(arm: ArmParams, motors: Sequence) -> ArmParams:
    """Return an arm with the motor sides found, a MotorFit or None for each joint."""
    values = {name: getattr(arm, name).copy()
              for name in ('motor_inertia', 'stiffness', 'damping')}
    for j, motor in enumerate(motors):
        if motor is None or arm.rigid[j]:
            continue
        for name, value, known in zip(values, motor[:3], motor.believed, strict=True):
            if known:
                values[name][j] = value
    return replace(arm, **values)


def motor_estimates(motor: MotorFit | None, robot: RobotParams, j: int) -> list[Estimate]:
    """Return the Estimates of the motor's side of a joint."""
    rows = []
    if motor is None:
        return rows
    for part, unit, value, error, known in zip(
            ('motor_inertia', 'stiffness', 'damping'), ('kg m^2', 'N m/rad', 'N m s/rad'),
            motor[:3], motor.error, motor.believed, strict=True):
        if robot.arm.rigid[j] and part == 'motor_inertia':
            continue
        note = '' if known else _NEEDS_MOTION
        if not known and motor.is_skewed:
            note = ('most of the torsion goes with the velocity, as if the two encoders were read '
                    'at different times: that looks like a soft spring or damping and is neither')
        rows.append(estimated(f'arm.{robot.joints[j]}.{part}', unit, value, error, note,
                              bool(known)))
    return rows
