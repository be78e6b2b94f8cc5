# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Read a bag as a recording, with the phases of its experiment and the observer's blocks."""

from collections.abc import Sequence
from typing import NamedTuple

from gms_flex_control.data import cdr
from gms_flex_control.data.bag import Bag, namespace_of
from gms_flex_control.data.recording import Phase, Recording, Topics
from gms_flex_control.data.series import BLOCK, by_stamp, names_of, Series
from gms_flex_control.data.tables import ArrayTable
from gms_flex_control.errors import BagError
import numpy as np

_LABELS = ('phase', 'joint', 'step')
_TORQUE, _STICKING = '/cascade_controller/blocks', '/cascade_controller/sticking'


class Aside(NamedTuple):
    """The messages of a topic as they are."""

    topic: str       # its name in the bag
    type_name: str   # its type, '' where the bag has no such topic
    messages: list   # of bytes


def read_recording(path, joints: Sequence[str] | None = None, motors: Sequence[str] | None = None,
                   *, topics: Topics | None = None) -> Recording:
    """
    Read one experiment from a bag of `ros2 bag record` or of this package.

    Parameters
    ----------
    path : str or Path
        Bag folder or file: mcap or sqlite3, plain or zstd, also one cut off.
    joints : sequence of str, optional
        Link names in the order of the command; by default those of the first joint state that are
        not the motor of another, in its order.
    motors : sequence of str, optional
        Motor name of each joint, '' where there is no motor side; by default ``<joint>_motor``
        where the first joint state has it. A link whose motor alone is in the states has no angles
        (NaN).
    topics : Topics, optional
        Topic names; by default those of our nodes, in the namespace they were recorded in.

    Returns
    -------
    Recording
        Sampled at the joint states; the command of a state is the one that carries its stamp, the
        reference that of the same time. BagError if the bag lacks the joint states, a joint or a
        length that fits; BagWarning if it was cut off, is damaged or otherwise odd.

    """
    return read_beside(path, joints, motors, topics=topics)[0]


def read_beside(path, joints=None, motors=None, *, topics=None, aside=()) -> tuple:
    """
    Read one experiment, and the messages of further topics as they are.

    As `read_recording`; ``aside`` names topics of any type, in the namespace of the others. Return
    the Recording, its first stamp [ns], and an Aside for each of these names (dict).
    """
    bag = Bag(path)
    space = namespace_of(bag)
    topics = topics or Topics().within(space)
    further = {space + name: [] for name in aside}
    series = Series(bag, topics, joints, motors)
    series.collect(further)
    series.require_names()
    bag.warn()
    joints, motors = series.resolved()
    series.note_others(joints, motors)
    begin, columns = _columns(path, series, motors)
    return (Recording(joints=joints, source=str(path), **columns), begin,
            {name: Aside(space + name, bag.topics.get(space + name, ''), further[space + name])
             for name in aside})


def joint_names(path) -> tuple:
    """Return the names in the first joint state of a bag; BagError if there is none."""
    bag = Bag(path)
    topics = Topics().within(namespace_of(bag))
    for batch in bag.batches({topics.joint_states}):
        for *_, message in batch:
            return names_of(bag, message, topics)
    return names_of(bag, None, topics)


def _columns(path, series, motors):
    """Return the first stamp [ns], and the arrays of the Recording by name."""
    stamps, received, order = series.clock()
    if len(stamps) < 2:
        raise BagError(f'{path}: {series.topics.joint_states} has {len(stamps)} joint state of '
                       'these joints; a recording needs at least 2')
    period = float(np.median(np.diff(stamps)))
    columns = {'time': (stamps - stamps[0]) * 1e-9}
    columns['q_link'], columns['q_motor'] = series.states('position', order)
    columns['dq_link'], columns['dq_motor'] = series.states('velocity', order)
    columns['tau_motor'] = np.where([not name for name in motors],
                                    *series.states('effort', order))
    columns['command'] = series.commands(stamps, received, period)
    columns['reference'] = series.reference(stamps, received, period)
    columns['friction_hat'] = series.friction(stamps)
    columns['supply'] = series.supply(stamps, received)
    return int(stamps[0]), columns


