# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The arm as recordings determine it, before and together with friction: `--estimate all`.

A regression gives stiffness and motor inertia, and the links: of chains by `arm_regression`. Of
single axes it gives inertia and gravity to begin with; corrections are fitted together with
friction through the predictor, as further torques, and folded back into the arm.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from gms_flex_control.effects.catalogue.link import ConstantLinkTorque
from gms_flex_control.identification import axis_fit
from gms_flex_control.identification.arm_differences import (
    base_estimates,
    Differences,
    load_estimate,
)
from gms_flex_control.identification.arm_regression import fit_base_parameters
from gms_flex_control.identification.motor_equation import (
    motor_equation_of,
    motor_estimates,
    MotorFit,
    with_motors,
)
from gms_flex_control.identification.outcome import CONFIDENT, estimated, WIDE
from gms_flex_control.identification.segments import filled, friction_by_load, Segment
from gms_flex_control.params.arm import ArmParams, STANDARD_GRAVITY
from gms_flex_control.params.robot import EffectSpec, RobotParams, with_effects
import numpy as np

CONSTANT = ConstantLinkTorque.name
_LIGHT = 0.05       # of the torque, taken by an inertia that is not identifiable
_ERRORS, _PART = 5.0, 0.1  # of the regression, and of the number: unit of a correction
_KEPT = 0.1        # of an inertia, at least, whatever corrects it
_SLIGHT = 0.1      # of the torque: an inertia that needs less is not to be believed
_NEEDS_INERTIA = 'faster changes of speed identify it'
_NEEDS_GRAVITY = 'motion over a wider range of angles identifies it'
_NEEDS_CONSTANT = ('a constant torque is separated from friction by motion both ways at the same '
                   'angles and speeds')
_SCALE = estimated(
    'arm.torque_scale', '', 1.0, None, 'all torques, stiffnesses and inertias go with the scale '
    'of the recorded torque; these data do not identify it, a known mass added to the link would',
    known=False)


class JointArm(NamedTuple):
    """What a regression says of one joint, and which numbers are corrected along with friction."""

    motor: MotorFit | None  # None where not fitted
    axis: axis_fit.AxisFit | None = None  # None of a link of a chain; then nothing is corrected
    ripple: axis_fit.Ripple | None = None
    numbers: np.ndarray = np.zeros(0, dtype=int)  # (R,), of inertia, cosine, sine and constant
    units: np.ndarray = np.zeros(0)  # (R,), what a correction of 1 means, in the unit of each

    @property
    def friction(self) -> float | None:
        """Return the usual friction [N m], None where it was not looked for."""
        return self.axis and self.axis.friction


class ArmFit(NamedTuple):
    """What a regression says of the arm."""

    robot: RobotParams  # with the arm found
    joints: tuple       # of JointArm
    final: tuple = ()   # per joint its Estimates, where no correction is fitted later
    differences: Differences | None = None  # between recordings, of an arm in space
    spread: np.ndarray | None = None  # (3, n), of `nearest_arm`, of links that carry each other

    @property
    def loaded(self) -> np.ndarray:
        """Return the friction per torque carried (n,), 0 where it does not grow."""
        return np.array([one.axis.per_load if one.axis else 0.0 for one in self.joints])

    def cleared(self, segment: Segment) -> Segment:
        """Return a segment without the constant torque and the friction that grows with load."""
        arm = self.robot.arm
        carried = segment.torque - arm.rigid * arm.motor_inertia * segment.acceleration
        taken = friction_by_load(segment, carried, self.loaded) + [
            one.axis.constant if one.axis else 0.0 for one in self.joints]
        return replace(segment, torque=segment.torque - taken, taken=segment.taken + taken)

    def extras(self) -> tuple[Callable | None, ...]:
        """Return per joint a function Segment -> further torques (T, R) per correction."""
        return tuple(_columns(one, j) if len(one.numbers) else None
                     for j, one in enumerate(self.joints))


def _columns(joint, j):
    def extra(segment):
        angle = filled(segment.angle)[:, j]
        torque = np.stack([segment.acceleration[:, j], np.cos(angle), np.sin(angle),
                           np.ones(len(angle))], axis=1)
        return -joint.units * torque[:, joint.numbers]
    return extra


