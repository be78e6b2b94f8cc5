# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Messages of one topic as columns over time, decoded block by block as they are read."""

from gms_flex_control.data.messages import (
    ArrayLayout,
    JointStateLayout,
    STAMP_LABEL,
    stamp_of,
    unpack_joint_state,
    unpack_multi_array,
    VALUES,
)
from gms_flex_control.errors import BagError
import numpy as np

_FAR = 2**62     # no stamp is later: differences of two stay below 2**63 [ns]
_DIGITS = 19     # more do not fit 64 bits
_LAYOUTS = 4     # of one length that are read at once in one block; the rest one by one


class Table:
    """
    Columns that grow by blocks of messages.

    The first message that cannot be read ends the growth; its error is raised when a column
    is asked for.
    """

    def __init__(self):
        self._count = self._rows = 0  # messages seen, rows kept of them
        self._error = None
        self._columns = self._decoded([]) | {'received': np.zeros(0, dtype=np.int64)}

    def add(self, received, messages):
        """
        Decode a block of messages.

        Parameters
        ----------
        received : sequence of int
            Receive times [ns].
        messages : sequence of bytes
            CDR messages.

        """
        if self._error is not None:
            return
        try:
            columns = self._decoded(messages)
        except BagError as error:
            self._error, self._columns = error, {}
            return
        times = np.minimum(np.array(received, dtype=np.uint64), _FAR).astype(np.int64)
        columns['received'] = times[columns['rows']]
        columns['rows'] += self._count
        stop = self._rows + len(columns['rows'])
        for name, column in columns.items():
            if stop > len(self._columns[name]):
                self._columns[name] = _longer(self._columns[name], 2 * stop)
            self._columns[name][self._rows:stop] = column
        self._rows = stop
        self._count += len(messages)

    def take(self, name):
        """
        Return a column and forget it.

        Parameters
        ----------
        name : str
            ``rows`` (number of the message), ``received`` or ``stamps`` [ns], or as the table
            has them.

        Returns
        -------
        ndarray, shape (T, ...)

        Raises
        ------
        BagError
            If a message could not be read; the sentence has no subject yet.

        """
        if self._error is not None:
            raise self._error
        return self._columns.pop(name)[:self._rows]

    def _decoded(self, messages):
        """Return the columns of a block, ``rows`` counted from its start."""
        raise NotImplementedError


def _longer(column, length):
    """Return a column with room for ``length`` rows; memory is taken as they are written."""
    longer = np.empty((length, *column.shape[1:]), dtype=column.dtype)
    longer[:len(column)] = column
    return longer


class JointTable(Table):
    """
    Joint states over time, columns by name.

    Parameters
    ----------
    wanted : sequence of str
        The joints; messages that name none of them are left out.
    fields : sequence of str, optional
        Which of position, velocity and effort to keep: columns of shape (T, len(wanted)), NaN
        where the message has none.

    """

    def __init__(self, wanted, fields=VALUES):
        self._wanted, self._fields = tuple(wanted), tuple(fields)
        self._places = {}
        super().__init__()

    def _decoded(self, messages):
        shape = (len(messages), len(self._wanted))
        block = {name: np.full(shape, np.nan) for name in self._fields}
        block['stamps'] = np.zeros(len(messages), dtype=np.int64)
        known = np.full(len(messages), False)
        k, run = 0, 16
        while k < len(messages):
            try:
                # doubling keeps alternating layouts from costing the square of their number
                after = self._read_alike(block, known, k, messages[k:k + run])
                k, run = after, 2 * run if after == k + run else 16
            except BagError as error:
                raise BagError(f'message {self._count + k} {error}') from None
        rows = np.flatnonzero(known)
        return {name: column[rows] for name, column in block.items()} | {'rows': rows}

    def _read_alike(self, block, known, k, messages):
        """Read message ``k`` and those behind it of its layout; return the next one."""
        first = messages[0]
        stamp, frame, names, *values = unpack_joint_state(first)
        counts = tuple(len(numbers) for numbers in values)
        _check_counts(names, counts)
        if names not in self._places:
            self._places[names] = _columns(names, self._wanted)
        columns = self._places[names]
        if columns is None:
            return k + 1
        layout, stop = JointStateLayout(names, counts, frame), 1
        if first[1] == 1 and len(first) >= layout.size:
            records = _joined(layout, messages)
            good = layout.fits(records)
            stop = len(good) if good.all() else max(int(np.argmin(good)), 1)
            records = records[:stop]
            stamp = records['sec'] * np.int64(10**9) + records['nanosec']
            values = [records[field] if count else ()
                      for field, count in zip(VALUES, counts, strict=True)]
        else:
            values = [np.array([numbers]) if numbers else () for numbers in values]
        known[k:k + stop] = True
        block['stamps'][k:k + stop] = stamp
        for field, numbers in zip(VALUES, values, strict=True):
            if len(numbers) and field in block:
                block[field][k:k + stop] = numbers[:, columns]
        return k + stop


