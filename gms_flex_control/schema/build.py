# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Checked values become frozen objects: robots, gains, limits, bridges, motions; and back."""

from contextlib import contextmanager

from gms_flex_control.effects import registry
from gms_flex_control.effects.catalogue.link import GravityTilt
from gms_flex_control.errors import ConfigError, ParameterError, TrajectoryError
from gms_flex_control.hardware.bridge import BridgeParams
from gms_flex_control.hardware.limits import Limits, NEEDED, UNLIMITED
from gms_flex_control.hardware.mapping import Actuation, JointMap, Reading
from gms_flex_control.params.arm import ArmParams, Frames
from gms_flex_control.params.gains import ControllerParams
from gms_flex_control.params.key import checked, keys_of, REQUIRED
from gms_flex_control.params.robot import (
    EffectSpec,
    EncoderParams,
    FrictionParams,
    RobotParams,
    STRIBECK,
    StribeckParams,
    WEIGHT_TOLERANCE,
)
from gms_flex_control.schema import keys as schema
from gms_flex_control.schema.keys import DOWN, known_keys, robot_keys
from gms_flex_control.schema.urdf_arm import read_links
from gms_flex_control.trajectory import builders
from gms_flex_control.trajectory.polynomials import Trajectory
import numpy as np

_OF_LINKS = ('mass', 'length', 'com', 'inertia')  # which a URDF states
_FACTORS = ('mass_factor', 'inertia_factor')      # on what a URDF states
MOST_JOINTS = 7
_ROWS, _COLUMNS = np.triu_indices(3)  # of an inertia in ten numbers
# stands for friction that is to be identified; no fit relies on it
_PLACEHOLDER = {f'{way}.{name}': 1.0 for way in ('forward', 'backward') for name in STRIBECK} | {
    'stiffness': (100.0,), 'weight': (1.0,), 'attraction': 1.0}


def complete(keys, values: dict) -> dict:
    """Return checked values of all ``keys``, defaults filled in."""
    flat = {}
    for key in keys:
        flat[key.name] = (checked(key, values[key.name]) if key.name in values
                          else key.default_beside(values))
        if flat[key.name] is REQUIRED:
            raise ConfigError(f'{key.name} is missing: {key.description}'
                              f'{f" [{key.unit}]" if key.unit else ""}')
    return flat


def joint_names(values: dict) -> tuple[str, ...]:
    """Return the link names of a flat parameter dict; ConfigError if it names none."""
    key = robot_keys(())[0]
    if key.name not in values:
        raise ConfigError('joints is missing: the robot file lists the names of the link sides')
    joints = checked(key, values[key.name])
    if not joints:
        raise ConfigError('joints is empty: name at least one link side')
    twice = next((joint for joint in joints if joints.count(joint) > 1), None)
    if twice is not None:
        raise ConfigError(f'joints names {twice!r} twice; each link side has a name of its own')
    return joints


def robot_from_values(values: dict) -> RobotParams:
    """Build the robot from flat parameters, such as ``{'arm.joint1.mass': 1.5, ...}``."""
    joints = joint_names(values)
    known = known_keys(values, joints)
    flat = complete(robot_keys(joints), values)
    _require_links(flat['arm.kind'], joints, values)
    motors = flat['motors'] or ('',) * len(joints)
    arm = ArmParams(kind=flat['arm.kind'], axes=flat['arm.axes'],
                    **columns(ArmParams, flat, 'arm', joints) | _links(flat, joints))
    encoder = EncoderParams(**{key.name: flat[f'encoder.{key.name}']
                               for key in keys_of(EncoderParams)})
    effects = _effects({name: checked(known[name], value) for name, value in values.items()
                        if name.startswith('effects.')})
    uncertainty = {(name.split('.')[2], name.split('.')[1]): checked(known[name], value)
                   for name, value in values.items() if name.startswith('uncertainty.')}
    return RobotParams(joints=joints, motors=tuple(motors), arm=arm, encoder=encoder,
                       friction=_friction(flat, joints), effects=effects,
                       uncertainty=uncertainty,
                       identified_from=tuple(flat['identified_from']))


