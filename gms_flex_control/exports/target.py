# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What a target can express of a robot, and the refusal of what it cannot, by name."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from gms_flex_control.effects import registry
from gms_flex_control.effects.base import Change
from gms_flex_control.effects.table import with_changes
from gms_flex_control.errors import ConfigError
from gms_flex_control.params.robot import RobotParams
from gms_flex_control.suggest import did_you_mean
import numpy as np

# parts of the model that are no effects of the catalogue, and what is exported without them
PARTS = {
    'stribeck': 'static friction equals Coulomb friction',
    'presliding': 'dry friction without the springs of its blocks',
    'direction': 'mean friction of both directions of motion',
    'viscous_direction': 'mean viscous friction of both directions of motion',
    'spring': 'rigid joints',
    'motor_inertia': 'links alone',
    'gravity': 'no gravity',
}


_AVERAGED = {'direction': ('static', 'coulomb', 'velocity', 'viscous'),
             'viscous_direction': ('viscous',)}


@dataclass(frozen=True, kw_only=True)
class Target:
    """
    A program that reads robots.

    Parameters
    ----------
    title : str
        For messages.
    write : callable
        Returns the text of a RobotParams whose effects are among ``effects``, with the names
        that were left out as second argument.
    parts : tuple of str
        Which of `PARTS` it cannot express.
    effects : tuple of str
        Catalogue names that it can express beside changes of parameters.
    lost_changes : tuple of str
        Changes of parameters that it has not.
    also_lacks : callable, optional
        Yields further (name, where) of a RobotParams that it cannot express.

    """

    title: str
    write: Callable
    parts: tuple
    effects: tuple
    lost_changes: tuple = ()
    also_lacks: Callable = lambda _robot: ()


def export(robot: RobotParams, target: Target, without: Iterable[str] = ()) -> str:
    """
    Return a robot as text for a target.

    Parameters
    ----------
    robot : RobotParams
        With any effects.
    target : Target
        Who reads it.
    without : iterable of str
        Parts of the model (`PARTS`) and effects to leave out.

    Returns
    -------
    str

    Raises
    ------
    ConfigError
        If a name in ``without`` is unknown, or the target cannot express something that is not
        left out.

    """
    without = tuple(without)
    for name in without:
        known = (*PARTS, *registry.names())
        if name not in known:
            raise ConfigError(f'--without {name}: no such part or effect'
                              f'{did_you_mean(name, known)}')
    robot = replace(robot, effects=tuple(s for s in robot.effects if s.name not in without))
    lacking = {}
    for name, where in _lacks(robot, target):
        if name not in without:
            lacking.setdefault(name, []).append(where)
    if lacking:
        told = ', '.join(f'{name} ({"; ".join(dict.fromkeys(places))})'
                         for name, places in lacking.items())
        names = ' '.join(dict.fromkeys((*without, *lacking)))
        raise ConfigError(f'{target.title} cannot express {told}; to leave it out add '
                          f'--without {names}')
    return target.write(simplified(with_changes(robot), without), without)


def simplified(robot: RobotParams, without: Iterable[str]) -> RobotParams:
    """Return a robot without the Stribeck curve or difference by direction named, if any."""
    friction = robot.friction
    averaged = _AVERAGED['direction' if 'direction' in without else 'viscous_direction']
    if {'direction', 'viscous_direction'}.intersection(without):
        mean = {name: 0.5 * (getattr(friction.forward, name) + getattr(friction.backward, name))
                for name in averaged}
        friction = replace(friction, forward=replace(friction.forward, **mean),
                           backward=replace(friction.backward, **mean))
    if 'stribeck' in without:
        friction = replace(friction, **{
            side: replace(getattr(friction, side), static=getattr(friction, side).coulomb)
            for side in ('forward', 'backward')})
    return replace(robot, friction=friction)


def _lacks(robot, target):
    """Yield (name, where) of what a target cannot express of a robot, parts first."""
    changed = with_changes(robot)
    for part in target.parts:
        for joint, there in zip(robot.joints, _HAS[part](changed), strict=True):
            if there:
                yield part, joint
    yield from target.also_lacks(changed)
    for spec in robot.effects:
        change = issubclass(registry.find(spec.name), Change)
        if spec.name not in target.effects and (
                not change or spec.name in target.lost_changes):
            yield spec.name, spec.joint


def _differ(robot, names):
    """Return on which joints friction differs by direction in one of ``names``."""
    both = robot.friction.forward, robot.friction.backward
    return np.any([np.not_equal(*(getattr(side, name) for side in both)) for name in names],
                  axis=0)


# which joints of a robot have a part, sequence of bool
_HAS = {
    'stribeck': lambda robot: np.any([side.static > side.coulomb for side in (
        robot.friction.forward, robot.friction.backward)], axis=0),
    'presliding': lambda robot: np.ones(robot.n_joints, dtype=bool),
    'direction': lambda robot: _differ(robot, _AVERAGED['direction']),
    'viscous_direction': lambda robot: _differ(robot, _AVERAGED['viscous_direction']),
    'spring': lambda robot: ~robot.arm.rigid,
    'motor_inertia': lambda robot: robot.arm.motor_inertia > 0.0,
    'gravity': lambda robot: np.full(robot.n_joints, bool(np.any(robot.arm.gravity))),
}
