# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Rigid bodies and arms: inertia, stiffness, gravity of flexible or rigid joints, loads."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
import re
from typing import NamedTuple
import warnings

from gms_flex_control.errors import ParameterError
from gms_flex_control.params.key import (
    freeze_arrays,
    keys_of,
    LARGEST,
    LARGEST_STATE,
    number,
    require_finite,
    require_shape,
    SMALLEST,
)
import numpy as np

ARM_KINDS = ('planar', 'decoupled', 'urdf')
AXES = ('rotary', 'linear')
STANDARD_GRAVITY = 9.80665  # [m/s^2], conventional value (3rd CGPM, 1901)
# of linear axes in what is printed
_OF_LINEAR = (  # but the phase of a wave is an angle, and an angular frequency no speed
              (r'\b(phase\b[^;,\n\]]*)\brad\b', r'\1radians'),
              (r'\b(bandwidth|crossover|frequency) \[rad/s', r'\1 [1/s'),
              (r'\bkg m\^2', 'kg'), (r'\b([mk]?N) m\b', r'\1'), (r'\bmrad\b', 'mm'),
              (r'\brad\b', 'm'))
# of axes whose efforts are currents of unknown torque constant, after these
_OF_CURRENT = ((r'\bkg m\^2', 'A s^2/rad'), (r'\bkg\b', 'A s^2/m'), (r'\bmN( m)?\b', 'mA'),
               (r'\bkN( m)?\b', 'kA'), (r'\bN( m)?\b(?! =)', 'A'))