def robot_to_identify(values: dict) -> RobotParams:
    """Return `robot_from_values`, with a placeholder for friction of which nothing is stated."""
    unknown = [prefix for prefix in (f'friction.{joint}.' for joint in joint_names(values))
               if not any(name.startswith(prefix) for name in values)]
    return robot_from_values(values | {prefix + name: value for prefix in unknown
                                       for name, value in _PLACEHOLDER.items()})


def columns(params, flat, prefix, joints) -> dict:
    """Return the fields of a class of parameters, each a list over joints (dict)."""
    return {key.name: [flat[f'{prefix}.{joint}.{key.name}'] for joint in joints]
            for key in keys_of(params)}


def _row(params, prefix, j):
    """Return the fields of joint ``j`` as flat parameters, the inverse of `columns`."""
    return {f'{prefix}.{key.name}': np.asarray(getattr(params, key.name)[j]).tolist()
            for key in keys_of(type(params))}


def _require_links(kind, joints, values):
    """Refuse a planar chain whose file leaves out what a default would change silently."""
    needed = [f'arm.{joint}.{name}' for joint in joints for name in ('mass', 'com')]
    needed += [f'arm.{joint}.length' for joint in joints[:-1]]
    missing = [name for name in needed if name not in values]
    if missing and kind == 'planar':
        raise ConfigError(f'{missing[0]} is missing: a planar chain needs mass and com of each '
                          'link and the length of all but the last')


def frames_from_values(flat, joints) -> Frames | None:
    """Return where the URDF of a robot file has its joints, None without one."""
    if flat['arm.kind'] != 'urdf':
        return None
    return read_links(flat['arm.urdf'], joints, flat['arm.base'], flat['arm.tip']).frames


def _refuse_given(flat, usual, way_out):
    """Raise ConfigError at the first of ``usual`` (name to default) that has another value."""
    for name, value in usual.items():
        if flat[name] != value:
            raise ConfigError(f'{name} {way_out}')


def _links(flat, joints):
    """Return gravity and, of a URDF, the links (dict) as fields of ArmParams."""
    if flat['arm.kind'] != 'urdf':
        usual = {f'arm.{joint}.{name}': value for joint in joints for name, value in (
            *dict.fromkeys(_FACTORS, 1.0).items(), ('inertial', ()))}
        refusal = f"goes with arm.kind urdf, this is {flat['arm.kind']}"
        usual |= dict.fromkeys(('arm.urdf', 'arm.base', 'arm.tip'), '')
        _refuse_given(flat, usual, refusal)
        _refuse_given(flat, {'arm.gravity_vector': DOWN}, f'{refusal}: give arm.gravity')
        return {'gravity': flat['arm.gravity']}
    _refuse_given(flat, {'arm.gravity': 0.0}, 'does not go with arm.kind urdf: give '
                  'arm.gravity_vector: [x, y, z] in the frame of the base')
    if len(flat['arm.gravity_vector']) != 3:
        raise ConfigError('arm.gravity_vector must have three numbers x, y, z, got '
                          f"{list(flat['arm.gravity_vector'])}")
    if not flat['arm.urdf']:
        raise ConfigError('arm.urdf is missing: arm.kind urdf needs the path of a URDF file')
    _refuse_given(flat, {f'arm.{joint}.{name}': 0.0 for joint in joints for name in _OF_LINKS},
                  'does not go with arm.kind urdf: the URDF states it')
    if len(joints) > MOST_JOINTS:
        raise ConfigError(f'joints names {len(joints)}; a chain of a URDF has at most '
                          f'{MOST_JOINTS}')
    return _links_of_urdf(flat, joints)


def _links_of_urdf(flat, joints):
    links = read_links(flat['arm.urdf'], joints, flat['arm.base'], flat['arm.tip'])
    mass, com, inertia = links.mass.copy(), links.com.copy(), links.inertia.copy()
    for j, joint in enumerate(joints):
        own = flat[f'arm.{joint}.inertial']
        if len(own) not in (0, 10):
            raise ConfigError(f'arm.{joint}.inertial must have ten numbers: mass, centre of mass '
                              f'x y z, inertia xx xy xz yy yz zz; got {len(own)}')
        if own:
            mass[j], com[j] = own[0], own[1:4]
            inertia[j, _ROWS, _COLUMNS] = inertia[j, _COLUMNS, _ROWS] = own[4:]
        mass[j] *= flat[f'arm.{joint}.mass_factor']
        inertia[j] *= flat[f'arm.{joint}.inertia_factor']
    return {'gravity': flat['arm.gravity_vector'], 'frames': links.frames, 'com': com,
            'mass': mass, 'inertia': inertia}


