# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Read a bag as a recording: states, and what was asked and estimated at each of them."""

from typing import NamedTuple
import warnings

from gms_flex_control.bags.cdr import JOINT_STATE, MULTI_ARRAY, unpack_joint_state
from gms_flex_control.bags.messages import JointTable, read_arrays, SOURCE_LABEL, STAMP_LABEL
from gms_flex_control.bags.pairing import answering, by_stamp, N_DERIVATIVES, reference_at
from gms_flex_control.bags.source import Bag, BagWarning
from gms_flex_control.errors import BagError
from gms_flex_control.recording import Recording
import numpy as np

MOTOR_SUFFIX = '_motor'
_TWO_RUNS = 100_000_000  # a step back beyond this is another run, not a late message [ns]


class Topics(NamedTuple):
    """Where a recording is found in a bag."""

    joint_states: str = '/joint_states'
    command: str = '/effort_controller/commands'
    reference: str = '/reference'
    controller_state: str = '/cascade_controller/state'


def read_recording(path, joints=None, motors=None, *, topics=None):
    """
    Read one experiment from a bag of `ros2 bag record` or of this package.

    Parameters
    ----------
    path : str or Path
        Bag folder or file: mcap or sqlite3, plain or zstd, also one cut off.
    joints : sequence of str, optional
        Link names in the order of the command; by default those of the first joint state
        that are not the motor of another, in its order.
    motors : sequence of str, optional
        Motor name of each joint, '' where there is no motor side; by default
        ``<joint>_motor`` where the first joint state has it.
    topics : Topics, optional
        Topic names.

    Returns
    -------
    Recording
        Sampled at the joint states; the command of a state is the one that carries its stamp,
        the reference that of the same time.

    Raises
    ------
    BagError
        If the bag is damaged, or lacks the joint states, a joint or a length that fits.

    Warns
    -----
    BagWarning
        If the bag was cut off or otherwise odd, and what that means.

    """
    topics = topics or Topics()
    bag = Bag(path)
    times, data = _collect(bag, topics)
    if not bag.sound:
        first = next(item for item in bag.damage if item.lost != 0)
        raise BagError(f"{path}: {first}; run 'gms_flex repair {path}' to keep the rest")
    names = _first_names(bag, data[topics.joint_states], topics)
    bag.warn()
    joints, motors = _resolve(path, topics.joint_states, names, joints, motors)
    series = _Series(path, topics, times, data, joints)
    states, order = series.states((*joints, *(name for name in motors if name)))
    received = np.asarray(times[topics.joint_states])[states.rows][order]
    stamps = states.stamps[order]
    if not stamps.any():
        stamps = received
    n, samples = len(joints), len(stamps)
    if samples < 2:
        raise BagError(f'{path}: {topics.joint_states} has {samples} joint state of these '
                       'joints; a recording needs at least 2')
    period = float(np.median(np.diff(stamps)))
    links, sides = slice(0, n), _motor_columns(motors, n)
    effort = states.effort[order][:, [side if side is not None else k
                                      for k, side in enumerate(sides)]]
    return Recording(
        joints=tuple(joints), time=(stamps - stamps[0]) * 1e-9,
        q_link=states.position[order][:, links], dq_link=states.velocity[order][:, links],
        q_motor=_sides(states.position[order], sides),
        dq_motor=_sides(states.velocity[order], sides), tau_motor=effort,
        command=answering(stamps, received, period, series.commands(), n),
        reference=series.reference(stamps, received, period),
        friction_hat=series.friction(stamps), source=str(path))


def joint_names(path, *, topics=None):
    """
    Return the names in the first joint state of a bag.

    Parameters
    ----------
    path : str or Path
        As `read_recording`.
    topics : Topics, optional
        Topic names.

    Returns
    -------
    list of str

    Raises
    ------
    BagError
        If there is no joint state.

    """
    topics = topics or Topics()
    bag = Bag(path)
    for batch in bag.batches():
        for topic, _, _, message in batch:
            if topic == topics.joint_states:
                return _first_names(bag, [message], topics)
    return _first_names(bag, [], topics)


