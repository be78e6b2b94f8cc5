# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the page draws: the robot as a scene, and the signals as columns, of a bag as live."""

from dataclasses import asdict, dataclass, field

from gms_flex_control.params.arm import in_units
import numpy as np
from scipy.spatial.transform import Rotation

PER_JOINT = ('link', 'motor', 'reference', 'error', 'torsion', 'command', 'friction')

_LENGTH = 0.3      # of links of which nothing is known [m]
_UNITS = ('rad', 'mrad', 'N m')


@dataclass(frozen=True, kw_only=True)
class Scene:
    """An arm as a picture, its joints from the base outwards."""

    joints: tuple       # link names
    kind: str           # 'planar' or 'space', a chain, or 'decoupled', axes beside each other
    length: tuple       # of each link [m]
    offset: tuple       # angle of each link where the joint reads 0 [rad]
    rigid: tuple        # whether the joint has no motor side of its own
    stiffness: tuple    # of the springs [N m/rad]; 0 where unknown
    limits: tuple = ()  # torque at which each block of each joint breaks away [N m]; () if unknown
    known: bool = True  # whether the lengths are the robot's own
    frames: dict | None = None  # in space: rotation, position, prismatic of each joint, and tip
    units: dict = field(default_factory=lambda: {unit: unit for unit in _UNITS})  # as shown

    @property
    def n_joints(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    def as_dict(self) -> dict:
        """Return the fields for JSON."""
        return asdict(self)


def scene_of(robot) -> Scene:
    """
    Return the Scene of a RobotParams.

    A link whose ``length`` is 0 (the last of a chain may leave it out) is drawn twice as long as
    its centre of mass is far from the joint, else as long as the mean of the others.
    """
    arm, friction, frames = robot.arm, robot.friction, None
    if arm.frames is None:
        length = np.where(arm.length > 0.0, arm.length, 2.0 * np.abs(arm.com))
    else:
        tip = 2.0 * arm.com[-1]
        length = np.linalg.norm([*arm.frames.position[1:], tip], axis=1)
        frames = {name: getattr(arm.frames, name).tolist()
                  for name in ('rotation', 'position', 'prismatic')} | {'tip': tip.tolist()}
    length = np.where(length > 0.0, length, length[length > 0.0].mean() if np.any(length) else
                      _LENGTH)
    static = 0.5 * (friction.forward.static + friction.backward.static)
    return Scene(
        joints=tuple(robot.joints), kind=arm.kind if frames is None else 'space', frames=frames,
        length=tuple(length.tolist()), offset=tuple(arm.offset.tolist()),
        rigid=tuple(arm.rigid.tolist()),
        stiffness=tuple(np.where(arm.rigid, 0.0, arm.stiffness).tolist()),
        limits=tuple(map(tuple, (friction.weight * static[:, None]).tolist())),
        units={unit: in_units(arm, unit) for unit in _UNITS})


def unknown_scene(joints, flexible) -> Scene:
    """Return a chain of links alike, for a robot of which only joint names are known."""
    n = len(joints)
    return Scene(joints=tuple(joints), kind='planar', length=(_LENGTH,) * n, offset=(0.0,) * n,
                 rigid=tuple(not bool(one) for one in flexible), stiffness=(0.0,) * n,
                 known=False)


def extent(scene, angles) -> tuple:
    """Return the least and largest coordinates, each (2 or 3,), of a chain at angles (T, n)."""
    step = max(1, len(angles) // 2000)
    points = places(scene, np.nan_to_num(angles[::step])).reshape(-1, 3)
    points = points[:, :3 if scene.frames else 2]
    return (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())


def places(scene, angles) -> np.ndarray:
    """Return base, joints and tip (T, n + 2, 3) of a chain [m] with joint angles (T, n)."""
    count, n = angles.shape
    moved, at = angles + np.array(scene.offset), np.zeros((count, 3))
    turned, found = np.tile(np.eye(3), (count, 1, 1)), [at]
    still = {'rotation': [np.eye(3)] * n, 'prismatic': [False] * n,
             'position': [[length, 0.0, 0.0] for length in (0.0, *scene.length[:-1])],
             'tip': [scene.length[-1], 0.0, 0.0]}
    frames = scene.frames or still
    for j in range(n):
        at = at + turned @ frames['position'][j]
        turned = turned @ np.array(frames['rotation'][j])
        if frames['prismatic'][j]:
            at = at + moved[:, j, None] * turned[:, :, 2]
        else:
            turned = turned @ Rotation.from_rotvec(
                moved[:, j, None] * [0.0, 0.0, 1.0]).as_matrix()
        found.append(at)
    return np.stack([*found, at + turned @ frames['tip']], axis=1)


def column_names(n, blocks) -> list:
    """
    Return the names of all columns for n joints and so many blocks of each, ``time`` first.

    ``<signal>.<joint>`` for each of PER_JOINT, then ``block.<joint>.<block>`` [N m] and
    ``stick.<joint>.<block>`` (1 sticks, 0 slips), counted from 0. Angles are in rad, ``error`` is
    link - reference, ``torsion`` motor - link.
    """
    names = ['time', *(f'{signal}.{j}' for signal in PER_JOINT for j in range(n))]
    return names + [f'{signal}.{j}.{i}' for signal in ('block', 'stick')
                    for j in range(n) for i in range(blocks)]


def columns_of(recording, torque=None, sticking=None) -> dict:
    """Return the columns (T,) of a Recording by name; torque and sticking (T, n, N) of blocks."""
    reference = recording.reference[:, 0]
    tables = {'link': recording.q_link, 'motor': recording.q_motor, 'reference': reference,
              'error': recording.q_link - reference,
              'torsion': recording.q_motor - recording.q_link,
              'command': recording.command, 'friction': recording.friction_hat}
    columns = {'time': np.asarray(recording.time)}
    columns |= {f'{signal}.{j}': tables[signal][:, j]
                for signal in PER_JOINT for j in range(recording.n_joints)}
    for signal, values in (('block', torque), ('stick', sticking)):
        if values is not None:
            columns |= {f'{signal}.{j}.{i}': values[:, j, i]
                        for j in range(values.shape[1]) for i in range(values.shape[2])}
    return columns


def beside(recording, time, number) -> dict:
    """
    Return the columns of another recording of the same joints, to be drawn over the first.

    ``<signal>.<joint>@<number>`` at the first one's time (T,), NaN where the recording has ended.
    """
    return {f'{name}@{number}': np.interp(time, recording.time, values, right=np.nan)
            for name, values in columns_of(recording).items() if name != 'time'}


def present(columns) -> dict:
    """Return for each of PER_JOINT, ``block`` and ``stick`` whether it has a number anywhere."""
    found = dict.fromkeys((*PER_JOINT, 'block', 'stick'), False)
    for name, values in columns.items():
        signal = name.partition('.')[0]
        if signal in found and not found[signal]:
            found[signal] = bool(np.isfinite(values).any())
    return found