@contextmanager
def _about(prefix):
    """Begin the sentence of a ParameterError with the key it is about."""
    try:
        yield
    except ParameterError as error:
        raise ParameterError(f'{prefix}: {error}') from error


def _steady(flat, joints, direction):
    """Return the StribeckParams of one direction; an error names the joint."""
    rows = []
    for joint in joints:
        prefix = f'friction.{joint}.{direction}'
        rows.append({name: flat[f'{prefix}.{name}'] for name in STRIBECK})
        with _about(prefix):
            StribeckParams(**rows[-1])
    return StribeckParams(**{name: [row[name] for row in rows] for name in STRIBECK})


def _friction(flat, joints):
    directions = {direction: _steady(flat, joints, direction)
                  for direction in ('forward', 'backward')}
    blocks = columns(FrictionParams, flat, 'friction', joints)
    attraction = blocks.pop('attraction')
    for joint, stiffness, weight in zip(joints, *blocks.values(), strict=True):
        if len(stiffness) != len(weight) or not stiffness:
            raise ConfigError(f'friction.{joint}: stiffness has {len(stiffness)} blocks and '
                              f'weight {len(weight)}; give both the same number, at least 1')
        if abs(sum(weight) - 1.0) > WEIGHT_TOLERANCE:
            raise ParameterError(f'friction.{joint}.weight sums to {sum(weight):g}, not to 1; '
                                 'divide each weight by the sum')
    most = max(len(row) for row in blocks['stiffness'])
    padded = {name: [[*row, *[0.0] * (most - len(row))] for row in rows]
              for name, rows in blocks.items()}  # a block of weight 0 carries nothing
    return FrictionParams(**directions, **padded, attraction=attraction)


def _effects(values):
    grouped = {}
    for name, value in values.items():
        _, joint, effect, parameter = name.split('.')
        grouped.setdefault((joint, effect), {})[parameter] = value
    return tuple(
        EffectSpec(name=effect, joint=joint, values=registry.find(effect).values(
            given, f'effects.{joint}.{effect}')) for (joint, effect), given in grouped.items())


def controller_from_values(values: dict, joints) -> ControllerParams:
    """Build the gains of ``joints`` from flat parameters; errors as of `robot_from_values`."""
    flat = complete(schema.controller_keys(joints), values)
    with _about(f"gains of {', '.join(joints)}"):
        return ControllerParams(compensation=flat['compensation'],
                                **columns(ControllerParams, flat, 'gains', joints))


def controller_values(gains: ControllerParams, joints) -> dict:
    """Return gains as flat parameters, the inverse of `controller_from_values`."""
    values = {'compensation': gains.compensation}
    for j, joint in enumerate(joints):
        values |= _row(gains, f'gains.{joint}', j)
    return values


def robot_values(robot: RobotParams) -> dict:
    """Return a robot as flat parameters, the inverse of `robot_from_values`."""
    values = {'joints': list(robot.joints), 'motors': list(robot.motors),
              'arm.kind': robot.arm.kind} | _link_values(robot)
    if robot.arm.axes != 'rotary':
        values['arm.axes'] = robot.arm.axes
    values |= {f'encoder.{key.name}': float(getattr(robot.encoder, key.name))
               for key in keys_of(EncoderParams)}
    stated = () if robot.arm.frames is None else _OF_LINKS  # by the URDF
    for j, joint in enumerate(robot.joints):
        values |= {name: value for name, value in _row(robot.arm, f'arm.{joint}', j).items()
                   if name.rpartition('.')[2] not in stated}
        for way in ('forward', 'backward'):
            values |= _row(getattr(robot.friction, way), f'friction.{joint}.{way}', j)
        values |= _row(robot.friction, f'friction.{joint}', j)
    for spec in robot.effects:
        parameters = registry.find(spec.name).parameters
        values |= {f'effects.{spec.joint}.{spec.name}.{parameter.name}': float(value)
                   for parameter, value in zip(parameters, spec.values, strict=True)}
    values |= {f'uncertainty.{joint}.{kind}': float(sd)
               for (kind, joint), sd in robot.uncertainty.items()}
    if robot.identified_from:
        values['identified_from'] = list(robot.identified_from)
    return values