def estimate_arm(recordings: Sequence, robot: RobotParams) -> ArmFit:
    """Estimate the arm of recordings; the robot's kind, lengths and frames are relied on."""
    n = robot.n_joints
    equations = [motor_equation_of(recordings, j) for j in range(n)]
    motors = [one and one.fit() for one in equations]
    robot = replace(robot, arm=with_motors(robot.arm, motors))
    if robot.arm.frames or robot.arm.kind == 'planar' and n > 1:
        return _of_chain(recordings, robot, motors)
    joints, arm, effects = [], robot.arm, []
    for j, name in enumerate(robot.joints):
        source, turns = recordings[0].source, arm.axes == 'rotary'
        drive = _drive_of(recordings, robot.arm, j)
        samples = axis_fit.samples_that_agree(recordings, drive, j, turns)
        axis, ripple = axis_fit.fit_axis_with_ripple(
            recordings, samples, j, name, source, turns)
        effects += [ripple.effect(name)] if ripple else []
        # where none is seen, one that needs a small part of the torque: with much less, the blocks
        # of friction would be too stiff for the samples
        least = _LIGHT * np.std(samples.torque) / max(np.std(samples.acceleration), 1e-300)
        inertia = axis.inertia if axis.inertia_known else float(least)
        arm = with_axis(arm, j, inertia, axis.cosine, axis.sine)
        size = np.array([inertia, axis.gravity_torque, axis.gravity_torque, axis.constant])
        numbers = np.flatnonzero([True, axis.has_gravity, axis.has_gravity, axis.constant != 0.0])
        joints.append(JointArm(motors[j], axis, ripple, numbers, np.maximum(
            _ERRORS * axis.error, _PART * np.abs(size))[numbers]))
    return ArmFit(with_effects(replace(robot, arm=arm), *effects), tuple(joints))


def _of_chain(recordings, robot, motors):
    fit = fit_base_parameters(recordings, robot)
    estimates = base_estimates(fit, robot.joints)
    for j, motor in enumerate(motors):
        estimates[j] = (*estimates[j], *motor_estimates(motor, robot, j))
    if not fit.differences.prior_sd.any():
        estimates[0] += (_SCALE,)
    return ArmFit(replace(robot, arm=fit.arm), tuple(map(JointArm, motors)), tuple(estimates),
                  fit.differences if robot.arm.frames else None, fit.spread)


def _drive_of(recordings, arm, joint):
    """Return the function that gives the torque on a link: its spring, or its motor."""
    measured = all(np.isfinite(recording.q_motor[:, joint]).any() for recording in recordings)
    if arm.rigid[joint] or not measured:
        return axis_fit.held_torque(joint)
    return axis_fit.spring_torque(joint, arm.stiffness[joint], arm.damping[joint])


