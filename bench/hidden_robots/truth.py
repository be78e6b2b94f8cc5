# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The hidden robot in closed loop: truth that shares no integrator with the workflow."""

from dataclasses import replace
from typing import NamedTuple

from bench.chain_matrices import matrices
from bench.hidden_robots.kernels import loop, mechanics, outside, pid
from gms_flex_control import records
from gms_flex_control.control import cascade
from gms_flex_control.effects import table as effect_table
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.simulation import encoder
import numpy as np

STEP = 4e-5  # of the integration, about [s]
# solved with the mass matrix instead of by their terms: the accelerations in them are implicit
CARRIED, BASE = 'motor_inertia_coupling', 'base_flexibility'


class Disturbance(NamedTuple):
    """Something outside the catalogue: see outsiders."""

    name: str
    joint: int
    values: tuple
    drawn: np.ndarray  # (T,) random numbers, one held over each sample


class Scene(NamedTuple):
    """What a run takes beside reference and controller, in the order of the kernels."""

    state: np.record
    constants: np.record
    strange: np.record    # of a Disturbance
    drawn: np.ndarray     # (T,) its random numbers
    supply: np.ndarray    # (T,) [V]
    noise: np.ndarray     # (T, n) torque of the drives [N m]
    sensed: np.record
    encoders: np.record
    rng: np.random.Generator


class Motion(NamedTuple):
    """What happened at T samples; the command at k acts from sample k to k + 1."""

    measured: np.ndarray      # (T, 4, n): q_link, dq_link, q_motor, dq_motor
    true: np.ndarray          # (T, 4, n): the same without encoders
    command: np.ndarray       # (T, n) [N m]
    applied: np.ndarray       # (T, n) mean torque of the actuators over the sample before [N m]
    friction: np.ndarray      # (T, n) of the blocks and the viscous part [N m]
    friction_hat: np.ndarray  # (T, n) as the controller estimates it [N m]


def constants_of(robot):
    """Return a RobotParams, effects included, as the record of the hidden kernels."""
    if robot.arm.kind == 'planar' and robot.n_joints > 2:
        raise ConfigError(f'a hidden chain has one or two joints, got {robot.n_joints}; take '
                          'arm.kind decoupled or fewer joints')
    robot = effect_table.with_changes(robot)
    carried, base = np.zeros(robot.n_joints), (0.0, 1.0, 0.0)
    for spec in robot.effects:
        if spec.name == CARRIED:
            carried[robot.joints.index(spec.joint)] = spec.values[0]
        elif spec.name == BASE:
            frequency, inertia, damping = spec.values
            base = (inertia, 2.0 * np.pi * frequency, damping)
    terms = tuple(spec for spec in robot.effects if spec.name not in (CARRIED, BASE))
    return mechanics.constants(replace(robot, effects=terms), carried=carried, base=base)


def at_rest(robot, q=None):
    """
    Return the state of a robot at rest at link angles ``q`` (n,), zero by default.

    Its springs hold its weight, as believed without effects; the blocks of its friction none.
    """
    still = np.zeros(robot.n_joints)
    q = still if q is None else q
    weight = matrices(q, still, still, still, robot.arm).gravity
    return records.build(loop.state_layout(*robot.friction.stiffness.shape), q=q,
                         q_motor=q + weight / robot.arm.stiffness, sticking=1, direction=1.0)


def strange_record(disturbance):
    """Return a Disturbance or None as the record of the hidden kernels."""
    if disturbance is None:
        return records.build(loop.STRANGE_LAYOUT)
    values = np.zeros(outside.PARAMETERS)
    values[:len(disturbance.values)] = disturbance.values
    return records.build(loop.STRANGE_LAYOUT, kind=outside.NAMES.index(disturbance.name),
                         joint=disturbance.joint, values=values)


def under_cascade(robot, model, gains, reference, period, scene, angles, torques):
    """Run a Scene under the cascade controller; fills ``angles`` and ``torques``."""
    # a copy: the loop is compiled anew for a read-only reference
    loop.run(reference.copy(), period, round(period / STEP), *scene, cascade.init(model),
             cascade.constants_of(gains, model), cascade.workspace(robot.n_joints), angles,
             torques)


def under_pid(robot, model, gains, reference, period, scene, angles, torques):
    """
    Run a Scene under PID controllers of the motors' angles, gains from the motor law.

    A motor is asked to be where the spring carries inertia and weight of the links, as believed.
    """
    asked = reference.copy()
    for row, (q, v, a) in zip(asked, reference[:, :3], strict=True):
        link = matrices(q, v, v, a, model.arm)
        row[0] += (link.mass @ a + link.coriolis @ v + link.gravity) / model.arm.stiffness
    loop.run_pid(asked, period, round(period / STEP), *scene, pid.init(gains), angles, torques)


def simulate(robot, model, gains, reference, *, period=2e-3, seed=0, disturbance=None,
             supply=None, noise=None, drive=under_cascade):
    """
    Return the Motion of a robot under its controller; it starts at rest at its first reference.

    ``model`` is the robot as the controller believes it to be, ``reference`` (T, 5, n_joints),
    ``period`` [s] a sample, ``disturbance`` one from outside the catalogue; ``supply`` (T,) is the
    voltage over each sample [V], ``noise`` (T, n_joints) torque the drives add [N m]. ``drive`` is
    `under_cascade`, `under_pid` or `mujoco_plant.under_cascade`. SimulationError if the loop
    diverges, ConfigError if ``drive`` cannot move the robot.
    """
    samples, n = len(reference), robot.n_joints
    angles, torques = np.empty((samples, 8, n)), np.empty((samples, 4, n))
    scene = Scene(
        state=at_rest(robot, reference[0, 0]), constants=constants_of(robot),
        strange=strange_record(disturbance),
        drawn=np.zeros(samples) if disturbance is None else disturbance.drawn,
        supply=np.zeros(samples) if supply is None else supply,
        noise=np.zeros((samples, n)) if noise is None else noise, sensed=encoder.init(n),
        encoders=encoder.constants_of(robot.encoder), rng=np.random.default_rng(seed))
    drive(robot, model, gains, np.ascontiguousarray(reference), period, scene, angles, torques)
    sound = np.isfinite(angles).all(axis=(1, 2)) & (np.abs(angles[:, 4]) < 1e3).all(axis=1)
    if not sound.all():
        raise SimulationError(f'the hidden robot diverged at {np.argmin(sound) * period:g} s; '
                              'draw smaller effects or softer gains')
    return Motion(angles[:, :4], angles[:, 4:], *np.moveaxis(torques, 1, 0))


def simulate_open(robot, command, *, period=2e-3, substeps=None, state=None,
                  disturbance=None):
    """
    Return the true states (T + 1, 4, n_joints) of a robot under torques held over a sample.

    q_link, dq_link, q_motor, dq_motor from ``state``, by default at rest at zero, for ``command``
    (T, n_joints) [N m], in ``substeps`` of a sample, by default of `STEP`.
    """
    command = np.ascontiguousarray(command, dtype=float)
    states = np.empty((len(command) + 1, 4, robot.n_joints))
    drawn = np.zeros(len(command)) if disturbance is None else disturbance.drawn
    loop.run_open(command, period, substeps or round(period / STEP),
                  at_rest(robot) if state is None else state.copy(),
                  constants_of(robot), strange_record(disturbance), drawn, states)
    return states
