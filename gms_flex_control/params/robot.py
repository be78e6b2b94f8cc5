# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The robot as frozen objects: friction, encoders, and all of it with its arm and effects."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import NamedTuple

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.arm import ArmParams
from gms_flex_control.params.key import (
    freeze_arrays,
    keys_of,
    LARGEST,
    number,
    of_joints,
    require_finite,
    require_ranges,
    require_shape,
    SMALLEST,
)
import numpy as np

WEIGHT_TOLERANCE = 1e-6  # of the sum of a joint's weights


@dataclass(frozen=True, kw_only=True, eq=False)
class StribeckParams:
    """Steady friction one way (n_joints,), Eq. (4) and Table 1; ParameterError if impossible."""

    static: np.ndarray = number('static friction F_s', 'N m', lower=SMALLEST, upper=LARGEST)
    coulomb: np.ndarray = number('Coulomb friction F_c', 'N m', lower=SMALLEST, upper=LARGEST)
    velocity: np.ndarray = number('Stribeck velocity v_s', 'rad/s', lower=SMALLEST)
    viscous: np.ndarray = number('viscous friction sigma_2', 'N m s/rad', lower=0.0, upper=LARGEST)

    def __post_init__(self):
        freeze_arrays(self)
        require_ranges(self, self.static.shape)
        if np.any(self.static < self.coulomb):
            raise ParameterError(
                f'static {self.static} is below coulomb {self.coulomb}: '
                'the Stribeck curve would rise with speed; were they swapped?')

    def scaled(self, **factors) -> 'StribeckParams':
        """Return it with some values, by their names, times a number or an array (n_joints,)."""
        return replace(self, **{name: factor * getattr(self, name)
                                for name, factor in factors.items()})


STRIBECK = tuple(key.name for key in keys_of(StribeckParams))


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionParams:
    """
    GMS friction of n joints with N blocks each (Eqs. 2 to 5, Tables 1 to 3).

    ``stiffness`` and ``weight`` are (n, N), ``attraction`` (n,): how fast a slipping block nears
    its level.

    ParameterError if a shape does not fit, a value is out of range or the weights do not sum to 1.
    """

    forward: StribeckParams   # for positive velocity
    backward: StribeckParams
    stiffness: np.ndarray = number('stiffness k_i of each block', 'N m/rad', lower=0.0,
                                   kind='double_array')
    weight: np.ndarray = number('share alpha_i of each block, sum 1', '1', lower=0.0,
                                kind='double_array')
    attraction: np.ndarray = number('C of the slipping blocks', 'N m/s', lower=SMALLEST)

    def __post_init__(self):
        freeze_arrays(self, skip=('forward', 'backward'))
        n = len(self.forward.static)
        require_shape('backward', self.backward.static, (n,))
        require_shape('attraction', self.attraction, (n,))
        if self.stiffness.ndim != 2 or len(self.stiffness) != n:
            raise ParameterError(f'block stiffness must have shape ({n}, n_blocks), '
                                 f'got {self.stiffness.shape}')
        require_shape('block weight', self.weight, self.stiffness.shape)
        require_finite('block stiffness', self.stiffness, at_least=0.0)
        require_finite('block weight', self.weight, at_least=0.0)
        require_finite('attraction', self.attraction, above=0.0)
        if not np.allclose(self.weight.sum(axis=1), 1.0, atol=WEIGHT_TOLERANCE):
            raise ParameterError(f'block weights must sum to 1 per joint, got sums '
                                 f'{self.weight.sum(axis=1)}; divide them by their sum')

    def each_way(self, change: Callable[[StribeckParams], StribeckParams],
                 **others) -> 'FrictionParams':
        """Return it with both directions changed by a function, and other fields replaced."""
        return replace(self, forward=change(self.forward), backward=change(self.backward),
                       **others)

    def of_joints(self, columns: list) -> 'FrictionParams':
        """Return the friction of some joints (list of int), in that order; one may come twice."""
        return of_joints(self, columns, forward=of_joints(self.forward, columns),
                         backward=of_joints(self.backward, columns))

    def with_joints(self, columns: list, other: 'FrictionParams') -> 'FrictionParams':
        """Return it with the friction of some joints (list of int) that of ``other``, in order."""
        n = len(self.attraction)
        order = [n + columns.index(j) if j in columns else j for j in range(n)]

        def chosen(name, of=lambda one: one):
            mine, theirs = (getattr(of(one), name) for one in (self, other))
            if mine.ndim == 2:  # blocks at the end that carry nothing
                most = max(mine.shape[1], theirs.shape[1])
                mine, theirs = (np.pad(one, ((0, 0), (0, most - one.shape[1])))
                                for one in (mine, theirs))
            return np.concatenate([mine, theirs])[order]
        sides = {way: StribeckParams(**{
            name: chosen(name, attrgetter(way)) for name in STRIBECK})
            for way in ('forward', 'backward')}
        weight = chosen('weight')
        used = 1 + np.flatnonzero(weight.any(axis=0)).max()
        return FrictionParams(**sides, stiffness=chosen('stiffness')[:, :used],
                              weight=weight[:, :used], attraction=chosen('attraction'))


WHOLE_ARM = 'arm'


