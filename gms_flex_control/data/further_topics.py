# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Read the phases of an identification experiment and the friction blocks of the observer."""

from gms_flex_control.data.bag import Bag, namespace_of
from gms_flex_control.data.messages import (
    JOINT_STATE,
    MULTI_ARRAY,
    PHASE_TOPIC,
    STAMP_LABEL,
    stamp_of,
    unpack_joint_state,
    unpack_multi_array,
)
from gms_flex_control.data.reader import Aside, read_beside
from gms_flex_control.data.recording import Phase, Topics
from gms_flex_control.data.series import by_stamp
from gms_flex_control.data.tables import ArrayTable
from gms_flex_control.errors import BagError
import numpy as np

_LABELS = ('phase', 'joint', 'step')
_HEAD = 12  # bytes of a JointState up to the end of its stamp


def read_phases(path, *, topic=None, joint_states=None):
    """
    Read the phases of an identification experiment.

    Parameters
    ----------
    path : str or Path
        Bag folder or file, as for read_recording.
    topic, joint_states : str, optional
        Topic names; by default those of our nodes, in the namespace they were recorded in.

    Returns
    -------
    tuple of Phase
        In the order of time; their time counts from the first sample of the recording, as
        ``Recording.time`` does. Empty where the bag has no such topic.

    Raises
    ------
    BagError
        If a message is no phase, or the bag cannot be read.

    """
    bag, found, first = Bag(path), [], None
    space = namespace_of(bag)
    topic, joint_states = topic or space + PHASE_TOPIC, joint_states or space + '/joint_states'
    for batch in bag.batches({topic, joint_states}):
        found += [data for name, _, _, data in batch if name == topic]
        states = [data for name, _, _, data in batch if name == joint_states != topic]
        if states:
            stamp = _first_stamp(path, joint_states, states)
            first = stamp if first is None else min(first, stamp)
    return _phases(path, Aside(topic, bag.type_of(topic), found), first or 0)


def read_experiment(path, joints=None, motors=None):
    """
    Read a recording and the phases of its experiment, the bag but once.

    Parameters
    ----------
    path, joints, motors
        As `reader.read_recording`.

    Returns
    -------
    recording : Recording
    phases : tuple of Phase
        As `read_phases`.

    Raises
    ------
    BagError
        As both.

    """
    recording, begin, aside = read_beside(path, joints, motors, aside=[PHASE_TOPIC])
    return recording, _phases(path, aside[PHASE_TOPIC], begin)


def _phases(path, aside, begin):
    """Return the Phases of messages, time since ``begin`` [ns]."""
    topic, type_name, messages = aside
    if messages and type_name != MULTI_ARRAY:
        raise BagError(f'{path}: topic {topic!r} is a {type_name}, expected {MULTI_ARRAY}')
    phases = [_phase(path, topic, k, data) for k, data in enumerate(messages)]
    return tuple(phase._replace(time_ns=phase.time_ns - begin)
                 for phase in sorted(phases, key=lambda phase: phase.time_ns))


def _phase(path, topic, number, data):
    """Return the Phase of one message, its time still a stamp."""
    try:
        dims, values = unpack_multi_array(data)
        stamp = stamp_of(dims)
    except BagError as error:
        raise BagError(f'{path}: topic {topic!r} message {number} {error}') from None
    texts = dict(label.split(':', 1) for label, _, _ in dims if ':' in label)
    missing = [f'{name}:' for name in _LABELS if name not in texts]
    missing += [STAMP_LABEL] if stamp is None else []
    if missing or len(values) != 1:
        raise BagError(f'{path}: topic {topic!r} message {number} has {len(values)} values and '
                       f'lacks the labels {missing}; a phase has one value and the labels '
                       f'{STAMP_LABEL}, phase:, joint: and step:')
    return Phase(stamp, *(texts[name] for name in _LABELS), float(values[0]))


def _first_stamp(path, topic, messages):
    """Return the smallest header stamp of some JointStates [ns]."""
    short = [len(data) for data in messages if len(data) < _HEAD]
    if short:
        raise BagError(f'{path}: topic {topic!r} has a message of {short[0]} bytes, which is '
                       f'no {JOINT_STATE}')
    heads = b''.join([data[:_HEAD] for data in messages])
    little = (np.frombuffer(heads, 'u1')[1::_HEAD] & 1).astype(bool)
    stamps = np.zeros(len(messages), dtype=np.int64)
    for order, which in (('<', little), ('>', ~little)):
        records = np.frombuffer(heads, [('', 'V4'), ('sec', f'{order}i4'),
                                        ('nanosec', f'{order}u4')])[which]
        stamps[which] = records['sec'] * np.int64(10**9) + records['nanosec']
    return int(stamps.min())


