# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The robot as a fit assumes it: axes nobody has described, and the effects a robot file names.

Changes of the arm are put into the arm. What springs, links and motors do beyond it acts along the
measured motion as in the simulated robot, and joins the torque that drives the link; errors of
encoders are subtracted from the readings. Effects of the actuator stand between command and
torque; where no commands were recorded, efforts are taken for them.
"""

from collections.abc import Sequence
from dataclasses import replace
import warnings

from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.data.recording import Recording
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Stage
from gms_flex_control.effects.catalogue.friction_shape import LoadFriction
from gms_flex_control.effects.registry import find
from gms_flex_control.errors import IdentificationError
from gms_flex_control.identification.check_basis import absent_joints
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.key import of_joints
from gms_flex_control.params.robot import (
    EffectSpec,
    EncoderParams,
    FrictionParams,
    RobotParams,
    StribeckParams,
    WHOLE_ARM,
    with_effects,
)
from gms_flex_control.simulation import plant
import numpy as np

_FRICTION, _LINK, _MOTOR = int(Stage.FRICTION), int(Stage.LINK), int(Stage.MOTOR)
_ON_LINK = (Stage.TORSION, Stage.SPRING, Stage.FRICTION, Stage.LINK, Stage.MOTOR)
_HELD = 1.9           # samples from one change to the next: the source is slower than the log
_EVENLY = 0.9         # of such changes that come at even intervals, within a sample
_CLEARINGS = 3        # of a motion from errors of its encoders


def rigid_joints(names: Sequence[str]) -> RobotParams:
    """Return a robot of decoupled rigid axes of these names, of unit inertia and friction."""
    n = len(names)
    one, zero = np.ones(n), np.zeros(n)
    steady = StribeckParams(static=one, coulomb=one, velocity=one, viscous=zero)
    return RobotParams(
        joints=tuple(names), motors=('',) * n, encoder=EncoderParams(),
        arm=ArmParams(kind='decoupled', mass=zero, length=zero, com=zero, inertia=one,
                      motor_inertia=zero, stiffness=np.full(n, np.inf), damping=zero),
        friction=FrictionParams(forward=steady, backward=steady, stiffness=np.full((n, 1), 100.0),
                                weight=np.ones((n, 1)), attraction=one))


def with_load_friction(robot: RobotParams, per_load: np.ndarray, step: np.ndarray) -> RobotParams:
    """Return a robot whose friction grows by ``per_load`` (n,) of the torque carried."""
    friction = robot.friction
    level = 0.5 * (friction.forward.static + friction.backward.static)[:, None] * friction.weight
    slips = np.divide(level, friction.stiffness, out=np.full_like(level, np.inf),
                      where=friction.stiffness > 0.0).min(axis=1)
    return with_effects(robot, *(
        EffectSpec(name=LoadFriction.name, joint=joint, values=(float(ratio), float(reach)))
        for joint, ratio, reach in zip(robot.joints, per_load, np.maximum(slips, 2.0 * step),
                                       strict=True) if ratio))


def only_joints(robot: RobotParams, joints: Sequence[str]) -> RobotParams:
    """Return a decoupled robot with some of its joints; IdentificationError if that cannot be."""
    unknown = [joint for joint in joints if joint not in robot.joints]
    if unknown:
        raise IdentificationError(f'--joints {unknown[0]}: the robot has '
                                  f'{", ".join(robot.joints)}')
    if robot.arm.kind != 'decoupled' and tuple(joints) != robot.joints:
        raise IdentificationError('the links of an arm act on each other: identify all '
                                  'its joints together, or describe it as decoupled axes')
    order = [robot.joints.index(joint) for joint in joints]
    return replace(
        robot, joints=tuple(joints), motors=tuple(robot.motors[k] for k in order),
        arm=of_joints(robot.arm, order), friction=robot.friction.of_joints(order),
        effects=tuple(spec for spec in robot.effects if spec.joint in joints))


def believed_model(robot: RobotParams, whole=False, force=False) -> RobotParams:
    """
    Return a robot whose changes of the arm are in its arm, its effects those along a motion.

    ``whole`` says that the arm is estimated as well; ``force`` warns instead of refusing, and
    leaves out what cannot be respected. Raises IdentificationError if an effect is one of
    friction, which is what is identified, or of the arm where that is estimated.
    """
    kept = []
    for spec in robot.effects:
        reason = _reason(robot, spec, whole)
        if reason and not force:
            raise IdentificationError(reason)
        if reason:
            warnings.warn(f'{reason} (left out)', stacklevel=2)
        else:
            kept.append(spec)
    return effect_table.with_changes(replace(robot, effects=tuple(kept)))


def refusals(robot: RobotParams) -> list[str]:
    """Return why effects of a robot cannot be respected (str each), by `identify` as it is."""
    return [reason for spec in robot.effects if (reason := _reason(robot, spec, whole=False))]


def _reason(robot, spec, whole):
    """Return why an effect cannot be respected, '' if it can."""
    kind, name = find(spec.name), f'effects.{spec.joint}.{spec.name}'
    if whole and not kind.estimated_with_arm:
        return (f'{name}: --estimate all finds the arm without effects; take it out of the robot '
                'file, or leave --estimate away')
    if not kind.acts_along_motion:
        return (f'{name}: no recording identifies friction beside it; take it out of the robot '
                'file')
    return (f'{name} changes the friction, which is what is identified; take it out of the robot '
            'file, what it does is then part of the result'
            ) if effect_table.changes_friction(spec, robot) else ''


def as_assumed(recording: Recording, robot: RobotParams) -> Recording:
    """Return a recording at the rate of its source, with the torques that act on a robot."""
    return with_torques(with_actuators(at_own_rate(recording), robot), robot)


def with_torques(recording: Recording, robot: RobotParams) -> Recording:
    """
    Return a recording in which a torque that was not recorded is 0, if others of a robot were.

    A torque that never changes was not recorded, and says nothing of its joint (`segments_of`).
    Where a planar chain lacks one it stays unknown: its links are never left out.
    """
    if robot.arm.kind == 'planar' and robot.n_joints > 1 or absent_joints(recording, robot):
        return recording
    columns = [recording.joints.index(joint) for joint in robot.joints]
    angles = np.isfinite(recording.q_motor[:, columns]).any(axis=0) & ~robot.arm.rigid
    known = np.isfinite(recording.tau_motor[2:, columns]).any(axis=0)
    lacking = [k for k, side, one in zip(columns, angles, known, strict=True) if not (side or one)]
    if len(lacking) == robot.n_joints:
        return recording
    torque = recording.tau_motor.copy()
    torque[:, lacking] = 0.0
    return replace(recording, tau_motor=torque)


def with_actuators(recording: Recording, robot: RobotParams) -> Recording:
    """
    Return a recording, of any joints, with the torques that actuators with effects applied.

    They act on commands, in a gap on the last; where none were recorded, on efforts, which then
    are commands.
    """
    robot = effect_table.with_changes(robot)
    effects = effect_table.of_stages(robot, Stage.ACTUATOR)
    if not effects or absent_joints(recording, robot):
        return recording
    columns = [recording.joints.index(joint) for joint in robot.joints]
    time, torque = recording.time, recording.tau_motor.copy()
    applied = plant.torque_applied(
        recording.commanded()[:, columns], recording.supply_at(time), time - time[0],
        recording.period, _constants(robot, effects), _state(robot))
    of_joints = {spec.joint for spec in effects}
    for j, column in enumerate(columns):
        if of_joints & {robot.joints[j], WHOLE_ARM}:
            torque[1:, column] = applied[:-1, j]
    return replace(recording, tau_motor=torque)


def at_own_rate(recording: Recording) -> Recording:
    """
    Return a recording at the rate of its source, a warning saying so if it was logged faster.

    A reading that is logged again is no further sample. What changes at even intervals is the
    source's clock, unlike the counts of an encoder.
    """
    known = np.nan_to_num(np.concatenate(
        [recording.q_link, recording.q_motor, recording.tau_motor], axis=1))
    time, period = recording.time, recording.period
    changed = np.append(True, (np.diff(known, axis=0) != 0.0).any(axis=1))
    every = np.diff(time[changed])
    own = float(np.median(every)) if len(every) else 0.0
    if own < _HELD * period or np.mean(np.abs(every - own) < 1.5 * period) < _EVENLY:
        return recording
    kept, last = np.zeros(len(time), dtype=bool), -np.inf
    for k, now in enumerate(time):  # a source at rest repeats itself
        if changed[k] or now - last > own + period:
            kept[k], last = True, now
    warnings.warn(f'{recording.source}: readings change every {1e3 * own:.4g} ms and were logged '
                  f'every {1e3 * period:.4g} ms; those that are repeated do not count',
                  stacklevel=2)
    return recording.of_samples(kept)


def cleared(recording: Recording, robot: RobotParams) -> Recording:
    """Return a recording in the robot's joint order, without the known errors of its encoders."""
    sensors = effect_table.of_stages(robot, Stage.SENSOR)
    if not sensors:
        return recording
    constants, work = _constants(robot, sensors), plant.workspace(robot.n_joints)
    link, motor = np.zeros((2, len(recording.time), robot.n_joints))
    for _ in range(_CLEARINGS):
        motion = _motion(recording.time, recording.q_link - link, recording.q_motor - motor,
                         recording.period)
        _sensor_errors(motion, recording.time - recording.time[0], recording.period, constants,
                       _state(robot), work, link, motor)
    return replace(recording, q_link=recording.q_link - link, q_motor=recording.q_motor - motor)