POINT = 1e-9      # next to none: of a mass [kg], of an inertia [kg m^2], and of one per mass [m^2]
_ROUNDING = 1e-3  # of a principal moment of inertia: files round their numbers
_CAD = 0.1        # of it: files of makers violate the triangle inequality by so much
_NO_BODY = 'no body has one above the sum of the other two'


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Where the joints of a chain in space are, read from a URDF."""

    rotation: np.ndarray   # (n, 3, 3) of each joint's frame in that of the link before, at 0
    position: np.ndarray   # (n, 3) of its origin there [m]; its axis is z
    prismatic: np.ndarray  # (n,) bool; where true, m stands for rad, N for N m, kg for kg m^2
    lower: np.ndarray      # (n,) limits of the URDF; infinite where it has none [rad]
    upper: np.ndarray
    velocity: np.ndarray   # [rad/s]
    effort: np.ndarray     # [N m]
    end: np.ndarray = (0.0, 0.0, 0.0)  # (3,) of the chain, in the frame of the last link [m]
    end_rotation: np.ndarray = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  # of its frame
    source: str = ''       # the URDF file
    base: str = ''         # the links the chain begins and ends with
    tip: str = ''

    def __post_init__(self):
        freeze_arrays(self, skip=('source', 'base', 'tip', 'prismatic'))
        object.__setattr__(self, 'prismatic', np.array(self.prismatic, dtype=bool))
        n = len(self.prismatic)
        require_shape('rotation', self.rotation, (n, 3, 3))
        require_shape('position', self.position, (n, 3))
        require_shape('end', self.end, (3,))
        require_shape('end_rotation', self.end_rotation, (3, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmParams:
    """
    Rigid-body and joint parameters of n joints, each (n_joints,).

    In space ``com`` is (n_joints, 3) and ``inertia`` (n_joints, 3, 3), in the frame of the link,
    which lies at its joint; ``length`` is 0. A joint of infinite stiffness has no motor side of
    its own. ParameterError if a value is not finite, negative where it must not be, or the arm has
    no inertia.
    """

    kind: str  # of ARM_KINDS: links in one plane, uncoupled axes, a chain in space
    mass: np.ndarray = number('mass of the link', 'kg', 0.0, 0.0, LARGEST)
    length: np.ndarray = number('distance to the next joint', 'm', 0.0, 0.0, LARGEST)
    com: np.ndarray = number('centre of mass from the joint', 'm', 0.0, -LARGEST, LARGEST)
    inertia: np.ndarray = number('inertia about the centre of mass; mass com^2 comes on top. '
                                 'Of a linear axis all that moves',
                                 'kg m^2', lower=0.0, upper=LARGEST,
                                 unless=('arm.kind', 'urdf', 0.0))
    motor_inertia: np.ndarray = number('motor inertia reflected to the joint', 'kg m^2', lower=0.0,
                                       upper=LARGEST, unless=('arm.kind', 'urdf', 0.0))
    stiffness: np.ndarray = number('stiffness of the joint; .inf for a rigid one', 'N m/rad',
                                   lower=SMALLEST, unless=('arm.kind', 'urdf', np.inf))
    damping: np.ndarray = number('damping of the joint', 'N m s/rad', 0.0, 0.0, LARGEST)
    offset: np.ndarray | None = number(
        'angle of the link where the joint reads 0, from the x axis or the link before it', 'rad',
        0.0, -LARGEST_STATE, LARGEST_STATE, default=None)
    gravity: np.ndarray = 0.0  # (x, y) [m/s^2], g stands for (0, -g); (3,) of the base in space
    axes: str = 'rotary'       # of linear ones m stands for rad, N for N m, kg for kg m^2
    frames: Frames | None = None  # of a chain in space

    def __post_init__(self):
        if self.kind not in ARM_KINDS:
            raise ParameterError(
                f"arm.kind must be one of {', '.join(ARM_KINDS)}, got {self.kind!r}")
        if self.axes not in AXES:
            raise ParameterError(f"arm.axes must be one of {', '.join(AXES)}, got {self.axes!r}")
        if self.axes == 'linear' and self.kind != 'decoupled':
            raise ParameterError(f'arm.axes linear needs arm.kind decoupled, got {self.kind}')
        if self.offset is None:
            object.__setattr__(self, 'offset', np.zeros(np.shape(self.stiffness)))
        if (self.frames is None) == (self.kind == 'urdf'):
            raise ParameterError(f'arm.kind urdf goes with frames, got {self.kind} '
                                 f"{'without' if self.frames is None else 'with'} them")
        freeze_arrays(self, skip=('kind', 'axes', 'frames'))
        if self.axes == 'linear' and self.gravity.any():
            raise ParameterError('arm.gravity goes with joints that turn: give the weight on a '
                                 'linear axis as the effect "Constant torque on the link" [N], '
                                 'see gms_flex effects')
        if self.gravity.shape == ():
            object.__setattr__(self, 'gravity', np.array([0.0, -float(self.gravity)]))
        n, space = self.stiffness.shape, () if self.frames is None else (3,)
        require_shape('gravity', self.gravity, space or (2,))
        require_finite('gravity', self.gravity)
        shapes = {'com': n + space, 'inertia': n + 2 * space}
        for key in keys_of(ArmParams):
            value = getattr(self, key.name)
            require_shape(key.name, value, shapes.get(key.name, n))
            if key.name != 'stiffness':  # that of a rigid joint is infinite
                signed = key.lower < 0.0 or key.name == 'inertia'
                require_finite(key.name, value, at_least=None if signed else 0.0)
        self._require_motors()
        if self.frames is None:
            require_finite('inertia', self.inertia, at_least=0.0)
            self._require_inertia()
            return
        for j, (mass, inertia) in enumerate(zip(self.mass, self.inertia, strict=True)):
            require_body(f'link of joint {j + 1}', mass, inertia)

    def _require_motors(self):
        if not np.all(self.stiffness > 0.0):
            raise ParameterError(f'stiffness must be above 0 (.inf for a rigid joint), '
                                 f'got {self.stiffness}')
        flexible = ~self.rigid
        if np.any(self.motor_inertia[flexible] == 0.0):
            raise ParameterError(f'motor_inertia must be above 0 where the joint is flexible, '
                                 f'got {self.motor_inertia}; a rigid joint has stiffness .inf')

    def _require_inertia(self):
        about_joint = self.link_inertia + np.where(self.rigid, self.motor_inertia, 0.0)
        if np.any(about_joint <= 0.0):
            needs = ('inertia, the mass that moves [kg]' if self.axes == 'linear'
                     else 'inertia or mass away from its joint')
            raise ParameterError(f'each link needs {needs}, '
                                 f'got inertia {self.inertia}, mass {self.mass}, com {self.com}')

    @property
    def n_joints(self) -> int:
        """Return the number of joints."""
        return len(self.stiffness)

    @property
    def link_inertia(self) -> np.ndarray:
        """Return the inertia of each link about its joint, of what it carries none (n_joints,)."""
        if self.frames is None:
            return self.inertia + self.mass * self.com ** 2
        turning = self.inertia[:, 2, 2] + self.mass * np.sum(self.com[:, :2] ** 2, axis=1)
        return np.where(self.frames.prismatic, self.mass, turning)

    def scaled(self, factor: np.ndarray) -> 'ArmParams':
        """Return the arm with mass and inertia of its links times ``factor`` (n_joints,)."""
        return replace(self, mass=self.mass * factor, inertia=(self.inertia.T * factor).T)

    def axis(self, joint: int) -> 'ArmParams':
        """Return one of decoupled axes as an arm of its own."""
        return replace(self, **{name: getattr(self, name)[[joint]] for name in (
            'mass', 'length', 'com', 'inertia', 'motor_inertia', 'stiffness', 'damping',
            'offset')})

    @property
    def rigid(self) -> np.ndarray:
        """Return which joints have no motor side of their own, bool (n_joints,)."""
        return np.isinf(self.stiffness)


def in_space(arm: ArmParams) -> ArmParams:
    """Return a planar chain as one in space, every joint's axis z; one in space as it is."""
    if arm.frames is not None:
        return arm
    n, along = arm.n_joints, np.eye(3)[0]
    everywhere = np.full(n, np.inf)
    frames = Frames(
        rotation=np.tile(np.eye(3), (n, 1, 1)), prismatic=np.zeros(n),
        position=np.outer(np.append(0.0, arm.length[:-1]), along), lower=-everywhere,
        upper=everywhere, velocity=everywhere, effort=everywhere)
    about_z = np.maximum(arm.inertia, POINT)
    return replace(
        arm, kind='urdf', axes='rotary', frames=frames, length=np.zeros(n),
        com=np.outer(arm.com, along), mass=np.maximum(arm.mass, POINT),
        gravity=np.append(arm.gravity, 0.0),
        inertia=about_z[:, None, None] * np.diag([0.5, 0.5, 1.0]))