TORQUE_TOPIC, STICKING_TOPIC = '/cascade_controller/blocks', '/cascade_controller/sticking'
_WAITING = 4096  # messages of a topic that are decoded together


def read_blocks(path, time, n, *, topics=None, joint_states=None):
    """
    Read the friction blocks of the observer at the samples of a recording.

    Parameters
    ----------
    path : str or Path
        Bag folder or file, as for read_recording.
    time : ndarray, shape (T,)
        ``Recording.time`` of the same bag [s].
    n : int
        Number of joints.
    topics : tuple of str, optional
        Of the blocks' torques and of which stick; by default those of our controller, in the
        namespace they were recorded in.
    joint_states : str, optional
        The topic whose first stamp is time 0.

    Returns
    -------
    tuple of ndarray or None
        For each topic shape (T, n, N): torque [N m], and 1 for sticking, 0 for slipping; NaN at
        samples without a message, None for a topic that is not in the bag or has no stamps.

    Raises
    ------
    BagError
        If a message is no table of blocks for n joints, or the bag cannot be read.

    """
    bag, tables = Bag(path), {}
    space = namespace_of(bag)
    topics = topics or (space + TORQUE_TOPIC, space + STICKING_TOPIC)
    joint_states = joint_states or space + Topics().joint_states
    if bag.metadata and not set(topics) & set(bag.metadata.topics):
        return (None,) * len(topics)  # a long bag is not read once more for that
    waiting = {topic: ([], []) for topic in topics}
    for batch in bag.batches(topics):
        for name, log, _, data in batch:
            waiting[name][0].append(log)
            waiting[name][1].append(data)
        _decode_blocks(bag, tables, waiting, n, _WAITING)
    _decode_blocks(bag, tables, waiting, n, 1)
    if not tables:
        return (None,) * len(topics)
    stamps = _first_state(path, joint_states) + np.rint(np.asarray(time) * 1e9).astype(np.int64)
    return tuple(_at_samples(path, topic, tables.get(topic), stamps) for topic in topics)


def _first_state(path, topic):
    """Return the first stamp of the joint states, of which few at the start may be late [ns]."""
    for batch in Bag(path).batches({topic}):
        if batch:
            return min(unpack_joint_state(data)[0] for *_, data in batch)
    return 0


def _decode_blocks(bag, tables, waiting, n, least):
    for topic, (times, messages) in waiting.items():
        if len(messages) < least:
            continue
        if topic not in tables:
            if bag.topics[topic].type_name != MULTI_ARRAY:
                raise BagError(f'{bag.path}: topic {topic!r} is a '
                               f'{bag.topics[topic].type_name}, expected {MULTI_ARRAY}')
            tables[topic] = _block_table(bag.path, topic, messages[0], n)
        tables[topic].add(times, messages)
        times.clear()
        messages.clear()


def _block_table(path, topic, message, n):
    """Return the table of a topic, its number of blocks told from the first message."""
    try:
        count = len(unpack_multi_array(message)[1])
    except BagError as error:
        raise BagError(f'{path}: topic {topic!r} message 0 {error}') from None
    if not count or count % n:
        raise BagError(f'{path}: topic {topic!r} message 0 has {count} numbers, which are no '
                       f'blocks of {n} joints')
    shape = (n, count // n)

    def same(_dims, found):
        if found != count:
            raise BagError(f'has {found} numbers after messages of {count}')
        return shape

    return ArrayTable(shape, same)


def _at_samples(path, topic, table, stamps):
    if table is None:
        return None
    try:
        labels, stamped, values = (table.take(name) for name in ('stamps', 'stamped', 'values'))
    except BagError as error:
        raise BagError(f'{path}: topic {topic!r} {error}') from None
    if not stamped.any():
        return None
    flat = values[stamped].reshape(int(stamped.sum()), -1)
    return by_stamp(stamps, labels[stamped], flat).reshape(len(stamps), *values.shape[1:])
