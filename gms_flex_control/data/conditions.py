# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
What is known of one recording beside its topics: load, temperature, torque constants.

It stands in ``recording.yaml`` in the folder of the bag, ``my_bag.recording.yaml`` beside a bag
that is a single file:

    load: {mass: 5.0, com: [0.0, 0.0, 0.08], inertia: [0.02, 0.0, 0.0, 0.02, 0.0, 0.01]}
    temperature: cold                        # load: unknown is something to be found
    torque_constant: {joint1: 12.4, joint2: {value: 9.1, sd: 0.05}, joint3: unknown}
    coupling: {joint6: {joint5: 1.0}}        # the motor of joint6 turns with joint6 + 1.0 joint5
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import json
import math
from pathlib import Path

from gms_flex_control.data.recording import Operation, Recording
from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError
from gms_flex_control.file_io import checked_yaml, write_text
from gms_flex_control.params.arm import Body, require_body, together
import numpy as np

NAME = 'recording.yaml'
UNKNOWN = 'unknown'
_KEYS = ('load', 'temperature', 'torque_constant', 'coupling')
OF_ROBOT = ('load', 'temperature')  # and not of how its efforts are recorded
_OF_LOAD = ('mass', 'com', 'inertia')
_OF_CONSTANT = ('value', 'sd')
_POINT = 1e-9  # of mass times length squared: inertia of a load that is next to a point


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions:
    """What is known of one recording."""

    operation: Operation = Operation()
    torque_constant: dict | None = None  # per joint value [N m per unit of effort], relative sd;
    #                                      (1, inf) where unknown. None: efforts are torques
    coupling: dict | None = None  # per joint whose motor others turn as well, how far they do


def conditions_of(bag) -> Conditions:
    """Return the Conditions of a bag; ConfigError if its file is wrong."""
    file = _file_of(bag)
    if not file.is_file():
        return Conditions()
    data = checked_yaml(file, ConfigError, 'safe')
    try:
        values = _mapping(data or {}, _KEYS, '')
        unknown = values.get('load') == UNKNOWN
        return Conditions(
            operation=Operation(
                load=_load(values['load']) if 'load' in values and not unknown else None,
                load_unknown=unknown, temperature=str(values.get('temperature', ''))),
            torque_constant=_constants(values['torque_constant'])
            if 'torque_constant' in values else None,
            coupling=_coupling(values['coupling']) if 'coupling' in values else None)
    except (ConfigError, ParameterError) as error:
        raise ConfigError(f'{file}: {error}') from error


def repeat_conditions(bag, new, keys: Sequence[str] = _KEYS, load: Body | None = None) -> None:
    """
    State in the folder of a new bag what is known of another, or some ``keys`` of it.

    A ``load`` is carried beside that of the other.
    """
    file = _file_of(bag)
    known = (checked_yaml(file, ConfigError, 'safe') or {}) if file.is_file() else {}
    values = {key: value for key, value in known.items() if key in keys}
    if load is not None:
        whole = together(conditions_of(bag).operation.load, load)
        values['load'] = {'mass': float(whole.mass), 'com': whole.com.tolist()} | (
            {'inertia': whole.inertia[np.triu_indices(3)].tolist()} if whole.inertia.any() else {})
    if values:
        write_text(_file_of(new), json.dumps(values, default=str) + '\n')  # which is YAML


def _file_of(bag):
    path = Path(bag)
    return path / NAME if path.is_dir() else path.with_name(f'{path.stem}.{NAME}')


def with_conditions(recording: Recording, conditions: Conditions,
                    motors: Sequence[str] = ()) -> Recording:
    """
    Return a recording with what is known of it; efforts of known constants become torques [N m].

    Those of motors that several joints turn become torques of the joints.

    ``motors`` are further names by which constants may be given, in the order of the joints.
    """
    constants = conditions.torque_constant
    recording = replace(recording, operation=conditions.operation)
    if constants is None:
        return _uncoupled(recording, conditions.coupling)
    known = {**{joint: joint for joint in recording.joints},
             **{motor: joint for motor, joint in zip(motors, recording.joints, strict=False)
                if motor}}
    wrong = next((name for name in constants if name not in known), None)
    if wrong is not None:
        raise ConfigError(f'{recording.source}: torque_constant names {wrong!r}, the recording '
                          f'has {", ".join(recording.joints)}{did_you_mean(wrong, known)}')
    values, deviations = np.ones(recording.n_joints), np.zeros(recording.n_joints)
    for name, (value, sd) in constants.items():
        j = recording.joints.index(known[name])
        values[j], deviations[j] = value, sd
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


def _mapping(data, allowed, where):
    """Return a mapping (dict) whose keys are allowed."""
    if not isinstance(data, dict):
        raise ConfigError(f'{where or "the file"} must be a mapping of {", ".join(allowed)}, '
                          f'got {data!r}')
    for key in data:
        if key not in allowed:
            raise ConfigError(f'{where and f"{where}: "}unknown key {key!r}; known are '
                              f'{", ".join(allowed)}{did_you_mean(str(key), allowed)}')
    return data


def _load(data):
    values = _mapping(data, _OF_LOAD, 'load')
    if 'mass' not in values:
        raise ConfigError('load lacks mass [kg]')
    mass = _numbers(values['mass'], 1, 'load.mass')[0]
    com = _numbers(values.get('com', [0.0] * 3), 3, 'load.com')
    if mass < 0.0:
        raise ConfigError(f'load.mass is {mass:g} kg; give 0 for no load, or a mass above 0')
    if mass == 0.0:
        return None
    inertia = _POINT * mass * np.eye(3)
    if 'inertia' in values:
        xx, xy, xz, yy, yz, zz = _numbers(values['inertia'], 6, 'load.inertia')
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        require_body('load', mass, inertia)
    return Body(mass, com, inertia)


def _coupling(data):
    if not isinstance(data, dict) or not data or not all(
            isinstance(one, dict) and one for one in data.values()):
        raise ConfigError('coupling must name joints whose motor others turn as well, such as '
                          f'{{joint6: {{joint5: 1.0}}}}, got {data!r}')
    return {motor: {joint: _numbers(ratio, 1, f'coupling.{motor}.{joint}')[0]
                    for joint, ratio in others.items()} for motor, others in data.items()}


def _constants(data):
    if not isinstance(data, dict) or not data:
        raise ConfigError('torque_constant must name joints, such as {joint1: 12.4, joint2: '
                          f'{UNKNOWN}}}, got {data!r}')
    found = {}
    for joint, entry in data.items():
        where = f'torque_constant.{joint}'
        if entry is None or entry == UNKNOWN:
            found[joint] = (1.0, math.inf)
            continue
        parts = _mapping(entry, _OF_CONSTANT, where) if isinstance(entry, dict) else {
            'value': entry}
        value, sd = (_numbers(parts.get(name, default), 1, f'{where}.{name}')[0]
                     for name, default in (('value', math.nan), ('sd', 0.0)))
        if value == 0.0 or sd < 0.0:
            raise ConfigError(f'{where}: value must not be 0 and sd at least 0, got {entry!r}')
        found[joint] = (value, sd)
    return found


def _numbers(data, count, where):
    """Return finite numbers (count,)."""
    entries = data if isinstance(data, list) else [data]
    good = len(entries) == count and all(
        isinstance(one, (int, float)) and not isinstance(one, bool) and math.isfinite(one)
        for one in entries)
    if not good:
        wanted = 'a number' if count == 1 else f'{count} numbers'
        raise ConfigError(f'{where} must be {wanted}, got {data!r}')
    return np.array(entries, dtype=float)