def with_axis(arm: ArmParams, joint: int, inertia: float, cosine: float, sine: float) -> ArmParams:
    """
    Return a decoupled arm with one axis changed.

    ``inertia`` about the joint, motor of a rigid joint included [kg m^2]; gravity torque
    ``cosine cos q + sine sin q`` [N m]. Mass and centre of mass are one choice of which only the
    moment and ``inertia`` count; the mass of the file is kept where that is possible.
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


def axis_of(arm: ArmParams, joint: int) -> tuple:
    """Return inertia about the joint [kg m^2], and cosine and sine of gravity [N m]."""
    inertia = arm.inertia[joint] + arm.mass[joint] * arm.com[joint] ** 2
    inertia += arm.motor_inertia[joint] if arm.rigid[joint] else 0.0
    pull = arm.mass[joint] * arm.com[joint] * float(np.hypot(*arm.gravity))
    return inertia, pull * np.cos(arm.offset[joint]), -pull * np.sin(arm.offset[joint])


def folded(robot: RobotParams, arm_fit: ArmFit, thetas: Sequence) -> RobotParams:
    """Return the robot with corrections fitted along with friction, the last of ``thetas``."""
    arm, effects = robot.arm, []
    for j, theta in enumerate(thetas):
        inertia, cosine, sine, constant = _axis_numbers(arm, arm_fit.joints[j], j, theta)
        arm = with_axis(arm, j, inertia, cosine, sine)
        if constant:
            effects.append(EffectSpec(
                name=CONSTANT, joint=robot.joints[j], values=(-float(constant),)))
    kept = [spec for spec in robot.effects if spec.name != CONSTANT] if effects else robot.effects
    return replace(robot, arm=arm, effects=(*kept, *effects))


def _axis_numbers(arm, joint, j, theta):
    """
    Return inertia, cosine, sine and constant torque of the j-th axis, corrected (4,).

    As written: of an inertia that the correction takes away a part stays, as all that moves has.
    """
    values = np.append(axis_of(arm, j), joint.axis.constant)
    least = _KEPT * values[0]
    values[joint.numbers] += theta[len(theta) - len(joint.units):] * joint.units
    values[0] = max(values[0], least)
    return values


def arm_estimates(robot: RobotParams, arm_fit: ArmFit, thetas: Sequence,
                  spreads: Sequence) -> list[tuple]:
    """Return the Estimates of the arm, a tuple per joint, those of the whole with the first."""
    rows = [(*_axis_rows(robot, joint, j, theta, spread), *motor_estimates(joint.motor, robot, j))
            for j, (joint, theta, spread) in enumerate(zip(
                arm_fit.joints, thetas, spreads, strict=True))]
    return [(*rows[0], _SCALE), *rows[1:]]


def _axis_rows(robot, joint, j, theta, spread):
    name, scale, numbers = f'arm.{robot.joints[j]}', joint.units, joint.numbers
    at = len(spread.covariance) - len(scale)
    values = _axis_numbers(robot.arm, joint, j, theta)[numbers]
    covariance = spread.covariance[at:, at:] * np.outer(scale, scale)
    error = np.sqrt(np.diag(covariance))
    rows = [_row(f'{name}.inertia', 'kg m^2', values[0], error[0],
                 'about the joint, centre of mass and motor included', _NEEDS_INERTIA)]
    if joint.axis.share < _SLIGHT:
        rows[0] = estimated(
            f'{name}.inertia', 'kg m^2', values[0], None, f'it takes '
            f'{100 * max(joint.axis.share, 0.0):.2g} % of the torque in this motion, less '
            f'than what the model lacks may take: {_NEEDS_INERTIA}', known=False)
    if 3 in numbers:
        rows.append(_row(f'effects.{robot.joints[j]}.{CONSTANT}.bias', 'N m', -values[-1],
                         error[-1], 'friction would have to be several times '
                         'larger one way than the other without it', _NEEDS_CONSTANT))
    if 1 in numbers:
        size = np.hypot(*values[1:3])
        slope = values[1:3] / max(size, 1e-300)
        spreads = covariance[1:3, 1:3]
        angle = np.arctan2(-values[2], values[1])
        turn = np.array([-slope[1], slope[0]]) / max(size, 1e-300)
        rows.append(_row(f'{name}.gravity_torque', 'N m', size, np.sqrt(slope @ spreads @ slope),
                         'of the link held level: mass com '
                         'gravity; mass and com apart are not identifiable', _NEEDS_GRAVITY))
        error = float(np.sqrt(turn @ spreads @ turn))
        known = error < WIDE
        rows.append(estimated(f'{name}.offset', 'rad', angle, error,
                              '' if known else _NEEDS_GRAVITY, known))
    ripple, of_ripple = joint.ripple, f'effects.{robot.joints[j]}.{axis_fit.RIPPLE}'
    if ripple:
        rows += [estimated(f'{of_ripple}.amplitude', 'N m', ripple.amplitude,
                           ripple.amplitude_error,
                           'taken off the torque before friction was fitted'),
                 estimated(f'{of_ripple}.order', '1', ripple.order, ripple.order_error,
                           'periods in 2 pi of the angle')]
    if joint.axis.per_load:
        rows.append(load_estimate(robot.joints[j], joint.axis.per_load, None))
    if 1 not in numbers and robot.arm.axes == 'rotary':
        rows.append(estimated(f'{name}.gravity_torque', 'N m', 0.0, None, 'no gravity is seen in '
                              'this motion: it does not lower the error on data held out', False))
    return rows


def _row(name, unit, value, error, meaning, needs):
    known = CONFIDENT * error < WIDE * abs(value) and (value > 0.0 or 'bias' in name)
    return estimated(name, unit, value, error, meaning if known else needs, bool(known))
