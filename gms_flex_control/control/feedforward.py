# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What the controller does about the effects that its model names.

The cascade law is linear in the elastic torque u_ed, Eqs. (9) and (27) to (29): a torque x that
the links need on top adds ``J K^-1 Lambda_2 x' + K_D2 K^-1 (x' + Lambda_2 x)`` to the command,
and one that the motors get, y, is subtracted. x' comes from the command filter of the friction
estimate; the term ``J K^-1 x''``, 4 % at 1 Hz, would be mostly encoder noise.
"""

from dataclasses import replace
from functools import cache

from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.control import observer
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Change, Stage
from gms_flex_control.effects.registry import find
from gms_flex_control.effects.table import is_friction, with_changes, with_friction
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.records import FLOAT
import numpy as np

_FRICTION, _LINK, _MOTOR = int(Stage.FRICTION), int(Stage.LINK), int(Stage.MOTOR)


def compensated(name: str) -> bool:
    """
    Return whether a controller that knows an effect compensates it.

    Not those that no torque can undo (backlash), that follow signs of noisy rates (motor_coulomb),
    that need what a controller lacks (drifts) or that act on torque or encoders themselves.
    """
    kind = find(name)
    return kind.fed_forward or is_friction(kind) or issubclass(kind, Change)


def as_parameters(robot: RobotParams) -> RobotParams:
    """
    Return a model as the cascade law can use it.

    Effects that are other values of parameters are in the parameters, asymmetric and further
    viscous friction in those of the directions; of its effects those fed forward are left.
    """
    if not robot.effects:
        return robot
    robot = with_friction(robot)
    kinds = [(find(spec.name), spec) for spec in robot.effects]
    return with_changes(replace(robot, effects=tuple(
        spec for kind, spec in kinds if kind.fed_forward or issubclass(kind, Change))))


@cache
def constants_layout(n) -> np.dtype:
    """
    Return the dtype of effects, springs and gains as `feed` takes them.

    ``links``, 1 where the links are served, 0 where an observer sees all that they lack already.
    """
    return records.layout(
        ('effects', effect_table.LAYOUT), ('links', FLOAT, (1,)),
        *((name, FLOAT, (n,)) for name in ('flexible', 'stiffness', 'motor_inertia', 'kd_motor',
                                           'lambda_motor', 'bandwidth', 'torque_limit')))


@cache
def state_layout(n) -> np.dtype:
    """Return the dtype of the filter (2, n), of what effects remember and of the work space."""
    return records.layout(
        ('filtered', FLOAT, (2, n)), ('started', FLOAT, (1,)), ('further', FLOAT, (n,)),
        ('signals', FLOAT, (n, sig.WIDTH)), ('memory', FLOAT, (effect_table.MEMORY_SIZE,)))


def constants_of(gains, model) -> np.record:
    """Return ControllerParams and a model from `as_parameters` as the record `feed` takes."""
    arm = model.arm
    return records.build(
        constants_layout(model.n_joints),
        effects=effect_table.build(model.effects, model.joints, arm),
        links=gains.compensation != 'disturbance_observer', flexible=~arm.rigid,
        stiffness=np.where(arm.rigid, 1.0, arm.stiffness),
        motor_inertia=arm.motor_inertia, kd_motor=gains.kd_motor,
        lambda_motor=gains.lambda_motor, bandwidth=gains.filter_bandwidth,
        torque_limit=gains.torque_limit)


def init(n) -> np.record:
    """Return the memory of `feed` for n joints before the first tick."""
    return records.build(state_layout(n))


@compiled
def _sense(control, measured, reference, constants, state):
    """Write what the effects may read, as measured and estimated, into the signal table."""
    s = state.signals
    for j in range(s.shape[0]):
        s[j, sig.JOINT], s[j, sig.JOINTS] = j, s.shape[0]
        s[j, sig.Q_LINK], s[j, sig.DQ_LINK] = measured.q_link[j], measured.dq_link[j]
        s[j, sig.Q_MOTOR], s[j, sig.DQ_MOTOR] = measured.q_motor[j], measured.dq_motor[j]
        s[j, sig.DDQ_LINK] = reference[2, j]  # none is measured
        s[j, sig.TORQUE] = control.command[j]
        s[j, sig.SPRING] = control.command[j] - constants.motor_inertia[j] * s[j, sig.DDQ_LINK]
        if constants.flexible[j]:
            s[j, sig.TORSION] = measured.q_motor[j] - measured.q_link[j]
            s[j, sig.TORSION_RATE] = measured.dq_motor[j] - measured.dq_link[j]
            s[j, sig.SPRING] = constants.stiffness[j] * s[j, sig.TORSION]
        s[j, sig.FRICTION] = control.friction_hat[j]
        s[j, sig.LINK_TORQUE] = s[j, sig.MOTOR_TORQUE] = 0.0


@compiled
def feed(control, measured, reference, dt, constants, state) -> None:
    """Add what the effects require to the cascade law's answer; arguments as of its ``tick``."""
    if constants.effects.stage_start[-1] == 0:
        return
    s, further, filtered = state.signals, state.further, state.filtered
    _sense(control, measured, reference, constants, state)
    for stage in (_FRICTION, _LINK, _MOTOR):
        effect_table.run_stage(stage, s, state.memory, dt, constants.effects)
    for j in range(s.shape[0]):
        further[j] = constants.links[0] * (
            s[j, sig.FRICTION] - control.friction_hat[j] - s[j, sig.LINK_TORQUE])
        control.friction_hat[j] += further[j]
        if not state.started[0]:
            filtered[0, j], filtered[1, j] = further[j], 0.0
    state.started[0] = 1.0
    observer.filter_step(filtered, further, constants.bandwidth, dt)
    for j in range(s.shape[0]):
        added = further[j]
        if constants.flexible[j]:
            turn, damping = constants.lambda_motor[j], constants.kd_motor[j]
            added = (constants.motor_inertia[j] * turn * filtered[1, j]
                     + damping * (filtered[1, j] + turn * further[j])) / constants.stiffness[j]
        command = control.command[j] + added - s[j, sig.MOTOR_TORQUE]
        limit = constants.torque_limit[j]
        if abs(command) > limit:
            control.saturated[j] = 1.0
        control.command[j] = min(max(command, -limit), limit)
