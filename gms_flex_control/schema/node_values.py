# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Checked values become what nodes run: limits, bridge to a robot, motion of a reference."""

from gms_flex_control.errors import ConfigError, ParameterError, TrajectoryError
from gms_flex_control.hardware.bridge import BridgeParams
from gms_flex_control.hardware.limits import Limits, NEEDED, UNLIMITED
from gms_flex_control.hardware.mapping import Actuation, JointMap, Reading
from gms_flex_control.params.key import keys_of
from gms_flex_control.schema.build import columns, complete
from gms_flex_control.schema.keys import bridge_keys, safety_keys, trajectory_keys
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import Trajectory


def limits_from_values(values, joints) -> Limits | None:
    """Return Limits of ``joints`` from flat parameters of a plant; None if nothing is limited."""
    flat = complete(safety_keys(joints), values)
    if all(abs(flat[f'limits.{joint}.{name}']) >= UNLIMITED for joint in joints
           for name in (*NEEDED, 'torsion')):
        return None
    return Limits(**columns(Limits, flat, 'limits', joints))


def bridge_from_values(values, joints, motors) -> BridgeParams:
    """
    Return BridgeParams from flat parameters, links ``joints`` and their ``motors`` ('' if rigid).

    ConfigError or ParameterError if a value has the wrong type or range, or a limit is missing.
    """
    flat = complete((*safety_keys(joints), *bridge_keys(joints)), values)
    sources = flat['bridge.state_topics']
    if flat['bridge.device']:
        sources = (f"device {flat['bridge.device']}",)
    if not sources:
        raise ConfigError('bridge.state_topics is empty: name at least one topic')
    return BridgeParams(
        joint_map=_joint_map(flat, joints, motors),
        limits=Limits(**columns(Limits, flat, 'limits', joints)), sources=sources,
        state_timeout=flat['bridge.state_timeout'],
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
                   **{key.name: flat[f'{prefix}.{key.name}'] for key in keys_of(Reading)})


def _actuation(flat, prefix, name):
    return Actuation(
        name=flat[f'{prefix}.name'] or name, sign=flat[f'{prefix}.sign'],
        torque_constant=flat[f'{prefix}.torque_constant'],
        gear=flat[f'{prefix}.ratio'] if flat[f'{prefix}.side'] == 'motor' else 1.0)


def trajectory_from_values(values: dict, joints) -> Trajectory:
    """
    Return the Trajectory chosen by ``trajectory.type``, its own time beginning at 0.

    Of schema.keys.trajectory_keys ``values`` may leave out those with a default. ConfigError,
    which names the type, if they make no trajectory.
    """
    values = {key.name: key.default for key in trajectory_keys(joints)} | values
    kind = values['trajectory.type']
    try:
        return _BUILDERS[kind](_Motion(values, joints))
    except TrajectoryError as error:
        raise ConfigError(f'trajectory.type {kind}: {error}') from error


class _Motion:
    """Short access to the parameters of one motion."""

    def __init__(self, values, joints):
        self._values, self._joints = values, joints

    def __getitem__(self, name):
        return self._values[f'trajectory.{name}']

    def each(self, name) -> list:
        """Return one parameter of every joint (list)."""
        return [self._values[f'trajectory.{joint}.{name}'] for joint in self._joints]

    def rows(self, name) -> list:
        """Return a list per joint as one of all joints per entry; as many of every joint."""
        columns = self.each(name)
        if len({len(column) for column in columns}) != 1 or not columns[0]:
            raise TrajectoryError(f'each joint needs the same number of {name}, got '
                                  f'{[len(column) for column in columns]}')
        return [list(row) for row in zip(*columns, strict=True)]

    def moved(self, trajectory) -> Trajectory:
        """Return a motion from zero as one from where it is to begin."""
        return trajectory.displaced(self.each('offset'))


_BUILDERS = {
    'hold': lambda p: builders.hold([0.0 for _ in p.each('amplitude')]),
    'sinusoid': lambda p: builders.sinusoid(p.each('amplitude'), p.each('period'),
                                            phase=p.each('phase'), ramp_time=p['ramp_time']),
    'polynomial': lambda p: builders.polynomial(p.each('amplitude'), p['move_time'],
                                                p['hold_time'], p['repeats']),
    'via_points': lambda p: builders.via_points(p.rows('points'), p['move_time'], p['hold_time']),
    'fourier': lambda p: p.moved(builders.fourier(
        p.rows('sine'), p.rows('cosine'), p.each('period')[0], repeats=p['repeats'],
        ramp_time=p['ramp_time'])),
    'velocity_levels': lambda p: p.moved(builders.velocity_levels(
        p.rows('velocities'), p['durations'], settle_time=p['ramp_time'])),
    'torque_levels': lambda p: builders.torque_levels(
        p.rows('levels'), p['rate']).displaced(p.each('bias')),
    'sliding': lambda p: p.moved(builders.sliding(
        p.each('velocity'), p['modulation'], p.each('period')[0], p['duration'],
        settle_time=p['ramp_time'])),
}