def read_experiment(path, joints=None, motors=None) -> tuple:
    """Read the Recording and Phases of an experiment, the bag but once."""
    recording, begin, aside = read_beside(path, joints, motors, aside=[cdr.PHASE_TOPIC])
    return recording, _phases(path, aside[cdr.PHASE_TOPIC], begin)


def _phases(path, aside, begin):
    topic, type_name, messages = aside
    if messages and type_name != cdr.MULTI_ARRAY:
        raise BagError(f'{path}: topic {topic!r} is a {type_name}, expected {cdr.MULTI_ARRAY}')
    phases = [_phase(path, topic, k, data) for k, data in enumerate(messages)]
    return tuple(phase._replace(time_ns=phase.time_ns - begin)
                 for phase in sorted(phases, key=lambda phase: phase.time_ns))


def _phase(path, topic, number, data):
    """Return the Phase of one message, its time still a stamp."""
    try:
        dims, values = cdr.unpack_multi_array(data)
        stamp = cdr.stamp_of(dims)
    except BagError as error:
        raise BagError(f'{path}: topic {topic!r} message {number} {error}') from None
    texts = dict(label.split(':', 1) for label, _, _ in dims if ':' in label)
    missing = [f'{name}:' for name in _LABELS if name not in texts]
    missing += [cdr.STAMP_LABEL] if stamp is None else []
    wrong = [f'{len(values)} values'] * (len(values) != 1)
    wrong += [f'no label {" or ".join(missing)}'] * bool(missing)
    if wrong:
        raise BagError(f'{path}: topic {topic!r} message {number} has {" and ".join(wrong)}; '
                       f'a phase has one value and the labels {cdr.STAMP_LABEL}, phase:, joint: '
                       'and step:')
    return Phase(stamp, *(texts[name] for name in _LABELS), float(values[0]))


def read_blocks(path, time, begin, n) -> tuple:
    """
    Read the friction blocks of the observer at the samples of a recording.

    ``time`` (T,) [s] is that of the Recording of the same bag, of ``n`` joints, and ``begin`` its
    first stamp [ns], see `read_beside`. Return torque [N m], and 1 for sticking, 0 for slipping,
    each (T, n, N): NaN at samples without a message, None for a topic that is not in the bag or
    has no stamps. BagError if the bag cannot be read or a message is no table of blocks for these
    joints.
    """
    bag, tables = Bag(path), {}
    space = namespace_of(bag)
    topics = space + _TORQUE, space + _STICKING
    if bag.metadata and not set(topics) & set(bag.metadata.topics):
        return None, None  # a long bag is not read once more for that
    waiting = {topic: ([], []) for topic in topics}
    for batch in bag.batches(topics):
        for name, log, _, data in batch:
            waiting[name][0].append(log)
            waiting[name][1].append(data)
        _decode_blocks(bag, tables, waiting, n, BLOCK)
    _decode_blocks(bag, tables, waiting, n, 1)
    if not tables:
        return None, None
    stamps = begin + np.rint(np.asarray(time) * 1e9).astype(np.int64)
    return tuple(_at_samples(path, topic, tables.get(topic), stamps) for topic in topics)


def _decode_blocks(bag, tables, waiting, n, least):
    for topic, (times, messages) in waiting.items():
        if len(messages) < least:
            continue
        if topic not in tables:
            if bag.topics[topic] != cdr.MULTI_ARRAY:
                raise BagError(f'{bag.path}: topic {topic!r} is a '
                               f'{bag.topics[topic]}, expected {cdr.MULTI_ARRAY}')
            tables[topic] = _block_table(bag.path, topic, messages[0], n)
        tables[topic].add(times, messages)
        times.clear()
        messages.clear()


def _block_table(path, topic, message, n):
    """Return the table of a topic, its number of blocks that of the first message."""
    try:
        count = len(cdr.unpack_multi_array(message)[1])
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
