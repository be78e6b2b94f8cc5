# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A robot for other programs: what a target can express of it, the refusal of the rest."""

from collections.abc import Callable, Iterable
import csv
from dataclasses import dataclass, replace
import io

from gms_flex_control.effects import learned, registry
from gms_flex_control.effects.catalogue.friction_level import ViscousError
from gms_flex_control.effects.table import with_changes, with_friction
from gms_flex_control.errors import ConfigError, did_you_mean
from gms_flex_control.file_io import as_yaml
from gms_flex_control.params.arm import in_units
from gms_flex_control.params.robot import RobotParams, STRIBECK, StribeckParams, WHOLE_ARM
from gms_flex_control.schema.build import robot_values
from gms_flex_control.schema.keys import known_keys
from gms_flex_control.schema.urdf import robot_urdf
import numpy as np

# parts of the model that are no effects of the catalogue, and what is exported instead
PARTS = {
    'stribeck': 'Coulomb friction at every speed',
    'stribeck_direction': 'the mean of what both directions add to Coulomb friction',
    'attraction': 'friction that follows its Stribeck curve at once',
    'direction': 'the mean friction of both directions of motion',
    'presliding': 'dry friction without the stiffness of its blocks',
    'spring': 'rigid joints',
    'motor_inertia': 'the inertia of links alone',
    'gravity': 'a horizontal plane',
}
_AT_ONCE = 1e6  # attraction of friction that follows its Stribeck curve [N m/s]


@dataclass(frozen=True, kw_only=True)
class Target:
    """A program that reads robots."""

    title: str       # for messages
    write: Callable  # (RobotParams with effects among these, names left out) -> text
    parts: tuple     # which of PARTS it cannot express
    effects: tuple   # names that it can express, beside those that change parameters
    # yields further (name, where) of a RobotParams that it cannot express
    also_lacks: Callable = lambda _robot: ()


def export(robot: RobotParams, target: Target, without: Iterable[str] = ()) -> str:
    """Return a robot as text for a target ``without`` some `PARTS`; ConfigError names others."""
    without = tuple(without)
    for name in without:
        known = (*PARTS, *registry.names(), *learned.LEARNED)
        if name not in known:
            raise ConfigError(f'--without {name}: no such part or effect'
                              f'{did_you_mean(name, known)}')
    robot = replace(robot, effects=tuple(s for s in robot.effects if s.name not in without))
    robot = simplified(with_changes(robot), without)
    lacking = {}
    for name, where in _lacks(robot, target):
        if name not in without:
            lacking.setdefault(name, []).append(where)
    if lacking:
        named = ', '.join(f'{name} of {" and ".join(dict.fromkeys(places))}'
                          for name, places in lacking.items())
        names = ' '.join(dict.fromkeys((*without, *lacking)))
        instead = ', '.join(PARTS[name] for name in lacking if name in PARTS)
        raise ConfigError(f'{target.title} cannot express {named}; add --without {names}'
                          f'{f" to export {instead} instead" if instead else ""}')
    return target.write(robot, without)


def simplified(robot: RobotParams, without: Iterable[str]) -> RobotParams:
    """Return a robot without the parts of its friction that are named in ``without``."""
    friction = robot.friction
    sides = friction.forward, friction.backward
    if 'stribeck_direction' in without:
        excess = _mean(sides, _excess)
        velocity = _mean(sides, lambda side: side.velocity)
        sides = [replace(side, static=side.coulomb + excess, velocity=velocity) for side in sides]
    if 'direction' in without:
        sides = 2 * [StribeckParams(**{
            name: _mean(sides, lambda side, name=name: getattr(side, name)) for name in STRIBECK})]
    if 'stribeck' in without:
        sides = [replace(side, static=side.coulomb) for side in sides]
    friction = replace(friction, forward=sides[0], backward=sides[1])
    if 'attraction' in without:
        friction = replace(friction, attraction=np.full(robot.n_joints, _AT_ONCE))
    return replace(robot, friction=friction)


