# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The simulated robot: flexible joints, GMS friction and named effects, Eq. (1).

Semi-implicit Euler substeps: velocities from the torques at the old positions, positions from
the new velocities, friction from the displacement. A sticking block is then a spring that
neither creates nor destroys energy on average.
"""

from functools import cache, lru_cache

from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.compiled import compiled, compiled_part
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Stage
from gms_flex_control.records import FLOAT
import numpy as np

_ACTUATOR, _TORSION, _SPRING, _FRICTION, _LINK, _MOTOR, _SENSOR = (int(stage) for stage in Stage)
_SUBSTEPS = 4         # of a sample, where an actuator changes its command


@cache
def state_layout(n, n_blocks) -> np.dtype:
    """
    Return the dtype of the true state of a robot.

    ``q_link``, ``dq_link``, ``q_motor``, ``dq_motor`` (n,) [rad, rad/s], where the motor side of
    a rigid joint follows its link; ``friction``, the state of its blocks; ``memory``, what the
    effects remember; ``applied`` (n,), mean torque of the actuators over the last sample [N m];
    ``base_rate`` (n,), of what each joint stands on, against which its friction acts [rad/s].
    """
    return records.layout(
        *((name, FLOAT, (n,)) for name in (
            'q_link', 'dq_link', 'q_motor', 'dq_motor', 'applied', 'base_rate')),
        ('friction', gms.state_layout(n, n_blocks)),
        ('memory', FLOAT, (effect_table.MEMORY_SIZE,)))


@cache
def constants_layout(links, n, n_blocks) -> np.dtype:
    """Return the dtype of a robot, ``links`` its arm's, as the plant's kernels take it."""
    return records.layout(('chain', links),
                          ('friction', gms.constants_layout(n, n_blocks)),
                          ('effects', effect_table.LAYOUT))


@cache
def work_layout(n) -> np.dtype:
    """
    Return the dtype of the kernels' work space; only accelerations outlive a substep.

    ``outside`` (n,) is torque on the links from outside, zero unless somebody sets it [N m].
    """
    return records.layout(('signals', FLOAT, (n, sig.WIDTH)), ('friction', FLOAT, (n,)),
                          ('displacement', FLOAT, (n,)), ('slip', FLOAT, (n,)),
                          ('outside', FLOAT, (n,)),
                          ('chain', chain.work_layout(n)))


@lru_cache(maxsize=256)
def constants_of(robot) -> np.record:
    """Return a RobotParams as the record the kernels take, its effects included."""
    changed = effect_table.with_changes(robot)
    links = chain.constants_of(changed.arm)
    return records.build(
        constants_layout(links.dtype, *robot.friction.stiffness.shape), chain=links,
        friction=gms.constants_of(changed.friction),
        effects=effect_table.build(changed.effects, changed.joints, changed.arm))


def init(robot, q_link=None) -> np.record:
    """Return the robot at rest with unloaded springs, links at ``q_link`` (n_joints,) [rad]."""
    q = 0.0 if q_link is None else q_link
    return records.build(state_layout(*robot.friction.stiffness.shape), q_link=q, q_motor=q,
                         friction=gms.init(robot.friction))


def workspace(n) -> np.record:
    """Return work space for n joints."""
    return records.build(work_layout(n))


@compiled_part
def fill_signals(state, command, time, work) -> None:
    """Write what the effects may read into the signal table."""
    s = work.signals
    n = state.q_link.shape[0]
    for j in range(n):
        s[j, sig.TIME] = time
        s[j, sig.JOINT], s[j, sig.JOINTS] = j, n
        s[j, sig.Q_LINK], s[j, sig.DQ_LINK] = state.q_link[j], state.dq_link[j]
        s[j, sig.Q_MOTOR], s[j, sig.DQ_MOTOR] = state.q_motor[j], state.dq_motor[j]
        s[j, sig.TORQUE] = command[j]
        s[j, sig.TORSION] = state.q_motor[j] - state.q_link[j]
        s[j, sig.TORSION_RATE] = state.dq_motor[j] - state.dq_link[j]
        s[j, sig.LINK_TORQUE], s[j, sig.MOTOR_TORQUE] = 0.0, 0.0


@compiled
def springs(state, dt, constants, work) -> None:
    """Write torsions and what drives each link into the signals, effects included."""
    s, links, effects = work.signals, constants.chain, constants.effects
    effect_table.run_stage(_TORSION, s, state.memory, dt, effects)
    for j in range(links.motor_inertia.shape[0]):
        s[j, sig.SPRING] = s[j, sig.TORQUE] - links.motor_inertia[j] * s[j, sig.DDQ_LINK]
        if links.flexible[j]:
            s[j, sig.SPRING] = (links.stiffness[j] * s[j, sig.TORSION]
                                + links.damping[j] * s[j, sig.TORSION_RATE])
    effect_table.run_stage(_SPRING, s, state.memory, dt, effects)


@compiled
def friction(state, constants, work) -> None:
    """Write the torques of blocks and viscous friction into ``work.friction``."""
    for j in range(state.dq_link.shape[0]):
        work.slip[j] = state.dq_link[j] - state.base_rate[j]
    gms.total(state.friction, work.slip, constants.friction, work.friction)


@compiled
def torques(state, dt, constants, work) -> None:
    """Evaluate springs, friction and effects; leaves the torque on the links in work.chain.tau."""
    s, links, effects = work.signals, constants.chain, constants.effects
    n = state.q_link.shape[0]
    effect_table.run_stage(_ACTUATOR, s, state.memory, dt, effects)
    springs(state, dt, constants, work)
    friction(state, constants, work)
    for j in range(n):
        s[j, sig.FRICTION] = work.friction[j]
    for stage in (_FRICTION, _LINK, _MOTOR):
        effect_table.run_stage(stage, s, state.memory, dt, effects)
    for j in range(n):
        drive = s[j, sig.SPRING]
        if not links.flexible[j]:
            drive = s[j, sig.TORQUE] + s[j, sig.MOTOR_TORQUE]
        work.chain.tau[j] = (drive + s[j, sig.LINK_TORQUE] - s[j, sig.FRICTION]  # Eq. (1), link
                             + work.outside[j])


@compiled_part
def sensed(state, command, time, period, constants, work) -> None:
    """Write what encoders are given into the signals, errors of sensors included."""
    fill_signals(state, command, time, work)
    run_sensors(state, period, constants, work)


@compiled
def run_sensors(state, period, constants, work) -> None:
    """Write angles and rates that encoders are given, with all other signals filled before."""
    s = work.signals
    for j in range(state.q_link.shape[0]):
        s[j, sig.SENSED_LINK], s[j, sig.SENSED_LINK_RATE] = state.q_link[j], state.dq_link[j]
        s[j, sig.SENSED_MOTOR], s[j, sig.SENSED_MOTOR_RATE] = state.q_motor[j], state.dq_motor[j]
        s[j, sig.BASE], s[j, sig.BASE_RATE] = 0.0, 0.0
    effect_table.run_stage(_SENSOR, s, state.memory, period, constants.effects)
    for j in range(state.q_link.shape[0]):
        state.base_rate[j] = s[j, sig.BASE_RATE]


@compiled
def take_place(k, motion, torque, time, state, work) -> None:
    """
    Put the robot where a measured motion has it at sample ``k``, and fill the signals.

    ``motion`` (T, 6, n) is angle, rate and acceleration of links, then of motors [rad, s];
    ``torque`` (n,) that of the actuators [N m].
    """
    for j in range(torque.shape[0]):
        state.q_link[j], state.dq_link[j] = motion[k, 0, j], motion[k, 1, j]
        state.q_motor[j], state.dq_motor[j] = motion[k, 3, j], motion[k, 4, j]
    fill_signals(state, torque, time, work)
    for j in range(torque.shape[0]):
        work.signals[j, sig.DDQ_LINK] = motion[k, 2, j]
        work.signals[j, sig.DDQ_MOTOR] = motion[k, 5, j]


@compiled
def substep(state, command, time, dt, constants, work) -> None:
    """Advance the true state in place by one substep ``dt`` under ``command`` (n,)."""
    s, links = work.signals, constants.chain
    fill_signals(state, command, time, work)
    torques(state, dt, constants, work)
    chain.accelerations(state.q_link, state.dq_link, links, work.chain)
    for j in range(links.motor_inertia.shape[0]):
        s[j, sig.DDQ_LINK] = work.chain.acceleration[j]
        state.dq_link[j] += dt * work.chain.acceleration[j]
        state.q_link[j] += dt * state.dq_link[j]
        work.slip[j] = state.dq_link[j] - state.base_rate[j]
        work.displacement[j] = dt * work.slip[j]
        if links.flexible[j]:
            s[j, sig.DDQ_MOTOR] = (s[j, sig.TORQUE] + s[j, sig.MOTOR_TORQUE]
                                   - s[j, sig.SPRING]) / links.motor_inertia[j]  # Eq. (1), motor
            state.dq_motor[j] += dt * s[j, sig.DDQ_MOTOR]
            state.q_motor[j] += dt * state.dq_motor[j]
        else:
            state.q_motor[j], state.dq_motor[j] = state.q_link[j], state.dq_link[j]
            s[j, sig.DDQ_MOTOR] = s[j, sig.DDQ_LINK]
    gms.advance(state.friction, work.displacement, work.slip, dt, constants.friction)


@compiled
def advance(state, command, time, period, substeps, constants, work) -> None:
    """Advance the true state in place by one sample under a held ``command`` (n_joints,) [N m]."""
    dt = period / substeps
    state.applied[:] = 0.0
    for k in range(substeps):
        substep(state, command, time + k * dt, dt, constants, work)
        for j in range(command.shape[0]):
            state.applied[j] += work.signals[j, sig.TORQUE] / substeps


@compiled
def _mean_applied(command, supply, time, period, constants, state, work, out) -> None:
    """Write the mean torque (T, n) of the actuators from each sample to the next."""
    s, effects = work.signals, constants.effects
    samples, n = command.shape
    for k in range(samples):
        for j in range(n):
            out[k, j] = 0.0
            s[j, sig.SUPPLY] = supply[k]
        for part in range(_SUBSTEPS):
            for j in range(n):
                s[j, sig.TIME] = time[k] + part * period / _SUBSTEPS
                s[j, sig.JOINT], s[j, sig.JOINTS], s[j, sig.TORQUE] = j, n, command[k, j]
            effect_table.run_stage(_ACTUATOR, s, state.memory, period / _SUBSTEPS, effects)
            for j in range(n):
                out[k, j] += s[j, sig.TORQUE] / _SUBSTEPS


def torque_applied(command, supply, time, period, constants, state) -> np.ndarray:
    """
    Return the mean torque (T, n) that actuators make of commands from each sample to the next.

    ``command`` (T, n) [N m] is held over ``period``, ``supply`` (T,) [V], ``time`` (T,) [s].
    """
    out = np.empty_like(command)
    _mean_applied(command, supply, time, period, constants, state,
                  workspace(command.shape[1]), out)
    return out
