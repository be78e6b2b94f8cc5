# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The robot as one frozen object: names, arm, friction, encoders and effects."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.encoder import EncoderParams
from gms_flex_control.params.friction import FrictionParams

WHOLE_ARM = 'arm'


@dataclass(frozen=True, kw_only=True)
class EffectSpec:
    """
    One effect on one joint.

    Parameters
    ----------
    name : str
        Catalogue name.
    joint : str
        Link name, or 'arm' for an effect of the whole arm.
    values : tuple of float
        In the order of the effect's ``parameters``.

    """

    name: str
    joint: str
    values: tuple


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotParams:
    """
    Everything the model knows of one robot.

    Parameters
    ----------
    joints, motors : tuple of str
        Names of the link and motor sides; the motor of a rigid joint is ''.
    arm : ArmParams
        Inertia, stiffness, gravity.
    friction : FrictionParams
        Friction of the links.
    encoder : EncoderParams
        What is measured.
    effects : tuple of EffectSpec
        Named terms beyond these.
    uncertainty : dict of (str, str) to float
        Relative standard deviation of a kind (of params.uncertainty) on a joint, or on 'arm',
        where it is not the usual one.

    Raises
    ------
    ParameterError
        If names repeat, or numbers of joints differ.

    """

    joints: tuple
    motors: tuple
    arm: ArmParams
    friction: FrictionParams
    encoder: EncoderParams
    effects: tuple = ()
    uncertainty: Mapping = field(default_factory=dict)

    def __post_init__(self):
        n = len(self.joints)
        names = [*self.joints, *(name for name in self.motors if name)]
        if len(set(names)) != len(names) or not all(self.joints):
            raise ParameterError(f'joints and motors need names of their own, got {names}')
        if WHOLE_ARM in self.joints:
            raise ParameterError(f'a joint cannot be called {WHOLE_ARM!r}: '
                                 'effects of the whole arm stand under that name')
        for part, count in (('arm', self.arm.n_joints), ('motors', len(self.motors)),
                            ('friction', len(self.friction.attraction))):
            if count != n:
                raise ParameterError(f'{part} describes {count} joints, but joints names {n}')
        for joint, motor, rigid in zip(self.joints, self.motors, self.arm.rigid, strict=True):
            if rigid and motor:
                raise ParameterError(f'joint {joint!r} is rigid (stiffness .inf) but has motor '
                                     f'{motor!r}: leave its motor name empty or give a stiffness')
            if not rigid and not motor:
                raise ParameterError(f'joint {joint!r} is flexible but motors has no name for '
                                     'it: name its motor side or set its stiffness to .inf')

    @property
    def n_joints(self):
        """Return the number of joints."""
        return len(self.joints)