def _mean(sides, value):
    return 0.5 * (value(sides[0]) + value(sides[1]))


def _lacks(robot, target):
    """Yield (name, where) of what a target cannot express of a robot, parts first."""
    for part in target.parts:
        for joint, there in zip(robot.joints, _HAS[part](robot), strict=True):
            if there:
                yield part, joint
    yield from target.also_lacks(robot)
    for spec in robot.effects:
        if spec.name not in target.effects:
            yield spec.name, spec.joint


def _differ(robot, values):
    """Return on which joints one of ``values`` of a side differs by direction."""
    sides = robot.friction.forward, robot.friction.backward
    return np.any([~np.isclose(*(value(side) for side in sides), rtol=1e-9)
                   for value in values], axis=0)


def _excess(side):
    return side.static - side.coulomb


def _has_stribeck(robot):
    return np.any([_excess(side) > 0.0 for side in (
        robot.friction.forward, robot.friction.backward)], axis=0)


# which joints of a robot have a part, (n_joints,) bool
_HAS = {
    'stribeck': _has_stribeck,
    'stribeck_direction': lambda robot: _has_stribeck(robot) & _differ(
        robot, (_excess, lambda side: side.velocity)),
    'attraction': lambda robot: _has_stribeck(robot) & (robot.friction.attraction < _AT_ONCE),
    'presliding': lambda robot: np.ones(robot.n_joints, dtype=bool),
    'direction': lambda robot: _differ(robot, (
        _excess, lambda side: side.coulomb, lambda side: side.viscous)),
    'spring': lambda robot: ~robot.arm.rigid,
    'motor_inertia': lambda robot: robot.arm.motor_inertia > 0.0,
    'gravity': lambda robot: np.full(robot.n_joints, bool(np.any(robot.arm.gravity))),
}


_DRY = ('presliding', 'stribeck', 'direction')
_HEADER = """\
# Friction of each joint, in the order of joints: torque = viscous * velocity + coulomb * sign.
# viscous: N m s/rad, coulomb: N m (N s/m and N of a linear axis).
"""
COLUMNS = ('parameter', 'joint', 'value', 'unit', 'meaning')


def urdf(robot: RobotParams, without: tuple = ()) -> str:
    """Return a robot of rigid joints as URDF, friction as ``<dynamics>`` [N m, N m s/rad]."""
    return robot_urdf(with_friction(robot), motors=False)


def ros2_control(robot: RobotParams, without: tuple = ()) -> str:
    """Return a ROS parameter file of viscous and Coulomb friction, one list over joints each."""
    robot = with_friction(robot)
    lists = {name: [float(f'{value:.9g}') for value in getattr(robot.friction.forward, name)]
             for name in ('viscous', 'coulomb')}
    values = {'joints': list(robot.joints), 'friction': lists}
    return _HEADER + as_yaml({'/**': {'ros__parameters': values}}, inline_lists=True)


URDF = Target(title='URDF', write=urdf, effects=(ViscousError.name,),
              parts=('spring', 'motor_inertia', 'gravity', *_DRY))
ROS2_CONTROL = Target(title='ros2_control', write=ros2_control, effects=(ViscousError.name,),
                      parts=_DRY)


def table(robot: RobotParams) -> str:
    """Return a robot as CSV of `COLUMNS`, a row per number, ``name[k]`` for entries of arrays."""
    values = robot_values(robot)
    keys = known_keys(values, robot.joints)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(COLUMNS)
    for name, value in values.items():
        if name in ('joints', 'motors'):
            continue
        parts, key = name.split('.'), keys[name]
        joint = next((part for part in parts[1:-1] if part in (*robot.joints, WHOLE_ARM)), '')
        entries = enumerate(value) if isinstance(value, list) else ((None, value),)
        for k, entry in entries:
            writer.writerow([name if k is None else f'{name}[{k}]', joint, entry,
                             in_units(robot.arm, f'{parts[-1]} {key.unit}').split(' ', 1)[1],
                             key.description])
    return text.getvalue()