def effects_along(robot: RobotParams, time, q_link, q_motor, torque, period: float) -> tuple:
    """
    Return what the effects add to the torque that drives each link, and the factor of friction.

    Shape (T, n) each. The torque [N m] is the mean from sample k to k + 1; friction that effects
    add is in it, with the opposite sign. Joints that their motor drives are rigid; ``time`` (T,)
    is even, from the beginning of the recording; angles (T, n), of an absent motor NaN;
    ``torque`` (T, n) of the drive, for effects that look at it.
    """
    acting = effect_table.of_stages(robot, *_ON_LINK)
    if not acting:
        return np.zeros_like(torque), np.ones_like(torque)
    motion, constants = _motion(time, q_link, q_motor, period), _constants(robot, acting)

    def driving(friction):
        out = np.empty_like(torque)
        _further_torques(motion, np.nan_to_num(torque), friction, time, period, constants,
                         _state(robot), plant.workspace(robot.n_joints), out)
        return out
    none = driving(0.0)
    if not effect_table.of_stages(robot, Stage.FRICTION):
        return analysis.means_to_next(none), np.ones_like(torque)
    return analysis.means_to_next(none), none - driving(1.0)  # affine in friction


def _constants(robot, effects):
    return plant.constants_of(replace(robot, effects=tuple(effects)))


