# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
The torques of Eq. (1) along a motion that was measured, with every effect of the catalogue.

The same functions that move the simulated robot are called along the measured motion, so an effect
needs no second description to be looked for: what it adds here is what it would add there.
"""

from gms_flex_control.compiled import compiled
from gms_flex_control.effects import signals as sig
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Stage
from gms_flex_control.friction import gms
from gms_flex_control.simulation import plant

_ACTUATOR, _, _, _FRICTION, _LINK, _MOTOR, _ = (int(stage) for stage in Stage)
_SUBSTEPS = 4  # of a sample, where an actuator changes what it is told


@compiled
def mean_applied(command, supply, time, period, constants, state, work, out):
    """Write the mean torque (T, n) the actuators give from each sample to the next."""
    s, effects = work.signals, constants.effects
    samples, n = command.shape
    for k in range(samples):
        out[k, :] = 0.0
        s[:, sig.SUPPLY] = supply[k]
        for part in range(_SUBSTEPS):
            for j in range(n):
                s[j, sig.TIME] = time[k] + part * period / _SUBSTEPS
                s[j, sig.JOINT], s[j, sig.JOINTS], s[j, sig.TORQUE] = j, n, command[k, j]
            effect_table.run_stage(_ACTUATOR, s, state.memory, period / _SUBSTEPS, effects)
            for j in range(n):
                out[k, j] += s[j, sig.TORQUE] / _SUBSTEPS


@compiled
def replay_friction(k, states, period, constants, state, work):
    """Move the blocks to sample ``k`` and write the friction torques into ``work.friction``."""
    if k > 0:
        for j in range(states.shape[2]):
            work.displacement[j] = states[k, 0, j] - states[k - 1, 0, j]
        gms.advance(state.friction, work.displacement, state.dq_link, period, constants.friction)
    gms.total(state.friction, state.dq_link, constants.friction, work.friction)


@compiled
def friction_along(states, period, constants, state, work, friction):
    """Fill ``friction`` (T, n) [N m] along a motion (T, 6, n); state and work are overwritten."""
    for k in range(states.shape[0]):
        for j in range(states.shape[2]):
            state.dq_link[j] = states[k, 1, j]
        replay_friction(k, states, period, constants, state, work)
        for j in range(states.shape[2]):
            friction[k, j] = work.friction[j]


@compiled
def torques_along(states, friction, command, time, period, constants, state, work, link, motor):
    """
    Write the torques of Eq. (1) along a measured motion that are not those of rigid bodies.

    Parameters
    ----------
    states : ndarray, shape (T, 6, n)
        Smoothed link angle, rate and acceleration, then those of the motor.
    friction : ndarray, shape (T, n)
        Of the links, of `friction_along` [N m].
    command : ndarray, shape (T, n)
        Torque of the actuators about there, for effects that look at it [N m].
    time : ndarray, shape (T,)
        [s].
    period : float
        Sample [s].
    constants, state, work : numpy.record
        From simulation.plant; the state is overwritten.
    link, motor : ndarray, shape (T, n)
        Filled: all torques at sample k that move link and motor, but those of the actuators and
        of dynamics.chain.rigid_body_along.

    """
    s, links, effects = work.signals, constants.chain, constants.effects
    samples, n = command.shape
    for k in range(samples):
        plant.take_place(k, states, command[k], time[k], state, work)
        plant.springs(state, period, constants, work)
        for j in range(n):
            s[j, sig.FRICTION] = friction[k, j]
        for stage in (_FRICTION, _LINK, _MOTOR):
            effect_table.run_stage(stage, s, state.memory, period, effects)
        for j in range(n):
            link[k, j] = s[j, sig.LINK_TORQUE] - s[j, sig.FRICTION]
            if links.flexible[j]:
                link[k, j] += s[j, sig.SPRING]
                motor[k, j] = s[j, sig.MOTOR_TORQUE] - s[j, sig.SPRING]
            else:
                link[k, j] += s[j, sig.MOTOR_TORQUE]
                motor[k, j] = 0.0


@compiled
def spring_torques(states, command, time, period, constants, state, work, spring):
    """Write the torques (T, n) of springs along a motion; arguments as of `torques_along`."""
    for k in range(command.shape[0]):
        plant.take_place(k, states, command[k], time[k], state, work)
        plant.springs(state, period, constants, work)
        for j in range(command.shape[1]):
            spring[k, j] = work.signals[j, sig.SPRING]


@compiled
def sensor_errors(states, friction, command, time, period, constants, state, work, link, motor):
    """
    Write by how much the encoders of a model read too high along a motion, (T, n) each [rad].

    ``friction`` (T, n) is that of the measured motion: of a base that bends, joints turn against
    it.
    """
    s = work.signals
    for k in range(command.shape[0]):
        plant.take_place(k, states, command[k], time[k], state, work)
        for j in range(command.shape[1]):
            s[j, sig.FRICTION] = friction[k, j]
        plant.run_sensors(state, period, constants, work)
        for j in range(command.shape[1]):
            link[k, j] = s[j, sig.SENSED_LINK] - state.q_link[j]
            motor[k, j] = s[j, sig.SENSED_MOTOR] - state.q_motor[j]