class Kind(NamedTuple):
    """One kind of known parameter, and how well it is known where nothing else is stated."""

    sd: float          # relative standard deviation
    description: str
    called: str        # by a report
    known_by: str = ''   # estimate of `identify` whose interval tells how well it is known
    open_by: tuple = ()  # estimates of `identify` that leave it open; default that one

    def is_left_open(self, part: str, estimate: str) -> bool:
        """Return whether an estimate of a part of the robot, not identified, leaves it open."""
        return f'{part}.{estimate}' in (self.open_by or (self.known_by,))


_OF_LINK = 'arm.mass', 'arm.com', 'recordings.mass'
# data sheets and weighing for masses and springs, repeated identification for friction
UNCERTAIN = {
    'inertia': Kind(0.015, 'inertia of the link, or coupling of the arm (under arm)',
                    'link inertia', 'arm.inertia', ('arm.inertia', *_OF_LINK)),
    'gravity': Kind(0.015, 'mass moment of the link under gravity',
                    'gravity', 'arm.gravity_torque', _OF_LINK),
    'motor_inertia': Kind(0.015, 'inertia of the motor', 'motor inertia', 'arm.motor_inertia'),
    'stiffness': Kind(0.015, 'stiffness of the spring', 'joint stiffness', 'arm.stiffness'),
    'damping': Kind(0.05, 'damping of the spring', 'joint damping', 'arm.damping'),
    'level': Kind(0.02, 'level of friction, both directions together',
                  'Coulomb friction', 'friction.coulomb'),
    'asymmetry': Kind(0.02, 'difference of the levels of both directions', 'asymmetry'),
    'viscous': Kind(0.025, 'viscous friction, both directions together',
                    'viscous friction', 'friction.viscous'),
    'viscous_asymmetry': Kind(0.025, 'difference of viscous friction of both directions',
                              'viscous_asymmetry'),
    'static': Kind(0.015, 'static friction beside the level',
                   'static friction', 'friction.static'),
    'velocity': Kind(0.12, 'Stribeck velocity', 'Stribeck velocity', 'friction.velocity'),
    'attraction': Kind(0.15, 'attraction of slipping blocks', 'attraction',
                       'friction.attraction'),
    'blocks': Kind(0.08, 'stiffness of the friction blocks',
                   'presliding stiffness', 'friction.stiffness',
                   ('friction.stiffness', 'friction.weight'))}
LEAST_SD, LARGEST_SD = 1e-4, 10.0   # that may be stated


@dataclass(frozen=True, kw_only=True, eq=False)
class EncoderParams:
    """What is measured on both sides of all joints; ParameterError if a value is negative."""

    counts: np.ndarray = number('counts per revolution; 0 is ideal', '1', 0.0, 0.0, default=0.0)
    noise: np.ndarray = number('standard deviation before counting', 'rad', 0.0, 0.0, default=0.0)
    velocity_cutoff: np.ndarray = number('low-pass on the differenced angle; 0 reads the true '
                                         'velocity', 'Hz', 0.0, 0.0, default=0.0)

    def __post_init__(self):
        freeze_arrays(self)
        require_ranges(self, (), 'encoder ')


@dataclass(frozen=True, kw_only=True)
class EffectSpec:
    """One effect on one joint."""

    name: str      # of the catalogue
    joint: str     # link name, or 'arm' for an effect of the whole arm
    values: tuple  # of float, in the order of the effect's parameters

    @property
    def key(self) -> tuple[str, str]:
        """Return (effect, joint)."""
        return self.name, self.joint


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotParams:
    """Everything the model knows of a robot; ParameterError if names repeat or numbers differ."""

    joints: tuple            # names of the link sides
    motors: tuple            # names of the motor sides; '' where the joint is rigid
    arm: ArmParams
    friction: FrictionParams
    encoder: EncoderParams
    effects: tuple = ()      # of EffectSpec
    # relative standard deviation of (of UNCERTAIN, joint or 'arm') where it is not the usual one
    uncertainty: Mapping = field(default_factory=dict)
    identified_from: tuple = ()  # `Recording.identity` of those by which friction was identified

    def __post_init__(self):
        n = len(self.joints)
        names = [*self.joints, *(name for name in self.motors if name)]
        if len(set(names)) != len(names) or not all(self.joints):
            raise ParameterError(f'joints and motors need names of their own, got {names}')
        if WHOLE_ARM in self.joints:
            raise ParameterError(f'a joint cannot be called {WHOLE_ARM!r}: '
                                 'effects of the whole arm stand under that name; give it '
                                 'another, as in the import map')
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
    def n_joints(self) -> int:
        """Return the number of joints."""
        return len(self.joints)


def sd_of(robot: RobotParams, kind: str, joint: str) -> float:
    """Return the relative standard deviation of one of UNCERTAIN of a joint or the 'arm'."""
    return robot.uncertainty.get((kind, joint), UNCERTAIN[kind].sd)


def known_to(robot: RobotParams, kind: str) -> np.ndarray:
    """Return the relative standard deviation of one of UNCERTAIN for each joint (n,)."""
    return np.array([sd_of(robot, kind, joint) for joint in robot.joints])


def widened(robot: RobotParams, times: float) -> RobotParams:
    """Return a robot whose parameters are known ``times`` as badly."""
    return replace(robot, uncertainty={
        (kind, joint): times * sd_of(robot, kind, joint)
        for kind in UNCERTAIN for joint in (*robot.joints, WHOLE_ARM)})


def with_effects(robot: RobotParams, *specs: EffectSpec) -> RobotParams:
    """Return a robot with further effects."""
    return replace(robot, effects=(*robot.effects, *specs))
