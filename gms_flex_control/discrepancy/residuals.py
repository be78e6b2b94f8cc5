# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What Eq. (1) leaves unexplained along a measured motion, without differentiating noise.

Link and motor equation are formed from second differences of the readings as they are, filtered
with the torques alike, so that nothing but the model's error remains. Smoothed motion serves only
where a torque is a function of it.
"""

from gms_flex_control import records
from gms_flex_control.discrepancy import equations
from gms_flex_control.discrepancy.motion import (
    sampled_weight,
    second_difference,
    seen,
    smoothing,
)
from gms_flex_control.effects.base import Stage
from gms_flex_control.identification.smoothing import derivatives, low_pass
from gms_flex_control.simulation import plant
import numpy as np

ACTUATOR, SENSOR = int(Stage.ACTUATOR), int(Stage.SENSOR)
_CORRECTIONS = 4      # of an unseen link's angle, where a spring is not linear
_CLEARINGS = 3        # of a motion from errors of its encoders
_TOLD = 1e-3          # of the largest shift: with less, no stiffness is told by it
_STIFFEST = 6.0       # times a spring's stiffness, at most
_OF_BODIES = ('orientation', 'offset', 'moment', 'coupling', 'rigid_inertia', 'gravity')
_OF_SPRINGS = int(Stage.TWIST), int(Stage.SPRING)


def unexplained(motion, constants):
    """
    Return the residual torques of a model along a motion.

    Parameters
    ----------
    motion : Motion
        The measured motion, S samples of n joints.
    constants : numpy.record
        The model, of simulation.plant.constants_of.

    Returns
    -------
    ndarray, shape (S, 2 n)
        What is missing in the link equations, then in the motor equations, zero where a joint
        is rigid [N m]: positive pushes forward. Of a link that is unseen, both in the first.

    Notes
    -----
    Eq. (1): ``M ddq + C dq + g - s + F`` and ``J ddq_motor + s - u``.

    """
    work = plant.workspace(len(motion.joints))
    drive = drive_torque(motion, constants, work)
    states, second = motion_as_modelled(motion, constants, work, drive)
    both = _residuals(motion, constants, work, drive, states, second)
    for link in motion.unseen:  # the motor equation has been used
        both[0, :, link.joint] += both[1, :, link.joint]
        both[1, :, link.joint] = 0.0
    return np.concatenate(both, axis=1)


def motion_as_modelled(motion, constants, work, drive):
    """
    Return motion (S, 6, n) and second differences (S, 2, n), unseen links where a model has them.

    That is where its motor equation holds behind the low-pass, whatever it was begun with.
    """
    states, second = motion.states, motion.second
    if not motion.unseen:
        return states, second
    weight, before = sampled_weight(motion.factor), None
    shift = np.zeros_like(drive)
    linear = not any(acts(constants, stage) for stage in _OF_SPRINGS)
    for _ in range(1 if linear else _CORRECTIONS):  # one is exact for a linear spring
        _, on_motor = _residuals(motion, constants, work, drive, states, second)
        stiffness = _secant(before, on_motor, seen(shift, weight), constants.chain.stiffness)
        before, states, second = on_motor, states.copy(), second.copy()
        for link in motion.unseen:
            j = link.joint
            begun = states[:, 0, j]
            shift[:, j] = low_pass(seen(begun, weight) + on_motor[:, j] / stiffness[:, j],
                                   max(round(link.window / motion.factor), 2)) - begun
            _, rate, bend = derivatives(shift[:, j], motion.period, smoothing(motion.period))
            states[:, :3, j] += np.stack([shift[:, j], rate, bend], axis=1)
            second[:, 0, j] += second_difference(shift[:, j], motion.period)
    return states, second


def _secant(before, after, shift, stiffness):
    """
    Return by how much torques (S, n) have changed per shift of the links [N m/rad].

    Where a spring is softer than believed, as within backlash, its own stiffness is safer.
    """
    if before is None:
        return np.broadcast_to(stiffness, shift.shape)
    told = np.abs(shift) > _TOLD * np.abs(shift).max(axis=0)
    slope = np.where(told, (before - after) / np.where(told, shift, 1.0), stiffness)
    return np.clip(slope, stiffness, _STIFFEST * stiffness)


def _residuals(motion, constants, work, drive, states, second):
    """Return what is missing in the link and in the motor equations along a motion (2, S, n)."""
    flexible = constants.chain.flexible
    if acts(constants, SENSOR):
        states, second = corrected(motion, drive, states, second, constants, work)
    link, motor = np.empty((2, *drive.shape))
    equations.torques_along(states, _friction(motion, states, constants, work), drive,
                            motion.time, motion.period, constants, fresh_state(constants), work,
                            link, motor)
    bias, inertial = _rigid_body(motion, states, second, constants, work)
    weight = sampled_weight(motion.factor)
    unsmoothed = constants.chain.stiffness * motion.twist_rest  # what smoothing took of the spring
    on_link = inertial - seen(link - bias, weight) - unsmoothed - (1.0 - flexible) * drive
    if motion.pushed is not None:
        on_link -= motion.through_filter(motion.pushed)
    on_motor = flexible * (constants.chain.motor_inertia * second[:, 1]
                           - seen(motor, weight) + unsmoothed - drive)
    return np.stack([on_link, on_motor])


def _friction(motion, states, constants, work):
    """Return the friction torques (S, n) along states [N m], worked out once for each friction."""
    def made():
        friction = np.empty((len(states), states.shape[2]))
        equations.friction_along(states, motion.period, constants, fresh_state(constants), work,
                                 friction)
        return friction
    if states is not motion.states:
        return made()
    return motion.once(('friction', constants.friction.tobytes()), made)


def _rigid_body(motion, states, second, constants, work):
    """Return ``C dq + g`` and ``M second``, (S, n) each [N m], worked out once for each arm."""
    def made():
        bias, inertial = np.empty((2, len(states), states.shape[2]))
        equations.rigid_body_along(states, np.ascontiguousarray(second[:, 0]), constants.chain,
                                   work.chain, bias, inertial)
        return bias, inertial
    if states is not motion.states or second is not motion.second:
        return made()
    return motion.once(('rigid body', *(constants.chain[name].tobytes() for name in _OF_BODIES)),
                       made)


def drive_torque(motion, constants, work):
    """Return the torque of the actuators (S, n) as the equations see it [N m]."""
    if not acts(constants, ACTUATOR):
        return motion.drive
    applied = np.empty_like(motion.command)
    equations.mean_applied(motion.command, motion.supply, motion.fine_time, motion.fine_period,
                           constants, fresh_state(constants), work, applied)
    return motion.through_filter(applied)


def corrected(motion, drive, states, second, constants, work):
    """
    Return motion (S, 6, n) and second differences (S, 2, n) cleared of sensor errors.

    Errors are functions of the true motion, which is the measured one less these errors.
    """
    link, motor = np.empty((2, *drive.shape))
    true, friction = states, _friction(motion, states, constants, work)
    for _ in range(_CLEARINGS):
        equations.sensor_errors(true, friction, drive, motion.time, motion.period, constants,
                                fresh_state(constants), work, link, motor)
        off = np.stack([link, motor], axis=1)
        rate = np.gradient(off, motion.period, axis=0)
        bend = second_difference(off, motion.period)
        errors = np.stack([off, rate, bend], axis=2).reshape(len(off), 6, -1)
        true = np.ascontiguousarray(states - errors)
    return true, second - bend


def fresh_state(constants):
    """Return a state of the plant whose blocks are unloaded and stick."""
    state = records.build(plant.state_layout(*constants.friction.stiffness.shape))
    state.friction.sticking[:] = 1
    state.friction.direction[:] = 1.0
    return state


def acts(constants, stage):
    """Return whether any effect of a model acts at a stage."""
    start = constants.effects.stage_start
    return start[stage] < start[stage + 1]