def require_body(name: str, mass: float, inertia: np.ndarray) -> None:
    """Raise ParameterError unless a body ``name`` can have this mass, central inertia (3, 3)."""
    if not mass > 0.0:
        raise ParameterError(f'{name} has mass {mass:g} kg: give a mass above 0')
    moments = np.linalg.eigvalsh(inertia)
    if not moments[0] > 0.0:
        raise ParameterError(f'{_with_moments(name, moments)}: each must be above 0; were ixx to '
                             'izz swapped or given in other units?')
    if moments[2] > (1.0 + _ROUNDING) * (moments[0] + moments[1]):
        raise ParameterError(f'{_with_moments(name, moments)}: {_NO_BODY}; are they about the '
                             'centre of mass, as URDF wants them?')


def nearest_inertia(name: str, inertia: np.ndarray, least: float) -> np.ndarray:
    """
    Return the nearest inertia (3, 3) [kg m^2] that a body has; warn where this is not rounding.

    Many files give points and rods none about some axis: no principal second moment is taken below
    ``least`` then. What is farther off stays as it is, for `require_body`.
    """
    moments = np.linalg.eigvalsh(inertia)
    above, size = moments[2] - moments[0] - moments[1], np.abs(moments).max()
    if moments[0] > 0.0 >= above or max(above, -moments[0]) > _CAD * size:
        return inertia
    if above > _ROUNDING * size:
        warnings.warn(f'{_with_moments(name, moments)}, and {_NO_BODY}: the nearest that a body '
                      'has are taken', stacklevel=2)
    return inertia_of(0.5 * np.trace(inertia) * np.eye(3) - inertia, least)


def _with_moments(name, moments):
    shown = ', '.join(f'{moment:.4g}' for moment in moments)
    return f'{name} has principal moments of inertia {shown} kg m^2'


