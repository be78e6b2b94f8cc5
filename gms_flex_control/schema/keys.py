# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The parameters of robot and controller files, and what a name in any file stands for."""

from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError
from gms_flex_control.params.arm import ArmParams, AXES, KINDS
from gms_flex_control.params.friction import FrictionParams, StribeckParams
from gms_flex_control.params.gains import COMPENSATIONS, ControllerParams
from gms_flex_control.params.key import below, Key, keys_of, SMALLEST
from gms_flex_control.params.robot import EncoderParams, LARGEST_SD, LEAST_SD, WHOLE_ARM
from gms_flex_control.params.robot import KINDS as UNCERTAIN
from gms_flex_control.schema import node_keys

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)  # conventional value (3rd CGPM, 1901) [m/s^2]
_PER_JOINT = ('arm', 'friction', 'gains', 'identification', 'limits', 'mapping', 'trajectory')

# of each joint, below arm.<joint>, of a URDF
_OF_URDF = (
    Key('mass_factor', 'mass of the link over that of the URDF', '1', 1.0, SMALLEST),
    Key('inertia_factor', 'inertia of the link about its centre of mass over that of the URDF',
        '1', 1.0, SMALLEST),
    Key('inertial', 'instead of the URDF, in the frame at the joint whose z is its axis: mass, '
        'centre of mass x y z, inertia about it xx xy xz yy yz zz', 'kg, m, kg m^2', (),
        kind='double_array'))
_ROBOT = (
    Key('joints', 'names of the link sides, from the base outwards', kind='string_array'),
    Key('motors', "names of the motor sides; '' for a rigid joint", default=()),
    Key('arm.kind', 'chain in a plane, axes without effect on each other, or the chain of a URDF',
        default='planar', choices=KINDS),
    Key('arm.axes', 'whether decoupled axes turn or slide', default='rotary', choices=AXES),
    Key('arm.gravity', 'gravity along -y of the plane; 0 if it is horizontal', 'm/s^2', 0.0),
    Key('arm.gravity_vector', 'gravity x, y, z in the frame of the base, of kind urdf', 'm/s^2',
        STANDARD_GRAVITY),
    Key('arm.urdf', 'URDF file with the links, relative to the robot file', default=''),
    Key('arm.base', 'link of the URDF where the chain begins; default: the root', default=''),
    Key('arm.tip', 'link of the URDF where the chain ends; what moves beyond or beside it is '
        'held at 0', default=''))
COMPENSATION = Key('compensation', 'friction compensation', default='gms', choices=COMPENSATIONS,
                   live=True)


def robot_keys(joints) -> tuple[Key, ...]:
    """Return the keys of a robot file for the given joint names."""
    keys = [*_ROBOT, *below('encoder', keys_of(EncoderParams))]
    for joint in joints:
        keys += [*below(f'arm.{joint}', (*keys_of(ArmParams), *_OF_URDF)),
                 *(key for way in ('forward', 'backward')
                   for key in below(f'friction.{joint}.{way}', keys_of(StribeckParams))),
                 *below(f'friction.{joint}', keys_of(FrictionParams))]
    return tuple(keys)


def controller_keys(joints) -> tuple[Key, ...]:
    """Return the keys of a controller file for the given joint names."""
    gains = keys_of(ControllerParams)
    return (COMPENSATION, *(key for joint in joints for key in below(f'gains.{joint}', gains)))


def all_keys(joints) -> dict[str, Key]:
    """Return the keys of all nodes by name, for one file shared by all."""
    keys = (*robot_keys(joints), *controller_keys(joints), *node_keys.all_node_keys(joints))
    return {key.name: key for key in keys}


def _effect_key(name, joints):
    """
    Return the key of an effect's parameter, ``effects.<joint>.<effect>.<parameter>``.

    ConfigError names the nearest if joint, effect or parameter is unknown.
    """
    parts = name.split('.')
    if len(parts) != 4:
        raise ConfigError(f'{name} must have the form effects.<joint>.<effect>.<parameter>')
    _, joint, effect, parameter = parts
    _require_place(name, joint, joints)
    try:
        kind = registry.find(effect)
    except ParameterError as error:
        raise ConfigError(f'{name}: {error}') from error
    if kind.whole_arm != (joint == WHOLE_ARM):
        place = f'effects.{WHOLE_ARM}' if kind.whole_arm else 'effects.<joint>'
        raise ConfigError(f'{name}: {effect} belongs under {place}')
    known = {entry.name: entry for entry in kind.parameters}
    if parameter not in known:
        raise ConfigError(f'{name}: {effect} has no parameter {parameter!r}'
                          f'{did_you_mean(parameter, known)}')
    entry = known[parameter]
    return Key(name, entry.description, entry.unit, lower=entry.lower,
               upper=entry.upper)


def _require_place(name, joint, joints):
    """Raise ConfigError if a key's joint is neither one of the robot's nor the whole arm."""
    if joint not in (*joints, WHOLE_ARM):
        raise ConfigError(f'{name}: unknown joint {joint!r}'
                          f'{did_you_mean(joint, (*joints, WHOLE_ARM))}')


def _uncertainty_key(name, joints):
    """Return the key of a standard deviation, ``uncertainty.<joint>.<kind>``."""
    parts = name.split('.')
    if len(parts) != 3:
        raise ConfigError(f'{name} must have the form uncertainty.<joint>.<kind>')
    _, joint, kind = parts
    _require_place(name, joint, joints)
    if kind not in UNCERTAIN:
        raise ConfigError(f'{name}: unknown kind of parameter {kind!r}'
                          f'{did_you_mean(kind, UNCERTAIN)}')
    return Key(name, f'relative standard deviation: {UNCERTAIN[kind].description}', '1',
               lower=LEAST_SD, upper=LARGEST_SD)


def known_keys(names, joints) -> dict[str, Key]:
    """Return the key of every name of a file (dict); ConfigError at the first unknown one."""
    known = all_keys(joints)
    keys = {}
    for name in names:
        if name.startswith('effects.'):
            keys[name] = _effect_key(name, joints)
        elif name.startswith('uncertainty.'):
            keys[name] = _uncertainty_key(name, joints)
        elif name in known:
            keys[name] = known[name]
        else:
            raise ConfigError(f'{name} is not a known parameter{_nearest(name, known, joints)}')
    return keys


def _nearest(name, known, joints):
    parts = name.split('.')
    if len(parts) > 2 and parts[0] in _PER_JOINT and parts[1] not in joints:
        return f'; unknown joint {parts[1]!r}{did_you_mean(parts[1], joints)}'
    return did_you_mean(name, [key for key in known if key.count('.') == name.count('.')])
