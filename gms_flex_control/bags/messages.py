# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What the messages of the control loop mean: labels, layouts and tables over time."""

from gms_flex_control.bags.cdr import (
    JointStateLayout,
    pack_multi_array,
    unpack_joint_state,
    unpack_multi_array,
    VALUES,
)
from gms_flex_control.errors import BagError
import numpy as np

STAMP_LABEL = 'stamp:'
SOURCE_LABEL = 'source:'


def pack_command(torque, stamp=None, source=None):
    """
    Pack a torque command.

    Parameters
    ----------
    torque : sequence of float
        One per joint [N m].
    stamp : int, optional
        Stamp of the joint state it answers [ns].
    source : str, optional
        Who sends it.

    Returns
    -------
    bytes
        A Float64MultiArray; with neither stamp nor source it has no layout at all.

    """
    dims = [] if stamp is None and source is None else [('joint', len(torque), len(torque))]
    if stamp is not None:
        dims.append((f'{STAMP_LABEL}{stamp}', 1, 1))
    if source is not None:
        dims.append((f'{SOURCE_LABEL}{source}', 1, 1))
    return pack_multi_array(dims, torque)


def pack_reference(values, stamp, kind='derivative'):
    """Pack a reference, rows x joints (``kind`` names the rows), for the time ``stamp`` [ns]."""
    values = np.asarray(values, dtype=float)
    rows, joints = values.shape
    dims = [(kind, rows, rows * joints), ('joint', joints, joints),
            (f'{STAMP_LABEL}{stamp}', 1, 1)]
    return pack_multi_array(dims, values.ravel().tolist())


def pack_blocks(values, stamp=None):
    """Pack the block torques of the observer, joints x blocks [N m]."""
    values = np.asarray(values, dtype=float)
    joints, blocks = values.shape
    dims = [('joint', joints, joints * blocks), ('block', blocks, blocks)]
    if stamp is not None:
        dims.append((f'{STAMP_LABEL}{stamp}', 1, 1))
    return pack_multi_array(dims, values.ravel().tolist())


def stamp_of(dims):
    """Return the nanoseconds of the first 'stamp:' label in a layout, None if there is none."""
    for label, _, _ in dims:
        if label.startswith(STAMP_LABEL):
            text = label[len(STAMP_LABEL):]
            try:
                return int(text)
            except ValueError:
                raise BagError(f'has the label {label!r}, expected '
                               f'{STAMP_LABEL}<whole nanoseconds>') from None
    return None


class JointTable:
    """
    Joint states over time, columns by name.

    Parameters
    ----------
    messages : sequence of bytes
        CDR JointState messages.
    wanted : sequence of str
        The columns.

    Attributes
    ----------
    rows : ndarray of int, shape (T,)
        Which messages the rows came from; those that name none of ``wanted`` are left out.
    stamps : ndarray of int64, shape (T,)
        Header stamps [ns].
    position, velocity, effort : ndarray, shape (T, len(wanted))
        Values, NaN where the message has none.

    Raises
    ------
    BagError
        If a message cannot be read, a joint is missing or a length does not fit.

    """

    def __init__(self, messages, wanted):
        self._wanted = tuple(wanted)
        self._columns = {}
        shape = (len(messages), len(self._wanted))
        self._known = np.full(len(messages), False)
        self.stamps = np.zeros(len(messages), dtype=np.int64)
        self.position, self.velocity, self.effort = (np.full(shape, np.nan) for _ in range(3))
        k, run = 0, 16
        while k < len(messages):
            try:
                # doubling keeps alternating layouts from costing the square of their number
                after = self._read_alike(k, messages, k + run)
                k, run = after, 2 * run if after == k + run else 16
            except BagError as error:
                raise BagError(f'message {k} {error}') from None
        self.rows = np.flatnonzero(self._known)
        for name in ('stamps', *VALUES):
            setattr(self, name, getattr(self, name)[self.rows])

    def _read_alike(self, k, messages, limit):
        """Read message ``k`` and those of its layout up to ``limit``; return the next one."""
        first = messages[k]
        stamp, frame, names, *values = unpack_joint_state(first)
        counts = tuple(len(numbers) for numbers in values)
        for field, count in zip(VALUES, counts, strict=True):
            if count != len(names) and (count or field == 'position'):
                raise BagError(f'has {count} {field} values for {len(names)} names')
        if names not in self._columns:
            self._columns[names] = _columns(names, self._wanted)
        columns = self._columns[names]
        if columns is None:
            return k + 1
        layout = JointStateLayout(names, counts, frame)
        stop = k + 1
        while stop < min(limit, len(messages)) and len(messages[stop]) == len(first) \
                and messages[stop][:4] == first[:4]:
            stop += 1
        if first[1] == 1 and len(first) >= layout.size:
            records = np.frombuffer(b''.join(messages[k:stop]), layout.dtype(len(first)))
            good = layout.fits(records)
            stop = k + (len(good) if good.all() else max(int(np.argmin(good)), 1))
            records = records[:stop - k]
            self.stamps[k:stop] = records['sec'] * np.int64(10**9) + records['nanosec']
            values = [records[field] if count else ()
                      for field, count in zip(VALUES, counts, strict=True)]
        else:
            stop = k + 1
            self.stamps[k] = stamp
            values = [np.array([numbers]) if numbers else () for numbers in values]
        self._known[k:stop] = True
        for field, numbers in zip(VALUES, values, strict=True):
            if len(numbers):
                getattr(self, field)[k:stop] = numbers[:, columns]
        return stop


def _columns(names, wanted):
    """Return where each wanted name stands, None if the message is about other joints."""
    missing = [name for name in wanted if name not in names]
    if len(missing) == len(wanted):
        return None
    if missing:
        raise BagError(f'lacks joint {missing[0]!r} (has {", ".join(names)})')
    return [names.index(name) for name in wanted]


def read_arrays(messages, shape_of):
    """
    Read Float64MultiArray messages of one topic.

    Parameters
    ----------
    messages : sequence of bytes
        CDR messages.
    shape_of : callable
        ``shape_of(dims, count)`` returns the shape the values must have, None to leave the
        message out, or raises BagError.

    Returns
    -------
    tuple
        ``(rows, stamps, arrays)``: message numbers, stamps (None where unlabelled) and values.

    """
    rows, stamps, arrays, known = [], [], [], {}
    for k, data in enumerate(messages):
        try:
            dims, values = unpack_multi_array(data, known)
            shape = shape_of(dims, len(values))
            stamp = stamp_of(dims)
        except BagError as error:
            raise BagError(f'message {k} {error}') from None
        if shape is not None:
            rows.append(k)
            stamps.append(stamp)
            arrays.append(np.reshape(values, shape))
    return rows, stamps, arrays
