# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Checked values become the limits and the bridge of a plant node."""

from gms_flex_control.errors import ConfigError, ParameterError
from gms_flex_control.hardware.bridge import BridgeParams
from gms_flex_control.hardware.limits import Limits, UNLIMITED
from gms_flex_control.hardware.mapping import Actuation, JointMap, Reading
from gms_flex_control.schema.build import complete
from gms_flex_control.schema.node_keys import bridge_keys, LIMITS, safety_keys

_NEEDED = ('torque', 'torque_rate', 'velocity', 'lower', 'upper')


def limits_from_values(values, joints) -> Limits | None:
    """Return Limits of ``joints`` from flat parameters of a plant; None if nothing is limited."""
    flat = complete(safety_keys(joints), values)
    if all(abs(flat[f'limits.{joint}.{name}']) >= UNLIMITED for joint in joints
           for name in (*_NEEDED, 'torsion')):
        return None
    return Limits(**{name: [flat[f'limits.{joint}.{name}'] for joint in joints]
                     for name in (key.name for key in LIMITS)})


def bridge_from_values(values, joints, motors) -> BridgeParams:
    """
    Return BridgeParams from flat parameters, links ``joints`` and their ``motors`` ('' if rigid).

    ConfigError or ParameterError if a value has the wrong type or range, or a limit is missing.
    """
    flat = complete((*safety_keys(joints), *bridge_keys(joints)), values)
    for joint in joints:
        for name in _NEEDED:
            if abs(flat[f'limits.{joint}.{name}']) >= UNLIMITED:
                raise ConfigError(f'limits.{joint}.{name} is missing: the bridge to a real robot '
                                  f"needs {', '.join(_NEEDED)} of every joint")
    sources = flat['bridge.state_topics']
    if flat['bridge.device']:
        sources = (f"device {flat['bridge.device']}",)
    if not sources:
        raise ConfigError('bridge.state_topics is empty: name at least one topic')
    return BridgeParams(
        joint_map=_joint_map(flat, joints, motors), limits=limits_from_values(values, joints),
        sources=sources, state_timeout=flat['bridge.state_timeout'],
        silence_timeout=flat['silence_timeout'], velocity_cutoff=flat['bridge.velocity_cutoff'],
        skew=flat['bridge.skew'], guarded=flat['bridge.guardian'] and not flat['bridge.device'])


def _joint_map(flat, joints, motors):
    links, motor_sides, actuators = [], [], []
    for joint, motor in zip(joints, motors, strict=True):
        prefix = f'mapping.{joint}'
        try:
            links.append(_reading(flat, f'{prefix}.link', joint))
            motor_sides.append(_reading(flat, f'{prefix}.motor', motor) if motor else None)
            moved = motor_sides[-1] or links[-1]
            actuators.append(_actuation(flat, f'{prefix}.effort', moved.name))
        except ParameterError as error:
            raise ParameterError(f'{prefix}: {error}') from error
    return JointMap(joints, links, motor_sides, actuators, flat['bridge.command_order'])


def _reading(flat, prefix, name):
    return Reading(name=flat[f'{prefix}.name'] or name,
                   **{key: flat[f'{prefix}.{key}'] for key in ('sign', 'ratio', 'offset')})


def _actuation(flat, prefix, name):
    return Actuation(
        name=flat[f'{prefix}.name'] or name, sign=flat[f'{prefix}.sign'],
        torque_constant=flat[f'{prefix}.torque_constant'],
        gear=flat[f'{prefix}.ratio'] if flat[f'{prefix}.side'] == 'motor' else 1.0)
