# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Read what the observer's friction blocks carried, and which of them stuck."""

from gms_flex_control.bags.cdr import MULTI_ARRAY, unpack_joint_state, unpack_multi_array
from gms_flex_control.bags.names import namespace_of, Topics
from gms_flex_control.bags.pairing import by_stamp
from gms_flex_control.bags.source import Bag
from gms_flex_control.bags.tables import ArrayTable
from gms_flex_control.errors import BagError
import numpy as np

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
        _decode(bag, tables, waiting, n, _WAITING)
    _decode(bag, tables, waiting, n, 1)
    if not tables:
        return (None,) * len(topics)
    stamps = _first(path, joint_states) + np.rint(np.asarray(time) * 1e9).astype(np.int64)
    return tuple(_at(path, topic, tables.get(topic), stamps) for topic in topics)


def _first(path, topic):
    """Return the first stamp of the joint states, of which few at the start may be late [ns]."""
    for batch in Bag(path).batches({topic}):
        if batch:
            return min(unpack_joint_state(data)[0] for *_, data in batch)
    return 0


def _decode(bag, tables, waiting, n, least):
    for topic, (times, messages) in waiting.items():
        if len(messages) < least:
            continue
        if topic not in tables:
            if bag.topics[topic].type_name != MULTI_ARRAY:
                raise BagError(f'{bag.path}: topic {topic!r} is a '
                               f'{bag.topics[topic].type_name}, expected {MULTI_ARRAY}')
            tables[topic] = _table(bag.path, topic, messages[0], n)
        tables[topic].add(times, messages)
        times.clear()
        messages.clear()


def _table(path, topic, message, n):
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


def _at(path, topic, table, stamps):
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
