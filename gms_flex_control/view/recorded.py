# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What the page draws: the scene of a robot, and a bag as summary, frames and charts."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
import warnings

from gms_flex_control import friction as gms
from gms_flex_control.compiled import compiled
from gms_flex_control.data.bag import BagWarning
from gms_flex_control.data.reader import joint_names, read_recording
from gms_flex_control.data.recording import held
from gms_flex_control.errors import BagError
from gms_flex_control.params.arm import in_units
from gms_flex_control.reports.page import decimate
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
            turned = turned @ Rotation.from_rotvec(moved[:, j, None] * [0.0, 0.0, 1.0]).as_matrix()
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
    known = {name.partition('.')[0] for name, values in columns.items()
             if np.isfinite(values).any()}
    return {signal: signal in known for signal in (*PER_JOINT, 'block', 'stick')}


CHUNK = 1024         # samples of one answer with frames, about
LEVELS = 24          # of skipping every second sample once more
_MOST_POINTS = 8000  # of one line in an answer


def open_bag(path, robot=None, *, default=None, joints=None, motors=None, others=()) -> 'BagView':
    """
    Read a bag for viewing; BagError if it cannot be read or has other joints than ``robot``.

    ``default`` (RobotParams) stands in for the robot if its joints have the names of the bag's;
    the page says so. ``joints`` and ``motors`` as of `read_recording`; ``others`` are further bags
    with the same joints, drawn over the first.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always', BagWarning)
        if joints is None and robot is not None:
            there = joint_names(path)
            joints = robot.joints
            motors = motors or [name if name in there else '' for name in robot.motors]
        recording = read_recording(path, joints, motors)
        over = [read_recording(other, recording.joints, motors) for other in others]
    notes = [str(item.message) for item in caught if issubclass(item.category, BagWarning)]
    if robot is not None and robot.n_joints != recording.n_joints:
        raise BagError(f'{path}: has {recording.n_joints} joints '
                       f'({", ".join(recording.joints)}), the robot file '
                       f'{robot.n_joints}; name the robot of this bag')
    if robot is None and default is not None and tuple(default.joints) == recording.joints:
        robot = default
        notes.append('drawn as the arm of config/robot.yaml, whose joints have the same names; '
                     '--robot FILE names another')
    torque, sticking = (None, None) if robot is None else blocks_along(recording, robot.friction)
    flexible = np.isfinite(recording.q_motor).any(axis=0)
    scene = unknown_scene(recording.joints, flexible) if robot is None else scene_of(robot)
    if not scene.known:
        notes.append('lengths and friction are not known: links drawn alike; --robot FILE '
                     'names the robot file')
    title, *pale = (Path(bag).resolve().name for bag in (path, *others))
    return BagView(recording, scene, torque, sticking, notes=notes,
                   title=f'{title}, pale: {", ".join(pale)}' if pale else title, over=over)


class BagView:
    """
    One recording as the page requests it; torque and sticking (T, n, N) of the model's blocks.

    ``over`` are other recordings.
    """

    live = False

    def __init__(self, recording, scene, torque=None, sticking=None, *, notes=(), title='',
                 over=()):
        self._columns = columns_of(recording, torque, sticking)
        self._time = self._columns['time']
        self._period = recording.period
        self._scene, self._notes, self._title = scene, list(notes), title
        blocks = 0 if sticking is None else sticking.shape[2]
        self._over = len(over)
        for number, other in enumerate(over, start=1):
            self._columns |= beside(other, self._time, number)
        self._summary = {
            'signals': present(self._columns),
            'blocks': {'count': blocks, 'origin': 'model' if blocks else ''},
            'torsion': self._largest('torsion'), 'load': self._largest('block'),
            'extent': extent(scene, recording.q_link)}

    def _largest(self, signal):
        """Return the largest size of a signal in any of its columns, 0 without one."""
        return max((float(np.nanmax(np.abs(values))) for name, values in self._columns.items()
                    if name.startswith(signal) and np.isfinite(values).any()), default=0.0)

    def session(self) -> dict:
        """Return what the page has to know before it draws, as a dict for JSON."""
        return {'mode': 'bag', 'title': self._title, 'notes': self._notes,
                'scene': self._scene.as_dict(), 'columns': list(self._columns), 'begin': 0.0,
                'end': float(self._time[-1]), 'period': self._period, 'chunk': CHUNK,
                'controller': '', 'over': self._over, **self._summary}

    def frames(self, level, chunk) -> np.ndarray:
        """Return every 2**level-th sample of a piece of as many CHUNKs, (columns, rows)."""
        stride = 2 ** min(max(level, 0), LEVELS)
        span = CHUNK * stride * self._period
        first, last = np.searchsorted(self._time, [chunk * span, (chunk + 1) * span])
        while (last - first) // stride > 4 * CHUNK:  # stamps in bursts
            stride *= 2
        rows = slice(-(-int(first) // stride) * stride, int(last), stride)
        return self._table(rows)

    def plots(self, begin, end, points) -> np.ndarray:
        """
        Return what a chart of so many points can show from begin to end [s] (columns, rows).

        The samples if they are few; else per bucket the smallest and the largest value in the
        order they occur, and of ``stick`` the mean twice.
        """
        first = max(0, int(np.searchsorted(self._time, begin)) - 1)
        last = min(len(self._time), int(np.searchsorted(self._time, end, side='right')) + 1)
        points = 2 * (min(max(int(points), 2), _MOST_POINTS) // 2)
        if last - first <= points:
            return self._table(slice(first, last))
        time = self._time[first:last]
        edges = np.linspace(0, len(time), points // 2 + 1).astype(int)[:-1]
        shown = {name: values[first:last] for name, values in self._columns.items()}
        extremes = [name for name in shown if name != 'time' and not name.startswith('stick')]
        grid, values = decimate(time, [shown[name] for name in extremes], points)
        lines = {'time': grid, **dict(zip(extremes, values, strict=True))}
        return np.stack([lines[name] if name in lines else np.repeat(_means(one, edges), 2)
                         for name, one in shown.items()])

    def _table(self, rows):
        return np.stack([values[rows] for values in self._columns.values()]).astype(float)


def _means(values, edges):
    """Return the mean of what is known in each bucket, NaN where nothing is."""
    known = np.isfinite(values)
    count = np.add.reduceat(known.astype(float), edges)
    total = np.add.reduceat(np.where(known, values, 0.0), edges, dtype=float)
    return np.divide(total, count, out=np.full(len(edges), np.nan), where=count > 0)


@compiled
def _along(angle, rate, step, constants, state, displacement, torque, sticking):
    for k in range(angle.shape[0]):
        if k > 0:
            for j in range(angle.shape[1]):
                displacement[j] = angle[k, j] - angle[k - 1, j]
            gms.advance(state, displacement, rate[k], step[k], constants)
        torque[k] = state.torque
        sticking[k] = state.sticking


def blocks_along(recording, friction) -> tuple:
    """
    Return torque [N m] and sticking (1 or 0) of a model's blocks along a recording, (T, n, N).

    Eqs. (2) and (3), beginning unloaded; a missing rate is differenced, a missing angle held. It
    is the model's answer: blocks cannot be measured.
    """
    begin = np.isfinite(recording.q_link).argmax(axis=0)[None, :]  # the first known angle
    before = np.take_along_axis(recording.q_link, begin, axis=0)
    angle = held(np.concatenate([before, recording.q_link]))[1:]
    step = np.diff(recording.time, prepend=recording.time[0] - recording.period)
    rate = np.array(recording.dq_link)
    missing = ~np.isfinite(rate)
    rate[missing] = (np.diff(angle, axis=0, prepend=angle[:1]) / step[:, None])[missing]
    shape = (len(angle), *friction.stiffness.shape)
    torque, sticking = np.empty(shape, np.float32), np.empty(shape, np.float32)
    _along(np.ascontiguousarray(angle), np.ascontiguousarray(rate), step,
           gms.constants_of(friction), gms.init(friction), np.zeros(angle.shape[1]), torque,
           sticking)
    return torque, sticking