def _joined(layout, messages):
    """Return the records of the leading messages that are as long as the first."""
    first, stop = messages[0], 1
    while stop < len(messages) and len(messages[stop]) == len(first) \
            and messages[stop][:4] == first[:4]:
        stop += 1
    return np.frombuffer(b''.join(messages[:stop]), layout.dtype(len(first)))


def _check_counts(names, counts):
    for field, count in zip(VALUES, counts, strict=True):
        if count != len(names) and (count or field == 'position'):
            raise BagError(f'has {count} {field} values for {len(names)} names')


def _columns(names, wanted):
    """Return where each wanted name stands, None if the message is about other joints."""
    missing = [name for name in wanted if name not in names]
    if len(missing) == len(wanted):
        return None
    if missing:
        raise BagError(f'lacks joint {missing[0]!r} (has {", ".join(names)})')
    return [names.index(name) for name in wanted]


class ArrayTable(Table):
    """
    Float64MultiArray messages over time.

    Its columns are ``stamps`` [ns] with ``stamped`` (bool, whether there is one), and
    ``values``, shape (T, then that of ``shape``), NaN where a message has fewer.

    Parameters
    ----------
    shape : tuple of int
        The largest shape of the values.
    shape_of : callable
        ``shape_of(dims, count)`` returns the shape the values of a message have, None to
        leave the message out, or raises BagError; stamps make no difference to it.

    """

    def __init__(self, shape, shape_of):
        self._shape, self._shape_of = tuple(shape), shape_of
        self._met = {}  # layouts by length, for unpack_multi_array
        super().__init__()

    def _decoded(self, messages):
        count = len(messages)
        block = {'values': np.full((count, *self._shape), np.nan),
                 'stamps': np.zeros(count, dtype=np.int64), 'stamped': np.full(count, False)}
        known = np.full(count, False)
        try:
            self._read_groups(block, known, messages)
        except BagError:
            for k, data in enumerate(messages):  # in order, to name the first
                try:
                    self._read_one(block, known, k, data)
                except BagError as error:
                    raise BagError(f'message {self._count + k} {error}') from None
        rows = np.flatnonzero(known)
        return {name: column[rows] for name, column in block.items()} | {'rows': rows}

    def _read_groups(self, block, known, messages):
        """Read the messages of one length together, as far as they are laid out alike."""
        groups = {}
        for k, data in enumerate(messages):
            groups.setdefault(len(data), []).append(k)
        for numbers in groups.values():
            for _ in range(_LAYOUTS):
                if not numbers:
                    break
                numbers = self._read_alike(block, known, numbers, messages)
            for k in numbers:
                self._read_one(block, known, k, messages[k])

    def _read_one(self, block, known, k, data):
        """Read message ``k``; return its layout and values."""
        dims, values = unpack_multi_array(data, self._met)
        shape = self._shape_of(dims, len(values))
        stamp = stamp_of(dims)
        if shape is not None:
            known[k] = True
            block['values'][(k, *map(slice, shape))] = np.reshape(values, shape)
            if stamp is not None:
                block['stamped'][k] = True
                block['stamps'][k] = min(max(stamp, -_FAR), _FAR)
        return dims, values

    def _read_alike(self, block, known, numbers, messages):
        """Read the first of ``numbers`` and all that are laid out like it; return the rest."""
        start, numbers = numbers[0], numbers[1:]
        first = messages[start]
        dims, values = self._read_one(block, known, start, first)
        place = _stamp_place(dims)
        layout = ArrayLayout(dims, len(values), first[:4], place)
        if not numbers or not len(values) or first[1] != 1 or len(first) < layout.size:
            return numbers
        records = np.frombuffer(b''.join([messages[k] for k in numbers]),
                                layout.dtype(len(first)))
        good = layout.fits(records)
        stamps = block['stamps'][start]
        if place is not None:
            stamps, plain = layout.stamps(records)
            good &= plain
            stamps = np.minimum(stamps, np.uint64(_FAR)).astype(np.int64)[good]
        taken = np.array(numbers)[good]
        if known[start]:
            shape = self._shape_of(dims, len(values))
            known[taken] = True
            block['values'][(taken, *map(slice, shape))] = \
                records['data'][good].reshape(-1, *shape)
            block['stamps'][taken], block['stamped'][taken] = stamps, block['stamped'][start]
        return np.array(numbers)[~good].tolist()


def _stamp_place(dims):
    """Return which dimension has a stamp of plain digits and where they begin, else None."""
    for k, (label, _, _) in enumerate(dims):
        if label.startswith(STAMP_LABEL):
            digits = label[len(STAMP_LABEL):]
            plain = digits.isascii() and digits.isdigit() and len(digits) <= _DIGITS
            return (k, len(STAMP_LABEL)) if plain else None
    return None
