# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
What is known of one recording beside its topics: load, temperature, torque constants.

It stands in ``recording.yaml`` in the folder of the bag, ``my_bag.recording.yaml`` beside a bag
that is a single file:

    load: {mass: 5.0, com: [0.0, 0.0, 0.08], inertia: [0.02, 0.0, 0.0, 0.02, 0.0, 0.01]}
    temperature: cold         # load: unknown is to be found, of {mass: 5.0} all but its mass
    torque_constant: {joint1: 12.4, joint2: {value: 9.1, sd: 0.05}, joint3: unknown}
    coupling: {joint6: {joint5: 1.0}}        # the motor of joint6 turns with joint6 + 1.0 joint5
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import json
import math
from pathlib import Path

from gms_flex_control.data.recording import Operation, Recording
from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError
from gms_flex_control.file_io import checked_yaml, read_map, write_text
from gms_flex_control.params.arm import Body, POINT, require_body, together
import numpy as np

NAME = 'recording.yaml'
UNKNOWN = 'unknown'
KEYS = ('load', 'temperature', 'torque_constant', 'coupling')
OF_ROBOT = ('load', 'temperature')  # and not of how its efforts are recorded


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions:
    """What is known of one recording."""

    operation: Operation = Operation()
    torque_constant: dict | None = None  # per joint value [N m per unit of effort], relative sd;
    #                                      (1, inf) where unknown. None: efforts are torques
    coupling: dict | None = None  # per joint whose motor others turn as well, how far they do


def conditions_of(bag) -> Conditions:
    """Return the Conditions of a bag; ConfigError if its file is wrong."""
    file = file_of(bag)
    if not file.is_file():
        return Conditions()
    top = read_map(file, ConfigError)
    top.only(*KEYS)
    whole = top.value('load') == UNKNOWN
    load = None if whole else top.section('load')
    body = _load(load)
    constants = top.section('torque_constant', example=f'{{joint1: 12.4, joint2: {UNKNOWN}}}')
    return Conditions(
        operation=Operation(
            load=body, load_unknown=whole or body is not None and load.value('com') is None,
            temperature=str(top.value('temperature') or '')),
        torque_constant=constants and {joint: _constant(constants, joint)
                                       for joint in constants.keys()},
        coupling=_coupling(top.section('coupling', example='{joint6: {joint5: 1.0}}')))


def repeat_conditions(bag, new, keys: Sequence[str] = KEYS, load: Body | None = None) -> None:
    """State in a new bag's folder what is known of another (``keys``), a ``load`` added."""
    values = {key: value for key, value in _stated(bag).items() if key in keys}
    if load is not None:
        values['load'] = _entry(together(conditions_of(bag).operation.load, load))
    if values:
        write_text(file_of(new), json.dumps(values, default=str) + '\n')  # which is YAML


def with_found(bag, constants: Mapping, load: Body | None, motors: Mapping) -> str:
    """Return what the file of a bag says once torque constants and a load have been found."""
    values, stated = _stated(bag), conditions_of(bag).torque_constant or {}
    known = dict(values.get('torque_constant', {}))
    for joint, (factor, sd) in constants.items():
        names = joint, motors.get(joint, '')
        before = next((stated[name][0] for name in names if name in stated), 1.0)
        known = {name: entry for name, entry in known.items() if name not in names} | {
            joint: {'value': float(f'{before * factor:.5g}'), 'sd': float(f'{sd:.2g}')}}
    if known:
        values['torque_constant'] = known
    if load is not None:
        values['load'] = _entry(load)
    return ''.join(f'{key}: {json.dumps(entry, default=str)}\n' for key, entry in values.items())


def _stated(bag):
    """Return what the file of a bag says (dict), as it stands there."""
    file = file_of(bag)
    return (checked_yaml(file, ConfigError, 'safe') or {}) if file.is_file() else {}


def _entry(load):
    """Return a load as it stands in a file (dict)."""
    return {'mass': float(load.mass), 'com': load.com.tolist()} | (
        {'inertia': load.inertia[np.triu_indices(3)].tolist()} if load.inertia.any() else {})


def file_of(bag) -> Path:
    """Return where the conditions of a bag stand, whether they do or not."""
    path = Path(bag)
    return path / NAME if path.is_dir() else path.with_name(f'{path.stem}.{NAME}')