def inertia_of(second: np.ndarray, least: float) -> np.ndarray:
    """Return an inertia (3, 3) [kg m^2] from second moments (3, 3), none taken below ``least``."""
    size, axes = np.linalg.eigh(second)
    second = (axes * np.maximum(size, least)) @ axes.T
    return np.trace(second) * np.eye(3) - second


def in_units(arm: ArmParams, text: str) -> str:
    """Return a text that is written for rotary axes, its units those of an arm."""
    return in_units_of(arm.axes, text)


def in_units_of(axes: str, text: str) -> str:
    """Return likewise a text in the units of 'linear' axes, or any other as it is."""
    return _with_units(_OF_LINEAR, text) if axes == 'linear' else text


def in_currents(text: str) -> str:
    """Return a text of torques or forces with the units of currents in their place."""
    return _with_units(_OF_CURRENT, text)


def _with_units(units, text):
    """Return a text with some patterns replaced; the next column of a table stays in its place."""
    def placed(match, unit):
        cell = re.sub(*unit, match[0])
        return f'{cell.rstrip():{len(match[0]) - 2}}  ' if match['gap'] else cell

    return reduce(lambda written, one: re.sub(
        f'(?:{one[0]})(?:(?:[^ \\n]| (?! ))*(?P<gap>  +))?', partial(placed, unit=one), written),
        units, text)


class Body(NamedTuple):
    """Mass, centre of mass and inertia about it, in a frame named where it is used."""

    mass: float           # [kg]
    com: np.ndarray       # (3,) [m]
    inertia: np.ndarray   # (3, 3) [kg m^2]


def moved(body: Body, rotation: np.ndarray, position: np.ndarray) -> Body:
    """Return a body in the frame in which its own has ``rotation`` and ``position``."""
    return Body(body.mass, rotation @ body.com + position, rotation @ body.inertia @ rotation.T)


def joined(bodies: Sequence[Body]) -> Body:
    """Return several bodies in one frame as one."""
    mass = sum(body.mass for body in bodies)
    com = sum(body.mass * body.com for body in bodies) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        away = body.com - com
        inertia += body.inertia + body.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return Body(mass, com, inertia)


def at_last_link(load: Body, arm: ArmParams) -> Body:
    """Return a load given in the frame at the end of an arm in the frame of its last link."""
    if arm.frames is None:
        return moved(load, np.eye(3), np.array([arm.length[-1], 0.0, 0.0]))
    return moved(load, arm.frames.end_rotation, arm.frames.end)


def at_end(load: Body, frames: Frames) -> Body:
    """Return a load given in the frame of the last link in the frame at the end of a chain."""
    back = frames.end_rotation.T
    return moved(load, back, -back @ frames.end)


def together(*loads: Body | None) -> Body | None:
    """Return loads in one frame as one, None of none."""
    bodies = [one for one in loads if one is not None]
    return joined(bodies) if bodies else None


def why_not_carried(load: Body, arm: ArmParams) -> str:
    """Return why an arm cannot carry a load, '' if it can."""
    if arm.kind == 'decoupled':
        return 'has a load, which decoupled axes do not share; add it to the inertia of each'
    if arm.kind == 'planar' and load.com[1] != 0.0:
        return (f'has a load {load.com[1]:g} m beside the line of the last link, which a planar '
                'arm cannot carry; give load.com[1] as 0, or write the arm with arm.kind: urdf')
    return ''


def carrying(arm: ArmParams, load: Body | None) -> ArmParams:
    """Return an arm with a load, given in the frame at its end, on its last link."""
    if load is None:
        return arm
    mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
    if arm.frames is not None:
        mass[-1], com[-1], inertia[-1] = joined(
            [Body(mass[-1], com[-1], inertia[-1]), at_last_link(load, arm)])
    else:  # in the plane
        own = Body(mass[-1], np.array([com[-1], 0.0, 0.0]), inertia[-1] * np.eye(3))
        mass[-1], centre, about = joined([own, at_last_link(load, arm)])
        com[-1], inertia[-1] = centre[0], about[2, 2]
    return replace(arm, mass=mass, com=com, inertia=inertia)
