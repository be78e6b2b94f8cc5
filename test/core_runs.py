# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What several tests of the physics core need: small robots, prescribed motions, model errors."""

from dataclasses import replace

from bench.chain_matrices import matrices
from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.dynamics import chain, spatial
from gms_flex_control.experiment import simulated
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.robot import EffectSpec, EncoderParams, RobotParams, with_effects
from gms_flex_control.simulation import plant
import numpy as np

BLOCKS = 8  # of every single axis: kernels are compiled anew for another number


def scaled_friction(friction, ratio):
    """Return friction whose torques are all ``ratio`` times as large at every motion."""
    scaled = simulated.scaled_friction(friction, ratio)
    return replace(scaled, attraction=ratio * friction.attraction)


def model_with_error(robot, *, friction=1.0, stiffness=1.0, inertia=1.0):
    """Return what a controller might believe of ``robot``: its parameters times ratios."""
    arm = replace(robot.arm.scaled(inertia), stiffness=stiffness * robot.arm.stiffness)
    return replace(robot, arm=arm, friction=scaled_friction(robot.friction, friction))


def effect_on(joint, name, *values):
    """Return an EffectSpec, its values in the order of the catalogue."""
    return EffectSpec(name=name, joint=joint, values=values)


def affected(robot, joint, name, *values):
    """Return a robot with one effect more."""
    return with_effects(robot, effect_on(joint, name, *values))


def padded(friction, blocks=BLOCKS):
    """Return friction with as many blocks as a fit has, the further ones carrying nothing."""
    none = ((0, 0), (0, blocks - friction.stiffness.shape[1]))
    return replace(friction, stiffness=np.pad(friction.stiffness, none),
                   weight=np.pad(friction.weight, none))


def single_axis(friction, inertia, *, stiffness=np.inf, motor_inertia=0.0, **options):
    """Return a robot of one axis, its friction `padded`; rigid unless a stiffness is given."""
    arm = ArmParams(kind='decoupled', mass=[0.0], length=[0.0], com=[0.0], inertia=[inertia],
                    motor_inertia=[motor_inertia], stiffness=[stiffness], damping=[0.0])
    motor = '' if np.isinf(stiffness) else 'axis_motor'
    return RobotParams(joints=('axis',), motors=(motor,), arm=arm, friction=padded(friction),
                       encoder=EncoderParams(), **options)


def energy(q_link, dq_link, q_motor, dq_motor, arm):
    """Return the mechanical energy of links, motors, springs and gravity [J]."""
    still, flexible = np.zeros(arm.n_joints), ~arm.rigid
    moving = 0.5 * dq_link @ matrices(q_link, still, still, still, arm).mass @ dq_link
    moving += 0.5 * np.sum(arm.motor_inertia[flexible] * np.asarray(dq_motor)[flexible] ** 2)
    spring = 0.5 * arm.stiffness[flexible] * np.subtract(q_motor, q_link)[flexible] ** 2
    return float(moving + np.sum(spring) - arm.mass @ (_centres(q_link, arm) @ arm.gravity))


def _centres(q, arm):
    """Return where the centres of mass are (n, 2) or (n, 3) [m]."""
    if arm.frames is not None:
        work = records.build(chain.work_layout(arm.n_joints))
        spatial.pose(np.asarray(q, dtype=float), chain.constants_of(arm), work)
        return work.centre
    theta = q + arm.offset
    if arm.kind == 'planar':
        theta = np.cumsum(theta)
    along = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    joints = np.cumsum(arm.length[:, None] * along, axis=0) - arm.length[:, None] * along
    return arm.com[:, None] * along + (joints if arm.kind == 'planar' else 0.0)


def step_friction(state, displacement, dt, friction):
    """Return the state after a step of joints by ``displacement`` (n,), and the friction (n,)."""
    state, tau = state.copy(), np.empty(len(displacement))
    displacement, constants = np.array(displacement, dtype=float), gms.constants_of(friction)
    gms.advance(state, displacement, displacement / dt, dt, constants)
    gms.total(state, displacement / dt, constants, tau)
    return state, tau


@compiled
def _drive(state, displacement, dt, constants, torque):
    for k in range(displacement.shape[0]):
        gms.advance(state, displacement[k], displacement[k] / dt, dt, constants)
        for j in range(torque.shape[1]):
            torque[k, j] = state.torque[j].sum()


def drive_friction(friction, angle, dt, state=None):
    """
    Move FrictionParams along ``angle`` (T,) or (T, n), the first step beginning where it ends.

    Return the torque of the blocks without viscous friction (T, n) [N m], and the last state.
    """
    angle = np.broadcast_to(np.asarray(angle).reshape(len(angle), -1),
                            (len(angle), len(friction.attraction)))
    state = gms.init(friction) if state is None else state.copy()
    torque = np.empty(angle.shape)
    steps = np.diff(angle, axis=0, prepend=angle[:1])
    _drive(state, steps, dt, gms.constants_of(friction), torque)
    return torque, state


@compiled
def _push(state, command, period, substeps, constants, work, out):
    for k in range(command.shape[0]):
        plant.advance(state, command[k], k * period, period, substeps, constants, work)
        for j in range(command.shape[1]):
            out[k, 0, j], out[k, 1, j] = state.q_link[j], state.dq_link[j]
            out[k, 2, j], out[k, 3, j] = state.q_motor[j], state.dq_motor[j]
        plant.gms.total(state.friction, state.dq_link, constants.friction, work.friction)
        out[k, 4] = work.friction


def push_plant(robot, command, period, *, substeps=1, state=None):
    """
    Drive the plant by torques (T, n), each held for ``period`` [s]; ``state`` is changed.

    Return q_link, dq_link, q_motor, dq_motor and friction torque after each sample (T, 5, n).
    """
    state = plant.init(robot) if state is None else state
    command = np.ascontiguousarray(command, dtype=float)
    out = np.empty((len(command), 5, robot.n_joints))
    _push(state, command, period, substeps, plant.constants_of(robot),
          plant.workspace(robot.n_joints), out)
    return out
