# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
The links of an arm from a URDF: a serial chain, all else fixed to the link it hangs on.

Meshes and shapes are not looked at. What is moved by no joint of the chain belongs to the base.
"""

from dataclasses import dataclass
from functools import lru_cache
import math
from pathlib import Path
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError
from gms_flex_control.params.arm import Body, Frames, joined, moved, nearest_inertia, require_body
import numpy as np

LARGEST = 20_000_000  # bytes of a URDF
_MOVES = ('revolute', 'continuous', 'prismatic')
_LOOSE = ('floating', 'planar')
_MOST_ANGLE = 50.0    # a limit of a revolute joint beyond this is in degrees [rad]
_MOST_LENGTH = 20.0   # of an arm: beyond it lengths are in millimetres, inertias likewise [m]
_XACRO = '{http://www.ros.org/wiki/xacro}'
_POINT = 1e-6          # second moment of a body that has none in a direction, per mass [m^2]
_SHAPES = ('visual', 'collision')


class Joint(NamedTuple):
    """A joint of the URDF; the origin is a rotation (3, 3) and a place (3,) [m]."""

    name: str
    kind: str
    parent: str
    child: str
    rotation: np.ndarray
    position: np.ndarray
    axis: np.ndarray
    limits: dict
    mimics: bool


@dataclass(frozen=True, eq=False)
class Links:
    """Frames, masses, centres of mass and inertias as params.arm.ArmParams takes them."""

    frames: Frames
    mass: np.ndarray      # (n,)
    com: np.ndarray       # (n, 3)
    inertia: np.ndarray   # (n, 3, 3)


def read_links(path, joints, base: str = '', tip: str = '') -> Links:
    """
    Read a serial chain, its ``joints`` from the base outwards, from a URDF file as Links.

    It begins and ends with the links ``base`` and ``tip``, by default the root, and the link of
    the last joint with all that is fixed to it. With a tip, joints beside and beyond the chain are
    held at 0. ConfigError if it is no such chain, or a link cannot have the mass and inertia
    given.
    """
    path = Path(path)
    try:
        stamp = path.stat().st_mtime_ns
    except OSError as error:
        raise ConfigError(f'arm.urdf {path}: cannot be read ({error.strerror}); give a path '
                          'relative to the robot file, or an absolute one') from error
    return _read(path, stamp, tuple(joints), base, tip)


@lru_cache(maxsize=16)
def _read(path, _, joints, base, tip):
    try:
        return _Tree(_root_of(path)).chain(joints, base, tip, str(path))
    except (ConfigError, ParameterError) as error:
        raise ConfigError(f'arm.urdf {path}: {error}') from error


def _root_of(path):
    try:
        if path.stat().st_size > LARGEST:
            raise ConfigError(f'is larger than {LARGEST / 1e6:g} MB, no URDF is')
        root = ElementTree.fromstring(path.read_bytes())
    except OSError as error:
        raise ConfigError(f'cannot be read ({error.strerror})') from error
    except ElementTree.ParseError as error:
        raise ConfigError(f'is not XML ({error})') from error
    if path.suffix == '.xacro' or any(
            element.tag.startswith(_XACRO) or any('${' in text for text in element.attrib.values())
            for element in root.iter() if isinstance(element.tag, str)):
        raise ConfigError(f'has xacro that is not expanded; expand it with: xacro {path.name} > '
                          f"{path.name.partition('.')[0]}_expanded.urdf")
    if root.tag != 'robot':
        raise ConfigError(f'is not a URDF: its root is <{root.tag}>, not <robot>')
    return root


class _Tree:
    """The links and joints of a URDF, each link with at most one joint that moves it."""

    def __init__(self, root):
        self._links = {}
        for element in root.findall('link'):
            name = _named(element, 'link')
            if name in self._links:
                raise ConfigError(f'has two links {name!r}')
            self._links[name] = element
        self.joints = [_joint(element) for element in root.findall('joint')]
        names = [joint.name for joint in self.joints]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ConfigError(f'has two joints {twice!r}')
        self._above = {}
        for joint in self.joints:
            for end in (joint.parent, joint.child):
                if end not in self._links:
                    raise ConfigError(f'joint {joint.name!r} names the link {end!r}, which is '
                                      f'not there{did_you_mean(end, self._links)}')
            if joint.child in self._above:
                raise ConfigError(
                    f'link {joint.child!r} is moved by two joints, '
                    f'{self._above[joint.child].name!r} and {joint.name!r}: closed chains are '
                    'not supported; leave one of them out')
            self._above[joint.child] = joint

    def chain(self, names, base, tip, source) -> 'Links':
        """Return the Links of the chain of joints ``names``; see `read_links`."""
        path = self._path(self._end(names, tip), base)
        self._require(names, path, tip)
        moving = [joint for joint in path if joint.name in names]
        frames, bodies, turn, frame = [], [], np.eye(3), (np.eye(3), np.zeros(3))
        for joint in path:
            frame = _then(frame, (joint.rotation, joint.position))
            if joint not in moving:
                continue
            aligned = _to_z(joint.axis)
            frames.append((turn.T @ frame[0] @ aligned, turn.T @ frame[1]))
            turn, frame = aligned, (np.eye(3), np.zeros(3))
            stop = {other.name for other in moving}
            bodies.append(moved(self._moved(joint, stop), aligned.T, np.zeros(3)))
        end = frame if tip else self._farthest(moving[-1].child)
        limits = [_limits(joint) for joint in moving]
        rotation, position = (np.array(part) for part in zip(*frames, strict=True))
        return Links(
            Frames(rotation=rotation, position=position,
                   prismatic=[joint.kind == 'prismatic' for joint in moving],
                   **{name: [limit[name] for limit in limits] for name in limits[0]},
                   end=turn.T @ end[1], end_rotation=turn.T @ end[0],
                   source=source, base=base, tip=tip),
            *(np.array(part) for part in zip(*bodies, strict=True)))

    def _end(self, names, tip):
        """Return the link the chain ends with."""
        known = {joint.name: joint for joint in self.joints}
        for name in names:
            if name not in known:
                movable = [joint.name for joint in self.joints if joint.kind in _MOVES]
                raise ConfigError(
                    f"has no joint {name!r} that 'joints' of the robot file names; it has "
                    f"{', '.join(movable) or 'none'}{did_you_mean(name, movable)}")
        if tip and tip not in self._links:
            raise ConfigError(f'has no link {tip!r} that arm.tip names'
                              f'{did_you_mean(tip, self._links)}')
        return tip or max((known[name].child for name in names),
                          key=lambda link: len(self._path(link, '')))

    def _path(self, link, base):
        """Return the joints from ``base``, or the root, to a link."""
        if base and base not in self._links:
            raise ConfigError(f'has no link {base!r} that arm.base names'
                              f'{did_you_mean(base, self._links)}')
        path, end = [], link
        while link != base and link in self._above:
            joint = self._above[link]
            if joint.name in (one.name for one in path):
                raise ConfigError(f'the joints form a closed chain at {joint.name!r}: closed '
                                  'chains are not supported; leave one of them out')
            path.insert(0, joint)
            link = joint.parent
        if base and link != base:
            raise ConfigError(f'link {end!r} does not hang on {base!r} that arm.base names, but '
                              f'on {link!r}')
        return path

    def _require(self, names, path, tip):
        """Refuse what is no serial chain of the joints ``names``, in their order."""
        on_path = [joint.name for joint in path]
        for joint in path:
            if joint.kind in _LOOSE:
                raise ConfigError(f'joint {joint.name!r} is {joint.kind}: only fixed, '
                                  f"{', '.join(_MOVES)} joints are supported; name the link "
                                  'beyond it with arm.base')
            if joint.name in names and joint.kind not in _MOVES:
                raise ConfigError(f'joint {joint.name!r} is {joint.kind} and cannot be one of '
                                  f'joints: they are {", ".join(_MOVES)}')
            if joint.kind in _MOVES and joint.name not in names and not joint.mimics:
                raise ConfigError(f'joint {joint.name!r} moves within the chain, but joints '
                                  'does not name it: name it, or make its type fixed')
        beside = [name for name in names if name not in on_path]
        if beside:
            raise ConfigError(
                f'{beside[0]!r} is not on the way to {path[-1].child if path else tip!r}, where '
                'the chain ends: it is a branch; name the joints of one serial chain, or its last '
                'link with arm.tip')
        order = [name for name in on_path if name in names]
        if order != list(names):
            raise ConfigError(f"'joints' must be in the order from the base outwards: "
                              f"[{', '.join(order)}]")
        if not tip:
            for joint in self.joints:
                if (joint.kind in _MOVES + _LOOSE and joint.name not in names
                        and not joint.mimics and self._hangs(joint, path)):
                    raise ConfigError(
                        f'joint {joint.name!r} is a branch or goes on beyond the chain, and '
                        'joints does not name it; to hold it at 0 set arm.tip: '
                        f'{path[-1].child}')

    def _hangs(self, joint, path):
        """Return whether a joint is moved by the chain."""
        link = joint.parent
        children = {one.child for one in path if one.kind in _MOVES}
        while link not in children and link in self._above:
            link = self._above[link].parent
        return link in children

    def _moved(self, joint, stop):
        """Return the Body of all links that a joint moves and none of the joints ``stop`` does."""
        bodies, bare = [], True
        waiting = [(joint.child, (np.eye(3), np.zeros(3)))]
        while waiting:
            name, frame = waiting.pop()
            body = self._body(name, massless=name != joint.child)
            if body is not None:
                bare = False
                bodies.append(moved(body, *frame))
            waiting += [(below.child, _then(frame, (below.rotation, below.position)))
                        for below in self.joints
                        if below.parent == name and below.name not in stop]
        if bare:
            raise ConfigError(f'link {joint.child!r}, which joint {joint.name!r} moves, has no '
                              '<inertial>: give it mass and inertia')
        return joined(bodies)

    def _farthest(self, link):
        """Return the farthest of the frames fixed to a link, in its own: rotation and place."""
        frames, waiting = [], [(link, (np.eye(3), np.zeros(3)))]
        while waiting:
            name, frame = waiting.pop()
            frames.append(frame)
            waiting += [(below.child, _then(frame, (below.rotation, below.position)))
                        for below in self.joints if below.parent == name and below.kind == 'fixed']
        return max(frames, key=lambda frame: np.linalg.norm(frame[1]))

    def _body(self, name, massless):
        """Return the Body of one link, None of a frame; one with a shape may be ``massless``."""
        link = self._links[name]
        inertial = link.find('inertial')
        if inertial is None:
            if not massless and any(link.find(shape) is not None for shape in _SHAPES):
                raise ConfigError(f'link {name!r} has a shape but no <inertial>: give it mass '
                                  'and inertia, or remove the shape of a mere frame')
            return None
        where = f'link {name!r}'
        rotation, place = _origin(inertial, where)
        mass = _numbers(inertial.find('mass'), 'value', 1, where, 'mass')[0]
        inertia = inertial.find('inertia')
        xx, xy, xz, yy, yz, zz = (_numbers(inertia, entry, 1, where, 'inertia')[0] for entry in (
            'ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'))
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if mass == 0.0 and not tensor.any():
            return None
        tensor = nearest_inertia(where, tensor, _POINT * mass)
        require_body(where, mass, tensor)
        if np.trace(tensor) > mass * _MOST_LENGTH ** 2:
            raise ConfigError(f'{where} has an inertia of {tensor.max():g} kg m^2 at {mass:g} kg, '
                              'as no link of an arm: it looks like kg mm^2; URDF wants kg m^2')
        return Body(mass, place, rotation @ tensor @ rotation.T)


def _named(element, what):
    name = element.get('name')
    if not name:
        raise ConfigError(f'has a {what} without a name')
    return name


def _joint(element):
    name, kind = _named(element, 'joint'), element.get('type', '')
    where = f'joint {name!r}'
    if kind not in (*_MOVES, *_LOOSE, 'fixed'):
        raise ConfigError(f'{where} has the type {kind!r}{did_you_mean(kind, _MOVES)}; URDF has '
                          f"fixed, {', '.join((*_MOVES, *_LOOSE))}")
    ends = []
    for end in ('parent', 'child'):
        found = element.find(end)
        if found is None or not found.get('link'):
            raise ConfigError(f'{where} has no <{end} link="...">')
        ends.append(found.get('link'))
    axis = np.array([1.0, 0.0, 0.0])
    if element.find('axis') is not None:
        axis = _numbers(element.find('axis'), 'xyz', 3, where, 'axis')
    if kind in _MOVES and not axis.any():
        raise ConfigError(f'{where} has the axis 0 0 0: give its direction')
    limit = element.find('limit')
    limits = {} if limit is None else {
        key: _numbers(limit, key, 1, where, 'limit')[0]
        for key in ('lower', 'upper', 'velocity', 'effort') if key in limit.attrib}
    return Joint(name, kind, *ends, *_origin(element, where),
                 axis / (np.linalg.norm(axis) or 1.0), limits, element.find('mimic') is not None)


def _limits(joint):
    """Return the limits of a joint (dict), infinite where absent."""
    found = {'lower': -math.inf, 'upper': math.inf, 'velocity': math.inf, 'effort': math.inf}
    ranged = joint.kind != 'continuous' and joint.limits.get('upper', 0.0) > joint.limits.get(
        'lower', 0.0)
    for name, value in joint.limits.items():
        if name in ('lower', 'upper') and not ranged or name == 'velocity' and value <= 0.0:
            continue
        if name == 'effort' and value <= 0.0:
            continue
        found[name] = value
    if joint.kind == 'revolute' and any(
            math.isfinite(found[name]) and abs(found[name]) > _MOST_ANGLE
            for name in ('lower', 'upper')):
        raise ConfigError(f'joint {joint.name!r} has limits from {found["lower"]:g} to '
                          f'{found["upper"]:g} rad: they look like degrees; URDF wants radians')
    return found


def _numbers(element, attribute, count, where, what):
    """Return the numbers (count,) of an attribute."""
    text = None if element is None else element.get(attribute)
    if text is None:
        raise ConfigError(f'{where} lacks {attribute} of <{what}>')
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if len(values) != count or not np.isfinite(values).all():
        wanted = 'a number' if count == 1 else f'{count} numbers'
        raise ConfigError(f'{where}: {attribute} of <{what}> must be {wanted}, got {text!r}')
    return values


def _origin(element, where):
    """Return rotation (3, 3) and place (3,) of an <origin>."""
    origin = element.find('origin')
    if origin is None:
        return np.eye(3), np.zeros(3)
    place, angles = (_numbers(origin, name, 3, where, 'origin') if name in origin.attrib
                     else np.zeros(3) for name in ('xyz', 'rpy'))
    if np.linalg.norm(place) > _MOST_LENGTH:
        raise ConfigError(f'{where} has an <origin> {np.linalg.norm(place):g} m away: it looks '
                          'like millimetres; URDF wants metres')
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    rotation = np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                         [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                         [-sp, cp * sr, cp * cr]])
    return rotation, place


def _then(first, second):
    """Return a frame given in a frame, each a rotation and a place."""
    return first[0] @ second[0], first[0] @ second[1] + first[1]


def _to_z(axis):
    """Return a rotation (3, 3) that turns z into ``axis`` (3,)."""
    if axis[2] < 0.0:
        return _to_z(-axis) @ np.diag([1.0, -1.0, -1.0])
    x, y, z = axis
    return np.array([[1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x],
                     [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), y], [-x, -y, z]])