def with_conditions(recording: Recording, conditions: Conditions, motors: Sequence[str] = (),
                    others: Sequence[str] = ()) -> Recording:
    """
    Return a recording with what is known of it; efforts of known constants become torques [N m].

    Those of motors that several joints turn become torques of the joints.

    ``motors`` are further names by which constants may be given, in the order of the joints;
    those of ``others``, joints and motors that are left out, are not needed.
    """
    constants = conditions.torque_constant
    recording = replace(recording, operation=conditions.operation)
    if constants is None:
        return _uncoupled(recording, conditions.coupling)
    known = {**{joint: joint for joint in recording.joints},
             **{motor: joint for motor, joint in zip(motors, recording.joints, strict=False)
                if motor}}
    wrong = next((name for name in constants if name not in known and name not in others), None)
    if wrong is not None:
        raise ConfigError(f'{recording.source}: torque_constant names {wrong!r}, the recording '
                          f'has {", ".join(recording.joints)}{did_you_mean(wrong, known)}')
    values, deviations = np.ones(recording.n_joints), np.zeros(recording.n_joints)
    for name, joint in known.items():
        if name in constants:
            j = recording.joints.index(joint)
            values[j], deviations[j] = constants[name]
    return _uncoupled(replace(
        recording, scale_sd=deviations, tau_motor=recording.tau_motor * values,
        command=recording.command * values), conditions.coupling)


def _uncoupled(recording, coupling):
    """Return a recording with torques of joints, efforts being those of coupled motors."""
    if coupling is None:
        return recording
    matrix, joints = np.eye(recording.n_joints), recording.joints
    for motor, others in coupling.items():
        for name in (motor, *others):
            if name not in joints:
                raise ConfigError(
                    f'{recording.source}: coupling names {name!r}, the recording has '
                    f'{", ".join(joints)}{did_you_mean(str(name), joints)}')
        if motor in others:
            raise ConfigError(f'{recording.source}: coupling.{motor} names {motor} itself; '
                              'name the other joints that turn its motor')
        for joint, ratio in others.items():
            matrix[joints.index(motor), joints.index(joint)] = ratio
    pairs = np.argwhere(matrix - np.eye(len(joints)))  # of a motor and a joint that it turns
    loose = next((j for j in pairs.ravel() if recording.scale_sd[j] > 0.0), None)
    if loose is not None:
        raise ConfigError(f'{recording.source}: {joints[loose]} has a coupled motor, but its '
                          'torque constant is not known: state it without sd in recording.yaml')

    def of_joints(efforts):
        torque = efforts.copy()  # no product of matrices: one NaN would be of all joints
        for motor, joint in pairs:
            torque[:, joint] += matrix[motor, joint] * efforts[:, motor]
        return torque
    return replace(recording, coupling=matrix, tau_motor=of_joints(recording.tau_motor),
                   command=of_joints(recording.command))


def _load(node):
    if node is None:
        return None
    node.only('mass', 'com', 'inertia')
    mass, com = node.value('mass', 'number'), node.numbers('com', (0.0,) * 3)
    if mass is None:
        raise node.wrong("lacks 'mass' [kg]")
    if mass < 0.0:
        raise node.wrong(f'is {mass:g} kg; give 0 for no load, or a mass above 0', 'mass')
    if mass == 0.0:
        return None
    point = POINT * mass
    xx, xy, xz, yy, yz, zz = node.numbers('inertia', (point, 0.0, 0.0, point, 0.0, point))
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    try:
        require_body('the load', mass, inertia)
    except ParameterError as error:
        raise node.wrong(f'is not a body: {error}', 'inertia') from error
    return Body(float(mass), com, inertia)


def _coupling(node):
    if node is None:
        return None
    others = {motor: node.section(motor, example='{joint5: 1.0}') for motor in node.keys()}
    return {motor: {joint: one.value(joint, 'number') for joint in one.keys()}
            for motor, one in others.items()}


def _constant(node, joint):
    """Return value and relative standard deviation, which is infinite where it is unknown."""
    entry = node.value(joint)
    if entry is None or entry == UNKNOWN:
        return 1.0, math.inf
    if hasattr(entry, 'keys'):
        parts = node.section(joint)
        parts.only('value', 'sd')
        value, sd = parts.value('value', 'number'), parts.value('sd', 'number', 0.0)
    else:
        value, sd = node.value(joint, 'number'), 0.0
    if not value or sd < 0.0:
        raise node.wrong(f'needs a value other than 0 and an sd of at least 0, got {entry!r}',
                         joint)
    return value, sd
