# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the page has to know of a robot to draw it."""

from dataclasses import asdict, dataclass, field

from gms_flex_control.params.units import in_units
import numpy as np

_SHOWN = 2000      # samples whose poses tell how much room the arm needs
_LENGTH = 0.3      # of links of which nothing is known [m]
_UNITS = ('rad', 'mrad', 'N m')


@dataclass(frozen=True, kw_only=True)
class Scene:
    """
    An arm as a picture.

    Parameters
    ----------
    joints : tuple of str
        Link names, from the base outwards.
    kind : {'planar', 'decoupled'}
        A chain, or axes beside each other.
    length, offset : tuple of float
        Of each link: length [m], and its angle where the joint reads 0 [rad].
    rigid : tuple of bool
        Joints without a motor side of their own.
    stiffness : tuple of float
        Of the springs [N m/rad]; 0 where unknown.
    limits : tuple of tuple of float
        Torque at which each block of each joint breaks away at rest [N m]; empty if unknown.
    known : bool
        Whether the lengths are the robot's own.
    units : dict of str to str
        What is shown for rad, mrad and N m: others of linear axes.

    """

    joints: tuple
    kind: str
    length: tuple
    offset: tuple
    rigid: tuple
    stiffness: tuple
    limits: tuple = ()
    known: bool = True
    units: dict = field(default_factory=lambda: {unit: unit for unit in _UNITS})

    @property
    def n_joints(self):
        """Return the number of joints."""
        return len(self.joints)

    def as_dict(self):
        """Return the fields for JSON."""
        return asdict(self)


def scene_of(robot):
    """
    Return the Scene of a RobotParams.

    A link whose ``length`` is 0 (the last of a chain may leave it out) is drawn twice as long as
    its centre of mass is far from the joint, else as long as the mean of the others. Joints of a
    chain in space are drawn one by one, as decoupled axes are.
    """
    arm, friction = robot.arm, robot.friction
    com = np.abs(arm.com) if arm.frames is None else np.linalg.norm(arm.com, axis=1)
    length = np.where(arm.length > 0.0, arm.length, 2.0 * com)
    length = np.where(length > 0.0, length, length[length > 0.0].mean() if np.any(length) else
                      _LENGTH)
    static = 0.5 * (friction.forward.static + friction.backward.static)
    return Scene(
        joints=tuple(robot.joints), kind='decoupled' if arm.frames else arm.kind,
        length=tuple(length.tolist()), offset=tuple(arm.offset.tolist()),
        rigid=tuple(arm.rigid.tolist()),
        stiffness=tuple(np.where(arm.rigid, 0.0, arm.stiffness).tolist()),
        limits=tuple(map(tuple, (friction.weight * static[:, None]).tolist())),
        units={unit: in_units(arm, unit) for unit in _UNITS})


def unknown_scene(joints, flexible):
    """
    Return a chain of links alike, for a robot of which only names are known.

    Parameters
    ----------
    joints : sequence of str
        Link names.
    flexible : sequence of bool
        Which of them have a motor side of their own.

    Returns
    -------
    Scene

    """
    n = len(joints)
    return Scene(joints=tuple(joints), kind='planar', length=(_LENGTH,) * n, offset=(0.0,) * n,
                 rigid=tuple(not bool(one) for one in flexible), stiffness=(0.0,) * n,
                 known=False)


def extent(scene, angles):
    """
    Return the room a chain needs while it moves.

    Parameters
    ----------
    scene : Scene
        Of n joints.
    angles : ndarray, shape (T, n)
        Link angles [rad]; NaN counts as 0.

    Returns
    -------
    tuple of float
        Left, bottom, right, top of the base and all ends of links [m].

    """
    step = max(1, len(angles) // _SHOWN)
    absolute = np.cumsum(np.nan_to_num(angles[::step]) + np.array(scene.offset), axis=1)
    corners = [np.zeros(2), np.zeros(2)]
    for wave, pick in ((np.cos, 0), (np.sin, 1)):
        ends = np.cumsum(np.array(scene.length) * wave(absolute), axis=1)
        corners[0][pick] = min(0.0, ends.min(initial=0.0))
        corners[1][pick] = max(0.0, ends.max(initial=0.0))
    return (*corners[0].tolist(), *corners[1].tolist())
