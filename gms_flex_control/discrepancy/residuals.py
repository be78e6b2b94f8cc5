# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What Eq. (1) leaves unexplained along a measured motion, without differentiating noise.

Link and motor equation are formed from second differences of the readings as they are, filtered
with the torques alike, so that nothing but the model's error remains. Smoothed motion serves only
where a torque is a function of it.
"""

from functools import partial

from gms_flex_control import records
from gms_flex_control.discrepancy import equations
from gms_flex_control.discrepancy.motion import (
    sampled_weight,
    second_difference,
    seen,
    smoothing,
)
from gms_flex_control.dynamics import chain
from gms_flex_control.effects.base import Stage
from gms_flex_control.identification.smoothing import derivatives, low_pass
from gms_flex_control.simulation import plant
import numpy as np

ACTUATOR, SENSOR = int(Stage.ACTUATOR), int(Stage.SENSOR)
_CORRECTIONS = 4      # of an unseen link's angle, where a spring is not linear
_CLEARINGS = 3        # of a motion from errors of its encoders
_OF_SLOPE = 2000      # moments that tell the slope of a spring
_TOLD = 1e-3          # of the largest shift: with less, no stiffness is told by it
_STIFFEST = 6.0       # times a spring's stiffness, at most
_OF_BODIES = {  # by a field that the record of that kind of arm has
    'coupling': ('orientation', 'offset', 'moment', 'coupling', 'rigid_inertia', 'gravity'),
    'rotation': ('rotation', 'position', 'offset', 'mass', 'com', 'inertia', 'gravity',
                 'motor_inertia')}
_OF_SPRINGS = int(Stage.TWIST), int(Stage.SPRING)
_BEFORE_LINKS = ACTUATOR, *_OF_SPRINGS, int(Stage.MOTOR)


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
    both = _residuals(motion, constants, work, drive,
                      *motion_as_modelled(motion, constants, work, drive),
                      _of_springs(motion, constants))
    for link in motion.unseen:  # the motor equation has been used
        both[0, :, link.joint] += both[1, :, link.joint]
        both[1, :, link.joint] = 0.0
    return np.concatenate(both, axis=1)


def stiffness_along(motion, constants):
    """
    Return by how much spring torques change with the torsion along a motion, (n,) [N m/rad].

    The slope of the regression line over some moments: that of a linear spring is its stiffness.
    """
    every = max(len(motion.time) // _OF_SLOPE, 1)
    states, drive, time = (np.ascontiguousarray(one[::every]) for one in (
        motion.states, motion.drive, motion.time))
    torque = np.empty_like(drive)
    equations.spring_torques(states, drive, time, motion.period * every, constants,
                             fresh_state(constants), plant.workspace(len(motion.joints)), torque)
    torsion = states[:, 3] - states[:, 0]
    torsion = torsion - torsion.mean(axis=0)
    return np.sum(torque * torsion, axis=0) / np.maximum(np.sum(torsion ** 2, axis=0), 1e-300)


def motion_as_modelled(motion, constants, work, drive):
    """
    Return motion (S, 6, n) and second differences (S, 2, n), unseen links where a model has them.

    That is where its motor equation holds behind the low-pass, whatever it was begun with.
    """
    if not motion.unseen:
        return motion.states, motion.second
    return motion.once(_of_springs(motion, constants), partial(
        _with_unseen_links, motion, constants, work, drive))


def _of_springs(motion, constants):
    """Return what tells motions with unseen links apart, tuple of bytes."""
    if not motion.unseen:
        return ()
    key = _key(constants, _BEFORE_LINKS, 'stiffness', 'damping', 'motor_inertia')
    return ('unseen', *key, *(_key(constants, (SENSOR,), 'friction', *_of_bodies(constants))
                              if acts(constants, SENSOR) else ()))


def _with_unseen_links(motion, constants, work, drive):
    """Return motion (S, 6, n) and second differences (S, 2, n), unseen links worked out."""
    states, second = motion.states, motion.second
    weight, before = sampled_weight(motion.factor), None
    shift = np.zeros_like(drive)
    joints = [link.joint for link in motion.unseen]
    linear = not any(acts(constants, stage) for stage in _OF_SPRINGS)
    for _ in range(1 if linear else _CORRECTIONS):  # one is exact for a linear spring
        _, on_motor = _residuals(motion, constants, work, drive, states, second,
                                 () if before is None else None)
        stiffness = _secant(before, on_motor, seen(shift, weight), constants.chain.stiffness)
        before, states, second = on_motor, states.copy(), second.copy()
        for link in motion.unseen:
            j = link.joint
            begun = states[:, 0, j]
            shift[:, j] = low_pass(seen(begun, weight) + on_motor[:, j] / stiffness[:, j],
                                   max(round(link.window / motion.factor), 2)) - begun
        moved = np.stack(derivatives(shift[:, joints], motion.period, smoothing(motion.period)),
                         axis=1)
        moved[:, 0] = shift[:, joints]
        states[:, :3, joints] += moved
        second[:, 0, joints] += second_difference(shift[:, joints], motion.period)
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


def _residuals(motion, constants, work, drive, states, second, way=None):
    """
    Return what is missing in the link and in the motor equations along a motion (2, S, n).

    Torques are kept where ``way``, tuple of bytes, tells motions of this recording apart.
    """
    flexible = constants.chain.flexible
    kept = motion.once if way is not None else lambda key, make: make()
    way, friction = way or (), _key(constants, (), 'friction')
    if acts(constants, SENSOR):
        way = (*way, *_key(constants, (ACTUATOR, SENSOR)), *friction)
        states, second = kept(('corrected', *way), partial(
            corrected, motion, drive, states, second, constants, work))
    link, motor = np.empty((2, *drive.shape))
    equations.torques_along(
        states, kept((*way, *friction), partial(_friction, motion, states, constants, work)),
        drive, motion.time, motion.period, constants, fresh_state(constants), work, link, motor)
    bias, inertial = kept((*way, *_key(constants, (), *_of_bodies(constants))), partial(
        _rigid_body, states, second, constants, work))
    weight = sampled_weight(motion.factor)
    unsmoothed = constants.chain.stiffness * motion.twist_rest  # what smoothing took of the spring
    on_link = inertial - seen(link - bias, weight) - unsmoothed - (1.0 - flexible) * drive
    if motion.pushed is not None:
        on_link -= motion.through_filter(motion.pushed)
    on_motor = flexible * (constants.chain.motor_inertia * second[:, 1]
                           - seen(motor, weight) + unsmoothed - drive)
    return np.stack([on_link, on_motor])


def _of_bodies(constants):
    """Return the names of the fields that rigid-body terms depend on, tuple of str."""
    names = constants.chain.dtype.names
    return next(fields for field, fields in _OF_BODIES.items() if field in names)


def _key(constants, stages, *fields):
    """Return what tells models apart by some stages of effects and fields, tuple of bytes."""
    effects, chain, found = constants.effects, constants.chain, []
    starts, params = effects['stage_start'], effects['first_param']
    for stage in stages:
        terms = slice(starts[stage], starts[stage + 1])
        if terms.start < terms.stop:
            last = params[terms.stop] or None  # 0 behind the last term
            found += [effects['address'][terms].tobytes(), effects['joint'][terms].tobytes(),
                      effects['params'][params[terms.start]:last].tobytes()]
    return (*found, *((constants.friction if name == 'friction' else chain[name]).tobytes()
                      for name in fields))


def _friction(motion, states, constants, work):
    """Return the friction torques (S, n) along a motion (S, 6, n) [N m]."""
    friction = np.empty((len(states), states.shape[2]))
    equations.friction_along(states, motion.period, constants, fresh_state(constants), work,
                             friction)
    return friction


def _rigid_body(states, second, constants, work):
    """Return ``C dq + g`` and ``M second``, (S, n) each [N m]."""
    bias, inertial = np.empty((2, len(states), states.shape[2]))
    chain.rigid_body_along(states, np.ascontiguousarray(second[:, 0]), constants.chain,
                           work.chain, bias, inertial)
    return bias, inertial


def drive_torque(motion, constants, work):
    """Return the torque of the actuators (S, n) as the equations see it [N m]."""
    if not acts(constants, ACTUATOR):
        return motion.drive

    def made():
        applied = np.empty_like(motion.command)
        equations.mean_applied(motion.command, motion.supply, motion.fine_time,
                               motion.fine_period, constants, fresh_state(constants), work,
                               applied)
        return motion.through_filter(applied)
    return motion.once(('drive', *_key(constants, (ACTUATOR,))), made)


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
