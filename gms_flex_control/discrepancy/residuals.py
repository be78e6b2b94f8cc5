# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What Eq. (1) leaves unexplained along a measured motion, without differentiating noise.

The functions that move the simulated robot are called along the measured motion, so an effect
needs no second description. Link and motor equation are formed from second differences of the
readings as they are, filtered with the torques alike; smoothed motion serves only where a torque
is a function of it.
"""

from functools import cache, partial

from gms_flex_control import friction as gms
from gms_flex_control import records
from gms_flex_control.compiled import compiled
from gms_flex_control.data import signal_analysis as analysis
from gms_flex_control.discrepancy.motion import filtered_alike, weight_of_neighbours
from gms_flex_control.dynamics import chain
from gms_flex_control.effects import base as sig
from gms_flex_control.effects import table as effect_table
from gms_flex_control.effects.base import Stage, Term
from gms_flex_control.effects.registry import find, names
from gms_flex_control.simulation import plant
import numpy as np

_ACTUATOR, _TORSION, _SPRING, _FRICTION, _LINK, _MOTOR, SENSOR = (int(stage) for stage in Stage)
_CORRECTIONS = 4      # of an unseen link's angle, where a spring is not linear
_CLEARINGS = 3        # iterations that clear a motion of the errors of its encoders
_LEAST_SHIFT = 1e-3   # of the largest: smaller ones give no secant
_STIFFEST = 6.0       # times a spring's stiffness, at most
_OF_BODIES = {  # by a field that the record of that kind of arm has
    'coupling': ('orientation', 'offset', 'moment', 'coupling', 'rigid_inertia', 'gravity'),
    'rotation': ('rotation', 'position', 'offset', 'mass', 'com', 'inertia', 'gravity',
                 'motor_inertia')}


@compiled
def clear_sensor_errors(states, friction, drive, time, period, constants, state, work, true,
                        bend, base) -> None:
    """
    Fill motion ``true`` (T, 6, n) and by how much second differences ``bend`` (T, 2, n) too far.

    ``base`` (T, 2, n) is filled with angle and rate of what each joint stands on.

    Errors of encoders are functions of the true motion, which is the measured one less these
    errors. ``friction`` (T, n) is that of the measured motion: joints turn against it where a
    base bends.
    """
    samples, n = drive.shape
    s, off = work.signals, bend.copy()
    for turn in range(_CLEARINGS):
        for i in range(state.memory.shape[0]):
            state.memory[i] = 0.0
        for k in range(samples):
            plant.take_place(k, true if turn else states, drive[k], time[k], state, work)
            for j in range(n):
                s[j, sig.FRICTION] = friction[k, j]
            plant.run_sensors(state, period, constants, work)
            for j in range(n):
                base[k, 0, j], base[k, 1, j] = s[j, sig.BASE], s[j, sig.BASE_RATE]
                off[k, 0, j] = s[j, sig.SENSED_LINK] - state.q_link[j]
                off[k, 1, j] = s[j, sig.SENSED_MOTOR] - state.q_motor[j]
        for k in range(samples):
            a, b = max(k - 1, 0), min(k + 1, samples - 1)
            for side in range(2):
                for j in range(n):
                    bend[k, side, j] = 0.0
                    if b - a == 2:
                        bend[k, side, j] = (off[b, side, j] - 2.0 * off[k, side, j]
                                            + off[a, side, j]) / period ** 2
                    true[k, 3 * side, j] = states[k, 3 * side, j] - off[k, side, j]
                    true[k, 3 * side + 1, j] = states[k, 3 * side + 1, j] - (
                        off[b, side, j] - off[a, side, j]) / ((b - a) * period)
                    true[k, 3 * side + 2, j] = states[k, 3 * side + 2, j] - bend[k, side, j]


@compiled
def rigid_body_along(states, second, constants, work, bias, inertial, carried) -> None:
    """Fill ``C dq + g``, ``M second`` and ``M ddq``, (T, n) each, along a motion (T, 6, n)."""
    for k in range(states.shape[0]):
        chain.rigid_body(states[k, 0], states[k, 1], second[k], constants.chain, work.chain,
                         bias[k], inertial[k])
        chain.mass_times(states[k, 2], constants.chain, work.chain, carried[k])


@compiled
def residuals_along(states, second, friction, bias, inertial, carried, drive, rest, time, period,
                    weight, constants, state, work, out) -> None:
    """
    Fill the residual torques ``out`` (T, 2 n) of link and motor equations [N m].

    ``states`` (T, 6, n) is the smoothed motion, ``second`` (T, 2, n) filtered second differences
    of the readings; ``friction``, ``bias``, ``inertial``, ``carried`` (T, n) are torques of the
    blocks, ``C dq + g``, ``M second`` and ``M ddq`` [N m]; ``drive`` (T, n) is the filtered torque
    of the actuators [N m], ``rest`` (T, n) torsion as read less the smoothed one [rad]; ``weight``
    is `motion.weight_of_neighbours`. The state is overwritten.
    """
    s, links, effects = work.signals, constants.chain, constants.effects
    samples, n = drive.shape
    last_friction = work.friction  # with what effects make of it
    measured = np.empty(n)         # torques of springs
    for j in range(n):
        last_friction[j] = friction[0, j]
    for k in range(samples):
        plant.take_place(k, states, drive[k], time[k], state, work)
        plant.springs(state, period, constants, work)
        for j in range(n):
            s[j, sig.FRICTION] = friction[k, j]
            # not as measured: that would explain torque by torque
            measured[j] = s[j, sig.SPRING]
            s[j, sig.SPRING] = carried[k, j] + bias[k, j] + last_friction[j]
        effect_table.run_stage(_FRICTION, s, state.memory, period, effects)
        for j in range(n):
            if links.flexible[j]:
                s[j, sig.SPRING] = measured[j]
        for stage in (_LINK, _MOTOR):
            effect_table.run_stage(stage, s, state.memory, period, effects)
        for j in range(n):
            last_friction[j] = s[j, sig.FRICTION]
            out[k, j] = s[j, sig.LINK_TORQUE] - s[j, sig.FRICTION] - bias[k, j]
            if links.flexible[j]:
                out[k, j] += s[j, sig.SPRING]
                out[k, n + j] = s[j, sig.MOTOR_TORQUE] - s[j, sig.SPRING]
            else:
                out[k, j] += s[j, sig.MOTOR_TORQUE]
                out[k, n + j] = 0.0
    for c in range(2 * n):
        j, before = c % n, out[0, c]
        flexible = links.flexible[j]
        for k in range(samples):
            now = seen = out[k, c]
            if 0 < k < samples - 1:
                seen += weight * (before - 2.0 * now + out[k + 1, c])
            before, unsmoothed = now, links.stiffness[j] * rest[k, j]
            if c < n:
                out[k, c] = inertial[k, j] - seen - unsmoothed - (1.0 - flexible) * drive[k, j]
            else:
                out[k, c] = flexible * (links.motor_inertia[j] * second[k, 1, j] - seen
                                        + unsmoothed - drive[k, j])


def unexplained(motion, constants) -> np.ndarray:
    """
    Return the residual torques (S, 2 n) of a model along a Motion, Eq. (1) [N m].

    ``M ddq + C dq + g - s + F`` of the links, then ``J ddq_motor + s - u`` of the motors, zero
    where a joint is rigid: positive pushes forward. Of an unseen link, both in the first. The
    model is a record of simulation.plant.constants_of.
    """
    constants = motion.carrying(constants)
    drive = drive_torque(motion, constants)
    left, n = _residuals(motion, constants, drive, *motion_as_modelled(motion, constants, drive),
                         _key_of_links(motion, constants)), len(motion.samples.joints)
    for link in motion.samples.unseen:  # the motor equation has been used
        left[:, link.joint] += left[:, n + link.joint]
        left[:, n + link.joint] = 0.0
    return left


def motion_as_modelled(motion, constants, drive) -> tuple:
    """Return motion and second differences, unseen links where the motor equation has them."""
    if not motion.samples.unseen:
        return motion.states, motion.second
    return motion.once(_key_of_links(motion, constants), partial(
        _with_unseen_links, motion, constants, drive))


def _key_of_links(motion, constants):
    """Return what distinguishes motions with unseen links, tuple of bytes."""
    if not motion.samples.unseen:
        return ()
    key = _key(constants, (_ACTUATOR, _TORSION, _SPRING, _MOTOR), 'stiffness', 'damping',
               'motor_inertia')
    return ('unseen', motion.torque, *key, *(
        _key(constants, (SENSOR,), 'friction', *_of_bodies(constants))
        if acts(constants, SENSOR) else ()))


def _with_unseen_links(motion, constants, drive):
    """Return motion (S, 6, n) and second differences (S, 2, n) with computed links."""
    states, second, before = motion.states, motion.second, None
    weight, shift = weight_of_neighbours(motion.factor), np.zeros_like(drive)
    linear = not (acts(constants, _TORSION) or acts(constants, _SPRING))
    for _ in range(1 if linear else _CORRECTIONS):  # one is exact for a linear spring
        on_motor = _on_motors(motion, constants, drive, states, second)
        stiffness = _secant(before, on_motor, filtered_alike(shift, weight),
                            constants.chain.stiffness)
        before, states, second = on_motor, states.copy(), second.copy()
        for link in motion.samples.unseen:
            j = link.joint
            begun = states[:, 0, j]
            moved = analysis.low_pass(
                filtered_alike(begun, weight) + on_motor[:, j] / stiffness[:, j],
                max(round(link.window / motion.factor), 2)) - begun
            window = analysis.odd_window(analysis.RATE_WINDOW / motion.period)
            rates = analysis.derivatives(moved, motion.period, window, (1, 2))
            for order, change in enumerate((moved, *rates)):
                states[:, order, j] += change
            second[:, 0, j] += analysis.second_difference(moved, motion.period)
            shift[:, j] = moved
    return states, second


def _secant(before, after, shift, stiffness):
    """
    Return by how much torques (S, n) have changed per shift of the links [N m/rad].

    Where a spring is softer than believed, as within backlash, its own stiffness is safer.
    """
    if before is None:
        return np.broadcast_to(stiffness, shift.shape)
    large = np.abs(shift) > _LEAST_SHIFT * np.abs(shift).max(axis=0)
    slope = np.where(large, (before - after) / np.where(large, shift, 1.0), stiffness)
    return np.clip(slope, stiffness, _STIFFEST * stiffness)


def _on_motors(motion, constants, drive, states, second):
    """Return what is missing in the motor equations along a motion (S, n)."""
    if acts(constants, SENSOR):
        states, second, _ = cleared(motion, drive, states, second, constants)
    nothing = np.zeros_like(drive)  # links do not enter
    return _formed(motion, constants, drive, states, second, nothing, nothing, nothing, nothing)[
        :, drive.shape[1]:]


def _residuals(motion, constants, drive, states, second, way):
    """Return what link and motor equations lack (S, 2 n); ``way`` keys torques that are kept."""
    own, work, kept = _key(constants, (), 'friction'), plant.workspace(drive.shape[1]), motion.once
    joints = states
    if acts(constants, SENSOR):
        turns_against, as_read = np.zeros_like(drive), (*way, *own)
        way = (*way, *_key(constants, (SENSOR,)))
        if _bends(constants):
            turns_against = kept(as_read, partial(friction_along, motion, states, constants))
            way = (*way, motion.torque, *_key(constants, (_ACTUATOR,)), *own)
        states, second, base = kept(('cleared', *way), partial(
            cleared, motion, drive, states, second, constants, turns_against))
        joints = states[:, :2] - base
    friction = kept((*way, *own), partial(friction_along, motion, joints, constants))
    bodies = kept((*way, *_key(constants, (), *_of_bodies(constants))), partial(
        _rigid_body, states, second, constants, work))
    out = _formed(motion, constants, drive, states, second, friction, *bodies)
    if motion.samples.pushed is not None:
        out[:, :drive.shape[1]] -= motion.push
    return out


@cache
def _of_torques():
    """Return the addresses of all errors of encoders that follow from torques, set of int."""
    kinds = [find(name) for name in names()]
    return {kind.compiled().address for kind in kinds if issubclass(kind, Term)
            and kind.stage == SENSOR and not kind.acts_along_motion}


def _bends(constants):
    """Return whether errors of the encoders of a model follow from torques."""
    effects = constants.effects
    terms = slice(*effects['stage_start'][[SENSOR, SENSOR + 1]])
    return not _of_torques().isdisjoint(effects['address'][terms].tolist())


def _formed(motion, constants, drive, states, second, friction, bias, inertial, carried):
    out, n = np.empty((len(drive), 2 * drive.shape[1])), drive.shape[1]
    residuals_along(states, second, friction, bias, inertial, carried, drive, motion.torsion_rest,
                    motion.time, motion.period, weight_of_neighbours(motion.factor), constants,
                    fresh_state(constants), plant.workspace(n), out)
    return out


def _of_bodies(constants):
    """Return the names of the fields that rigid-body terms depend on, tuple of str."""
    names = constants.chain.dtype.names
    return next(fields for field, fields in _OF_BODIES.items() if field in names)


def _key(constants, stages, *fields):
    """Return what distinguishes models by some stages of effects and fields, tuple of bytes."""
    effects, links, found = constants.effects, constants.chain, []
    starts, params = effects['stage_start'], effects['first_param']
    for stage in stages:
        terms = slice(starts[stage], starts[stage + 1])
        if terms.start < terms.stop:
            last = params[terms.stop] or None  # 0 behind the last term
            found += [effects['address'][terms].tobytes(), effects['joint'][terms].tobytes(),
                      effects['params'][params[terms.start]:last].tobytes()]
    return (*found, *((constants.friction if name == 'friction' else links[name]).tobytes()
                      for name in fields))


def friction_along(motion, states, constants) -> np.ndarray:
    """Return the friction torques (S, n) along angles and rates (S, 2 or more, n) [N m]."""
    return gms.replay(states[:, 0], states[:, 1], motion.period, constants.friction)


def _rigid_body(states, second, constants, work):
    """Return ``C dq + g``, ``M second`` and ``M ddq`` of the smoothed ddq, (S, n) each [N m]."""
    found = np.empty((3, len(states), states.shape[2]))
    rigid_body_along(states, np.ascontiguousarray(second[:, 0]), constants, work, *found)
    return found


def inertial_torque(states, constants, work) -> np.ndarray:
    """Return ``M ddq`` of the smoothed acceleration along a motion (S, 6, n), (S, n) [N m]."""
    return _rigid_body(states, states[:, 2:3], constants, work)[2]


def drive_torque(motion, constants) -> np.ndarray:
    """Return the torque of the actuators (S, n) as the equations see it [N m]."""
    if not acts(constants, _ACTUATOR):
        return motion.drive

    def made():
        samples = motion.samples
        return motion.through_filter(plant.torque_applied(
            samples.command, samples.supply, samples.time, samples.period, constants,
            fresh_state(constants)))
    return motion.once(('drive', motion.torque, *_key(constants, (_ACTUATOR,))), made)


def cleared(motion, drive, states, second, constants, friction=None) -> tuple:
    """Return motion (S, 6, n), second differences and bases (S, 2, n), sensor errors cleared."""
    work = plant.workspace(drive.shape[1])
    friction = friction_along(motion, states, constants) if friction is None else friction
    true, bend, base = np.empty_like(states), np.empty_like(second), np.empty_like(second)
    clear_sensor_errors(states, friction, drive, motion.time, motion.period, constants,
                        fresh_state(constants), work, true, bend, base)
    return true, second - bend, base


def fresh_state(constants) -> np.record:
    """Return a state of the plant whose blocks are unloaded and stick."""
    return _unloaded(*constants.friction.stiffness.shape).copy()


@cache
def _unloaded(joints, blocks):
    state = records.build(plant.state_layout(joints, blocks))
    state.friction.sticking[:] = 1
    state.friction.direction[:] = 1.0
    return state


def acts(constants, stage) -> bool:
    """Return whether any effect of a model acts at a stage."""
    start = constants.effects.stage_start
    return start[stage] < start[stage + 1]
