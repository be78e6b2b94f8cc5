# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The arm as recordings tell it, before and together with friction: `--estimate all`.

A regression gives inertia, gravity, stiffness and motor inertia to begin with. On axes that do
not act on each other, corrections of inertia and gravity are then fitted together with friction
through the predictor, as further torques, and folded back into the arm.
"""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.effects.catalogue.constant_link_torque import ConstantLinkTorque
from gms_flex_control.identification.axis_ripple import fit_axis_with_ripple
from gms_flex_control.identification.chain_fit import (
    base_regressors,
    base_values,
    fit_chain,
    nearest_arm,
)
from gms_flex_control.identification.motor_side import fit_motor
from gms_flex_control.identification.rigid_body import (
    held_torque,
    rows_of,
    spring_torque,
    STANDARD_GRAVITY,
)
from gms_flex_control.identification.steady import filled
from gms_flex_control.params.robot import EffectSpec
import numpy as np

CONSTANT = ConstantLinkTorque.name
_LIGHT = 0.05       # of the torque: inertia that cannot be told is set to what takes this share
_ERRORS, _PART = 5.0, 0.1  # of the regression, and of the number: unit of a correction


class ArmFit(NamedTuple):
    """What a regression says of the arm."""

    robot: object   # RobotParams with the arm found
    motors: tuple   # MotorFit per joint, None where not fitted
    numbers: tuple  # per joint which numbers of the arm are corrected along with friction
    units: tuple    # per joint what a correction of 1 means (R,), in the unit of the number
    has_gravity: tuple  # per joint whether gravity acts on it
    constant: np.ndarray  # (n,), torque needed at any angle and speed [N m]
    friction: tuple  # per joint its usual friction [N m], None where not looked for
    shares: tuple    # per joint the torque of its inertia, of the whole
    ripples: tuple   # per joint its Ripple, None where there is none

    def extras(self):
        """Return per joint a function Stretch -> further torques (T, R) per unit of correction."""
        return tuple(self._columns(j) for j in range(len(self.numbers)))

    def _columns(self, joint):
        arm, gravity = self.robot.arm, any(self.has_gravity)
        chosen, units = self.numbers[joint], self.units[joint]

        def extra(stretch):
            motion = filled(stretch.angle), stretch.rate, stretch.acceleration
            torque = (base_regressors(*motion, arm, gravity) if is_chain(arm)
                      else axis_regressors(*motion))
            return -units * torque[:, joint, chosen]
        return extra

    def corrections(self, joint, theta):
        """Return what parameters of a joint correct, in the units of the numbers, (R,)."""
        return theta[len(theta) - len(self.units[joint]):] * self.units[joint]


def is_chain(arm):
    """Return whether the links act on each other."""
    return arm.kind == 'planar' and arm.n_joints > 1


def axis_regressors(angle, rate, acceleration):
    """Return the torques (T, n, 4) of inertia, cosine and sine of gravity, and a constant."""
    return np.stack([acceleration, np.cos(angle), np.sin(angle), np.ones(angle.shape)], axis=2)


def estimate_arm(recordings, robot):
    """
    Estimate the arm.

    Parameters
    ----------
    recordings : sequence of Recording
        Joints in the robot's order.
    robot : RobotParams
        As far as it is known: kind, lengths and masses of a chain are relied on.

    Returns
    -------
    ArmFit

    """
    n = robot.n_joints
    motors = tuple(fit_motor(recordings, j) if two_sided(recordings, j) else None
                   for j in range(n))
    robot = replace(robot, arm=_with_motors(robot.arm, motors))
    drives = [drive_of(recordings, robot.arm, j) for j in range(n)]
    if is_chain(robot.arm):
        return _chain(recordings, robot, drives, motors)
    numbers, units, axes, ripples, constant, arm = [], [], [], [], np.zeros(n), robot.arm
    for j in range(n):
        rows = rows_of(recordings, drives[j], j)
        axis, ripple = fit_axis_with_ripple(recordings, rows, j, robot.joints[j],
                                            recordings[0].source)
        ripples.append(ripple)
        inertia = inertia_to_use(axis, rows)
        arm = with_axis(arm, j, inertia, axis.cosine, axis.sine)
        size = np.array([inertia, axis.gravity_torque, axis.gravity_torque, axis.constant])
        chosen = np.flatnonzero([True, axis.has_gravity, axis.has_gravity, axis.constant != 0.0])
        numbers.append(chosen)
        units.append(np.maximum(_ERRORS * axis.error, _PART * np.abs(size))[chosen])
        axes.append(axis)
        constant[j] = axis.constant
    effects = tuple(ripple.effect(joint) for joint, ripple in zip(
        robot.joints, ripples, strict=True) if ripple)
    return ArmFit(replace(robot, arm=arm, effects=robot.effects + effects), motors,
                  tuple(numbers), tuple(units), tuple(axis.has_gravity for axis in axes),
                  constant, tuple(axis.friction for axis in axes),
                  tuple(axis.share for axis in axes), tuple(ripples))


def _chain(recordings, robot, drives, motors):
    n, gravity = robot.n_joints, bool(robot.arm.gravity.any())
    arm, error = fit_chain(recordings, robot, drives)
    units = np.maximum(_ERRORS * error, _PART * np.abs(base_values(arm, gravity)))
    numbers = tuple(acting(n, j, gravity) for j in range(n))
    return ArmFit(replace(robot, arm=arm), motors, numbers,
                  tuple(units[chosen] for chosen in numbers), (gravity,) * n, np.zeros(n),
                  (None,) * n, (1.0,) * n, (None,) * n)


def acting(n, joint, gravity):
    """Return which base parameters of a chain of n joints act on a joint."""
    pairs = [(i, k) for i in range(n) for k in range(i, n)]
    chosen = [b for b, (_, k) in enumerate(pairs) if k >= joint]
    return np.array(chosen + [len(pairs) + i for i in range(joint, n) if gravity])


def two_sided(recordings, joint):
    """Return whether both sides and the torque of a joint were measured."""
    return all(np.isfinite(getattr(recording, name)[:, joint]).sum() > 100
               for recording in recordings for name in ('q_link', 'q_motor', 'tau_motor'))


def drive_of(recordings, arm, joint):
    """Return the function that gives the torque on a link: its spring, or its motor."""
    measured = all(np.isfinite(recording.q_motor[:, joint]).any() for recording in recordings)
    if arm.rigid[joint] or not measured:
        return held_torque(joint)
    return spring_torque(joint, arm.stiffness[joint], arm.damping[joint])


def _with_motors(arm, motors):
    values = {name: getattr(arm, name).copy()
              for name in ('motor_inertia', 'stiffness', 'damping')}
    for j, motor in enumerate(motors):
        if motor is None or arm.rigid[j]:
            continue
        for name, value, told in zip(values, motor[:3], motor.believed, strict=True):
            if told:
                values[name][j] = value
    return replace(arm, **values)


def inertia_to_use(axis, rows):
    """
    Return the inertia of an axis [kg m^2].

    Where none is seen, one that takes a small part of the torque: with much less, the blocks of
    friction would be too stiff for the samples.
    """
    least = _LIGHT * np.std(rows.torque) / max(np.std(rows.acceleration), 1e-300)
    return axis.inertia if axis.inertia_told else float(least)


def with_axis(arm, joint, inertia, cosine, sine):
    """
    Return the arm with one axis of its own changed.

    Parameters
    ----------
    arm : ArmParams
        Decoupled.
    joint : int
        Which axis.
    inertia : float
        About the joint, motor of a rigid joint included [kg m^2].
    cosine, sine : float
        Gravity torque ``cosine cos q + sine sin q`` [N m].

    Returns
    -------
    ArmParams
        Mass and centre of mass are one choice of which only the moment and ``inertia`` count;
        the mass of the file is kept where that is possible.

    """
    pull = float(np.hypot(*arm.gravity)) or STANDARD_GRAVITY
    names = ('mass', 'com', 'inertia', 'offset', 'motor_inertia')
    values = {name: getattr(arm, name).copy() for name in names}
    moment = np.hypot(cosine, sine) / pull
    motor = values['motor_inertia'][joint] if arm.rigid[joint] else 0.0
    if motor >= inertia:
        values['motor_inertia'][joint] = motor = 0.0
    rest, mass = inertia - motor, values['mass'][joint]
    if moment <= 0.0:
        values['com'][joint], values['inertia'][joint] = 0.0, rest
        return replace(arm, **values)
    if mass <= 0.0 or moment ** 2 / mass >= rest:
        mass = 2.0 * moment ** 2 / rest
    values['mass'][joint], values['com'][joint] = mass, moment / mass
    values['inertia'][joint] = rest - moment ** 2 / mass
    values['offset'][joint] = np.arctan2(-sine, cosine)
    return replace(arm, gravity=pull, **values)


def axis_of(arm, joint):
    """Return inertia about the joint [kg m^2], and cosine and sine of gravity [N m]."""
    inertia = arm.inertia[joint] + arm.mass[joint] * arm.com[joint] ** 2
    inertia += arm.motor_inertia[joint] if arm.rigid[joint] else 0.0
    pull = arm.mass[joint] * arm.com[joint] * float(np.hypot(*arm.gravity))
    return inertia, pull * np.cos(arm.offset[joint]), -pull * np.sin(arm.offset[joint])


def folded(robot, arm_fit, thetas, spreads):
    """
    Return the robot with the corrections that were fitted along with friction.

    Parameters
    ----------
    robot : RobotParams
        The arm the corrections are to.
    arm_fit : ArmFit
        Which there are.
    thetas : sequence of ndarray
        Parameters of each joint, corrections last.
    spreads : sequence of Spread
        Of their free numbers.

    Returns
    -------
    RobotParams

    """
    arm, effects = robot.arm, []
    if is_chain(arm):
        values, covariance = combined(arm, arm_fit, thetas, spreads)
        return replace(robot, arm=nearest_arm(
            arm, values, np.linalg.pinv(covariance, rcond=1e-12, hermitian=True),
            any(arm_fit.has_gravity)))
    for j, theta in enumerate(thetas):
        inertia, cosine, sine, constant = axis_numbers(arm, arm_fit, j, theta)
        arm = with_axis(arm, j, max(inertia, 0.1 * axis_of(arm, j)[0]), cosine, sine)
        if constant:
            effects.append(EffectSpec(
                name=CONSTANT, joint=robot.joints[j], values=(-float(constant),)))
    kept = [spec for spec in robot.effects if spec.name != CONSTANT] if effects else robot.effects
    return replace(robot, arm=arm, effects=(*kept, *effects))


def axis_numbers(arm, arm_fit, joint, theta):
    """Return inertia, cosine, sine and constant torque of an axis, corrected (4,)."""
    values = np.append(axis_of(arm, joint), arm_fit.constant[joint])
    values[arm_fit.numbers[joint]] += arm_fit.corrections(joint, theta)
    return values


def combined(arm, arm_fit, thetas, spreads):
    """
    Return base parameters of a chain and their covariance, all joints put together.

    Each joint has corrected those that act on it; they count by their precision.
    """
    start = base_values(arm, any(arm_fit.has_gravity))
    precision, right = np.zeros((len(start), len(start))), np.zeros(len(start))
    for j, (theta, spread) in enumerate(zip(thetas, spreads, strict=True)):
        chosen, scale = np.ix_(arm_fit.numbers[j], arm_fit.numbers[j]), arm_fit.units[j]
        own = spread.covariance[-len(scale):, -len(scale):] * np.outer(scale, scale)
        known = np.linalg.inv(own)
        precision[chosen] += known
        right[arm_fit.numbers[j]] += known @ arm_fit.corrections(j, theta)
    covariance = np.linalg.inv(precision)
    return start + covariance @ right, covariance