def _state(robot):
    return records.build(plant.state_layout(*robot.friction.stiffness.shape))


def _motion(time, q_link, q_motor, period):
    """Return angle, rate and acceleration of links, then motors, shape (T, 6, n)."""
    columns, window = [], analysis.odd_window(analysis.EFFECT_WINDOW / period)
    for link, motor in zip(q_link.T, q_motor.T, strict=True):
        for angle in (link, motor if np.isfinite(motor).any() else link):
            known = np.isfinite(angle)
            angle = np.interp(time, time[known], angle[known])  # as read: the torsion is of these
            _, rate, acceleration = analysis.derivatives(angle, period, window)
            columns += [angle, rate, acceleration]
    return np.stack(columns, 1).reshape(len(time), -1, 6).swapaxes(1, 2).copy()


@compiled
def _further_torques(motion, torque, friction, time, period, constants, state, work, out):
    """
    Write the torques of effects on each link at each sample into ``out`` (T, n).

    Less what ``friction`` [N m], which the model has at any time, becomes by them.
    """
    s, links, effects = work.signals, constants.chain, constants.effects
    for k in range(out.shape[0]):
        plant.take_place(k, motion, torque[k], time[k], state, work)
        for j in range(out.shape[1]):
            out[k, j] = -(links.stiffness[j] * s[j, sig.TORSION]
                          + links.damping[j] * s[j, sig.TORSION_RATE]
                          ) if links.flexible[j] else 0.0
        plant.springs(state, period, constants, work)
        for j in range(out.shape[1]):
            s[j, sig.FRICTION] = friction
        for stage in (_FRICTION, _LINK, _MOTOR):
            effect_table.run_stage(stage, s, state.memory, period, effects)
        for j in range(out.shape[1]):
            out[k, j] += s[j, sig.LINK_TORQUE] - s[j, sig.FRICTION] + (
                s[j, sig.SPRING] if links.flexible[j] else s[j, sig.MOTOR_TORQUE])


@compiled
def _sensor_errors(motion, time, period, constants, state, work, link, motor):
    """Write by how much the encoders read too high, (T, n) each [rad]."""
    s, none = work.signals, np.zeros(link.shape[1])
    for k in range(link.shape[0]):
        plant.take_place(k, motion, none, time[k], state, work)
        plant.run_sensors(state, period, constants, work)
        for j in range(link.shape[1]):
            link[k, j] = s[j, sig.SENSED_LINK] - state.q_link[j]
            motor[k, j] = s[j, sig.SENSED_MOTOR] - state.q_motor[j]