def _link_values(robot):
    """Return gravity, and where the links of a URDF stand (dict)."""
    arm, frames = robot.arm, robot.arm.frames
    if frames is None:
        if arm.gravity[0] != 0.0:
            raise ParameterError('a robot file states gravity along -y only, got '
                                 f'{arm.gravity}; describe a tilt as '
                                 f'effects.arm.{GravityTilt.name}')
        return {'arm.gravity': -float(arm.gravity[1]) + 0.0}
    links = read_links(frames.source, robot.joints, frames.base, frames.tip)
    of_inertia = (np.trace(arm.inertia, axis1=1, axis2=2)
                  / np.trace(links.inertia, axis1=1, axis2=2))
    values = {'arm.gravity_vector': arm.gravity.tolist(), 'arm.urdf': frames.source}
    for j, joint in enumerate(robot.joints):
        factors = float(arm.mass[j] / links.mass[j]), float(of_inertia[j])
        if not (np.allclose(arm.com[j], links.com[j], rtol=1e-9, atol=1e-12) and np.allclose(
                arm.inertia[j], links.inertia[j] * of_inertia[j], rtol=1e-9, atol=1e-12)):
            factors = 1.0, 1.0
            values[f'arm.{joint}.inertial'] = np.concatenate(
                [arm.mass[[j]], arm.com[j], arm.inertia[j, _ROWS, _COLUMNS]]).tolist()
        values |= {f'arm.{joint}.{name}': factor
                   for name, factor in zip(_FACTORS, factors, strict=True)}
    return values | {f'arm.{name}': getattr(frames, name) for name in ('base', 'tip')
                     if getattr(frames, name)}


def limits_from_values(values, joints) -> Limits | None:
    """Return Limits of ``joints`` from flat parameters of a plant; None if nothing is limited."""
    flat = complete(schema.safety_keys(joints), values)
    if all(abs(flat[f'limits.{joint}.{name}']) >= UNLIMITED for joint in joints
           for name in (*NEEDED, 'torsion')):
        return None
    return Limits(**columns(Limits, flat, 'limits', joints))


def bridge_from_values(values, joints, motors) -> BridgeParams:
    """
    Return BridgeParams from flat parameters, links ``joints`` and their ``motors`` ('' if rigid).

    ConfigError or ParameterError if a value has the wrong type or range, or a limit is missing.
    """
    flat = complete((*schema.safety_keys(joints), *schema.bridge_keys(joints)), values)
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
        with _about(prefix):
            links.append(_reading(flat, f'{prefix}.link', joint))
            motor_sides.append(_reading(flat, f'{prefix}.motor', motor) if motor else None)
            effort, moved = f'{prefix}.effort', motor_sides[-1] or links[-1]
            actuators.append(Actuation(
                name=flat[f'{effort}.name'] or moved.name, sign=flat[f'{effort}.sign'],
                torque_constant=flat[f'{effort}.torque_constant'],
                gear=flat[f'{effort}.ratio'] if flat[f'{effort}.side'] == 'motor' else 1.0))
    return JointMap(joints, links, motor_sides, actuators, flat['bridge.command_order'])


def _reading(flat, prefix, name):
    return Reading(name=flat[f'{prefix}.name'] or name,
                   **{key.name: flat[f'{prefix}.{key.name}'] for key in keys_of(Reading)})


def trajectory_from_values(values: dict, joints) -> Trajectory:
    """Return the Trajectory of ``trajectory.type``, beginning at 0; ConfigError names the type."""
    values = {key.name: key.default for key in schema.trajectory_keys(joints)} | values
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