class _Series:
    """The messages of the topics of one recording."""

    def __init__(self, path, topics, times, data, joints):
        self._path, self._topics, self._joints = path, topics, joints
        self._times, self._data = times, data

    def _read(self, topic, function, argument):
        try:
            return function(self._data[topic], argument)
        except BagError as error:
            raise BagError(f'{self._path}: topic {topic!r} {error}') from None

    def states(self, wanted):
        """Return the table of joint states and the rows to take, stamps increasing."""
        topic = self._topics.joint_states
        table = self._read(topic, JointTable, wanted)
        stamps = table.stamps
        if not stamps.any():
            return table, np.arange(len(stamps))
        back = np.diff(stamps)
        if len(back) and back.min() < -_TWO_RUNS:
            k = int(np.argmin(back))
            raise BagError(
                f'{self._path}: topic {topic!r} goes back from {stamps[k] * 1e-9:.3f} s to '
                f'{stamps[k + 1] * 1e-9:.3f} s at message {table.rows[k + 1]}: two runs in one '
                'bag? Record each in its own')
        order = np.unique(stamps, return_index=True)[1]
        if len(order) < len(stamps):
            warnings.warn(f'{self._path}: topic {topic!r} repeats {len(stamps) - len(order)} '
                          'stamps; the first state of each is taken', BagWarning, stacklevel=4)
        return table, order

    def commands(self):
        """Return the commands as ``(labels, receive times, arrays)``."""
        n = len(self._joints)

        def shape_of(dims, count):
            if count != n:
                raise BagError(f'has {count} torques for {n} joints '
                               f'({", ".join(self._joints)})')
            return (n,)

        rows, labels, arrays = self._read(self._topics.command, read_arrays, shape_of)
        times = self._times[self._topics.command]
        return labels, [times[row] for row in rows], arrays

    def reference(self, stamps, received, period):
        """Return the reference at the states, shape (T, 5, n)."""
        n = len(self._joints)

        def shape_of(dims, count):
            return reference_shape(dims, count, n)

        rows, labels, arrays = self._read(self._topics.reference, read_arrays, shape_of)
        if None not in labels:
            return reference_at(stamps, period, labels, arrays, n)
        times = self._times[self._topics.reference]
        return reference_at(received, period, [times[row] for row in rows], arrays, n)

    def friction(self, stamps):
        """Return the friction estimate at the states, shape (T, n)."""
        table = self._read(self._topics.controller_state, JointTable, self._joints)
        return by_stamp(stamps, table.stamps, table.effort)


def reference_shape(dims, count, n):
    """
    Return the shape (rows, n) of a reference, None if it asks for torques instead of angles.

    Parameters
    ----------
    dims : sequence of (label, size, stride)
        The layout; without any, ``count`` tells the rows.
    count : int
        How many numbers the message has.
    n : int
        Number of joints.

    Raises
    ------
    BagError
        If the layout or the length does not fit; the sentence has no subject yet.

    """
    shape = [(label, size) for label, size, _ in dims
             if not label.startswith((STAMP_LABEL, SOURCE_LABEL))]
    if shape and shape[0][0] == 'effort':
        return None
    rows = shape[0][1] if shape else count // n
    columns = shape[1][1] if len(shape) > 1 else n
    if not 1 <= rows <= N_DERIVATIVES or columns != n or count != rows * n:
        layout = ' x '.join(f'{label} {size}' for label, size in shape) or 'no layout'
        raise BagError(f'has {count} numbers ({layout}), expected '
                       f'derivative {N_DERIVATIVES} x joint {n}')
    return rows, n


def _collect(bag, topics):
    """Return receive times and messages by topic of what ``topics`` names."""
    times, data = ({topic: [] for topic in topics} for _ in range(2))
    for batch in bag.batches():
        for topic, log, _, message in batch:
            if topic in data:
                times[topic].append(log)
                data[topic].append(message)
    for topic, type_name in zip(topics, (JOINT_STATE, MULTI_ARRAY, MULTI_ARRAY, JOINT_STATE),
                                strict=True):
        if topic in bag.topics and bag.topics[topic].type_name != type_name:
            raise BagError(f'{bag.path}: topic {topic!r} is a '
                           f'{bag.topics[topic].type_name}, expected {type_name}')
    return times, data


def _first_names(bag, messages, topics):
    if not messages:
        known = ', '.join(sorted(bag.topics)) or 'none'
        what = 'no message on' if topics.joint_states in bag.topics else 'no topic'
        raise BagError(f'{bag.path}: has {what} {topics.joint_states!r} (topics: {known}); '
                       'record it, or name the topic that has the joint states')
    try:
        return unpack_joint_state(messages[0])[2]
    except BagError as error:
        raise BagError(f'{bag.path}: topic {topics.joint_states!r} message 0 {error}') from None


def _resolve(path, topic, names, joints, motors):
    """Return the joint and motor names, by default told from the names of the first state."""
    if joints is None:
        joints = link_names(names) if motors is None else [
            name for name in names if name not in motors]
    if motors is None:
        motors = [name + MOTOR_SUFFIX if name + MOTOR_SUFFIX in names else ''
                  for name in joints]
    if len(motors) != len(joints):
        raise BagError(f'{path}: {len(motors)} motors for {len(joints)} joints '
                       f'({", ".join(joints)}); give one each, empty where there is none')
    for name in (*joints, *motors):
        if name and name not in names:
            raise BagError(f'{path}: topic {topic!r} lacks joint {name!r} '
                           f'(has {", ".join(names)}); set the names that are there or record '
                           'that side as well')
    return tuple(joints), tuple(motors)


def link_names(names):
    """Return the names that are not the motor of another, in order."""
    return [name for name in names
            if not (name.endswith(MOTOR_SUFFIX) and name[:-len(MOTOR_SUFFIX)] in names)]


def _motor_columns(motors, n):
    """Return the column of each joint's motor in the table, None where there is none."""
    columns, at = [], n
    for name in motors:
        columns.append(at if name else None)
        at += bool(name)
    return columns


def _sides(values, columns):
    result = np.full((len(values), len(columns)), np.nan)
    for k, column in enumerate(columns):
        if column is not None:
            result[:, k] = values[:, column]
    return result
