# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The hidden robot in closed loop: truth that shares no integrator with the workflow."""

from dataclasses import replace
from typing import NamedTuple

from gms_flex_control import records
from gms_flex_control.control import cascade
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import table as effect_table
from gms_flex_control.errors import ConfigError, SimulationError
from gms_flex_control.hidden.kernels import loop, mechanics, outside
from gms_flex_control.simulation import encoder
import numpy as np

SUBSTEPS = 50  # 40 microseconds at 500 Hz
# solved with the mass matrix instead of by their terms: the accelerations in them are implicit
CARRIED, BASE = 'motor_inertia_coupling', 'base_flexibility'


class Disturbance(NamedTuple):
    """Something outside the catalogue: see hidden.outsiders."""

    name: str
    joint: int
    values: tuple
    drawn: np.ndarray  # (T,) random numbers, one held over each sample


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
    weight = chain.matrices(q, still, still, still, robot.arm).gravity
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


def simulate(robot, model, gains, reference, *, period=2e-3, substeps=SUBSTEPS, seed=0,
             disturbance=None, supply=None):
    """
    Simulate a robot under the cascade controller.

    Parameters
    ----------
    robot : RobotParams
        As it is, effects included: two joints in a plane, or decoupled ones.
    model : RobotParams
        As the controller believes it to be.
    gains : ControllerParams
        Of the controller.
    reference : ndarray, shape (T, 5, n_joints)
        Desired link angle and derivatives; the robot starts at rest at its first row.
    period : float
        Sample [s].
    substeps : int
        Integration steps in it.
    seed : int
        Of the encoder noise.
    disturbance : Disturbance, optional
        From outside the catalogue.
    supply : ndarray, shape (T,), optional
        Voltage over each sample [V]; not known by default.

    Returns
    -------
    Motion

    Raises
    ------
    SimulationError
        If the loop diverges; the sentence says when.

    """
    samples, n = len(reference), robot.n_joints
    angles, torques = np.empty((samples, 8, n)), np.empty((samples, 4, n))
    drawn = np.zeros(samples) if disturbance is None else disturbance.drawn
    supply = np.zeros(samples) if supply is None else supply
    loop.run(np.ascontiguousarray(reference), period, substeps, at_rest(robot, reference[0, 0]),
             constants_of(robot), strange_record(disturbance), drawn, supply, encoder.init(n),
             encoder.constants_of(robot.encoder), np.random.default_rng(seed),
             cascade.init(model), cascade.constants_of(gains, model), cascade.workspace(n),
             angles, torques)
    sound = np.isfinite(angles).all(axis=(1, 2)) & (np.abs(angles[:, 4]) < 1e3).all(axis=1)
    if not sound.all():
        raise SimulationError(f'the hidden robot diverged at {np.argmin(sound) * period:g} s; '
                              'draw smaller effects or softer gains')
    return Motion(angles[:, :4], angles[:, 4:], *np.moveaxis(torques, 1, 0))


def simulate_open(robot, command, *, period=2e-3, substeps=SUBSTEPS, state=None,
                  disturbance=None):
    """
    Simulate a robot under given torques.

    Parameters
    ----------
    robot : RobotParams
        As it is.
    command : ndarray, shape (T, n_joints)
        Torque held over each sample [N m].
    period, substeps, disturbance
        As `simulate`.
    state : numpy.record, optional
        Start; default at rest at zero.

    Returns
    -------
    ndarray, shape (T + 1, 4, n_joints)
        True q_link, dq_link, q_motor, dq_motor.

    """
    command = np.ascontiguousarray(command, dtype=float)
    states = np.empty((len(command) + 1, 4, robot.n_joints))
    drawn = np.zeros(len(command)) if disturbance is None else disturbance.drawn
    loop.run_open(command, period, substeps, at_rest(robot) if state is None else state.copy(),
                  constants_of(robot), strange_record(disturbance), drawn, states)
    return states
