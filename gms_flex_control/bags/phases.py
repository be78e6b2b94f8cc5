# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Write and read what an identification experiment was doing: the phase topic of its bag."""

from gms_flex_control.bags.cdr import (
    JOINT_STATE,
    MULTI_ARRAY,
    pack_multi_array,
    unpack_multi_array,
)
from gms_flex_control.bags.messages import STAMP_LABEL, stamp_of
from gms_flex_control.bags.names import namespace_of
from gms_flex_control.bags.reader import Aside, read_beside
from gms_flex_control.bags.source import Bag
from gms_flex_control.errors import BagError
from gms_flex_control.recording import Phase
import numpy as np

PHASE_TOPIC = '/identification/phase'
_LABELS = ('phase', 'joint', 'step')
_HEAD = 12  # bytes of a JointState up to the end of its stamp


def pack_phase(phase):
    """Return a Phase as CDR bytes, its ``time_ns`` as the stamp it holds from."""
    labels = (f'{STAMP_LABEL}{phase.time_ns}', f'phase:{phase.phase}', f'joint:{phase.joint}',
              f'step:{phase.step}')
    return pack_multi_array([(label, 1, 1) for label in labels], [float(phase.value)])


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
