# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Messages of one topic as columns over time, decoded block by block as they are read."""

from gms_flex_control.data import cdr
from gms_flex_control.errors import BagError
import numpy as np

_FAR = 2**62  # no stamp is later: differences of two stay below 2**63 [ns]
_LAYOUTS = 4  # of one length that are read at once in one block; the rest one by one


class Table:
    """Columns that grow by blocks of messages; the first unreadable one ends it, and its error."""

    def __init__(self):
        self._count = self._rows = 0  # messages seen, rows kept of them
        self._error = None
        self._columns = self._decoded([]) | {'received': np.zeros(0, dtype=np.int64)}

    def add(self, received, messages) -> None:
        """Decode a block of CDR messages (bytes) and their receive times [ns]."""
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
                longer = np.empty((2 * stop, *column.shape[1:]), dtype=column.dtype)
                longer[:self._rows] = self._columns[name][:self._rows]
                self._columns[name] = longer  # memory is taken as it is written
            self._columns[name][self._rows:stop] = column
        self._rows = stop
        self._count += len(messages)

    def take(self, name) -> np.ndarray:
        """Return a column (T, ...) and forget it; BagError if a message could not be read."""
        if self._error is not None:
            raise self._error
        return self._columns.pop(name)[:self._rows]

    def _decoded(self, messages):
        """Return the columns of a block, ``rows`` counted from its start."""
        block, known = self._empty(len(messages)), np.full(len(messages), False)
        groups = {}
        for k, data in enumerate(messages):
            groups.setdefault(len(data), []).append(k)
        try:
            for numbers in groups.values():
                self._read_group(block, known, numbers, messages)
        except BagError:
            for k, data in enumerate(messages):  # in order, to name the first
                try:
                    self._read(block, known, k, data)
                except BagError as error:
                    raise BagError(f'message {self._count + k} {error}') from None
        rows = np.flatnonzero(known)
        return {name: column[rows] for name, column in block.items()} | {'rows': rows}

    def _read_group(self, block, known, numbers, messages):
        """Read messages of one length: one alone, then all that are laid out like it."""
        for _ in range(_LAYOUTS):
            if not numbers:
                return
            start, numbers = numbers[0], numbers[1:]
            layout = self._read(block, known, start, messages[start])
            if layout is None or not numbers or layout.size > len(messages[start]):
                continue
            records = np.frombuffer(b''.join([messages[k] for k in numbers]),
                                    layout.dtype(len(messages[start])))
            fits, numbers = layout.fits(records), np.array(numbers)
            if known[start]:
                known[numbers[fits]] = True
                self._copy(block, start, numbers[fits], records[fits])
            numbers = numbers[~fits].tolist()
        for k in numbers:
            self._read(block, known, k, messages[k])

    def _empty(self, count):
        raise NotImplementedError

    def _read(self, block, known, k, data):
        """Read message ``k``; return the Layout of those alike, None where none can be."""
        raise NotImplementedError

    def _copy(self, block, start, numbers, records):
        """Copy records laid out like message ``start`` to their places ``numbers``."""
        raise NotImplementedError


class JointTable(Table):
    """
    Joint states over time, columns by name.

    Messages that name none of the ``wanted`` joints are left out. ``fields`` are those of
    position, velocity and effort to keep: columns of shape (T, len(wanted)), NaN where the message
    has none.
    """

    def __init__(self, wanted, fields=cdr.VALUES):
        self._wanted, self._fields = tuple(wanted), tuple(fields)
        self._places, self._columns_of = {}, None
        super().__init__()

    def _empty(self, count):
        return {name: np.full((count, len(self._wanted)), np.nan) for name in self._fields} | {
            'stamps': np.zeros(count, dtype=np.int64)}

    def _read(self, block, known, k, data):
        stamp, frame, names, *values = cdr.unpack_joint_state(data)
        counts = tuple(map(len, values))
        for field, count in zip(cdr.VALUES, counts, strict=True):
            if count != len(names) and (count or field == 'position'):
                raise BagError(f'has {count} {field} values for {len(names)} names')
        if names not in self._places:
            self._places[names] = _columns(names, self._wanted)
        self._columns_of = self._places[names]
        if self._columns_of is not None:
            known[k], block['stamps'][k] = True, stamp
            for field, numbers in zip(cdr.VALUES, values, strict=True):
                if numbers and field in block:
                    block[field][k] = np.array(numbers)[self._columns_of]
        return cdr.joint_state_layout(names, counts, frame, data[:4]) if data[1] == 1 else None

    def _copy(self, block, start, numbers, records):
        block['stamps'][numbers] = records['sec'] * np.int64(10**9) + records['nanosec']
        for field in self._fields:
            if field in records.dtype.names:
                block[field][numbers] = records[field][:, self._columns_of]


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

    Its columns are ``stamps`` [ns] with ``stamped`` (bool, whether there is one), and ``values``,
    shape (T, then that of ``shape``, the largest), NaN where a message has fewer. ``shape_of(dims,
    count)`` returns the shape the values of a message have, None to leave the message out, or
    raises BagError; stamps make no difference to it.
    """

    def __init__(self, shape, shape_of):
        self._shape, self._shape_of, self._last = tuple(shape), shape_of, None
        super().__init__()

    def _empty(self, count):
        return {'values': np.full((count, *self._shape), np.nan),
                'stamps': np.zeros(count, dtype=np.int64), 'stamped': np.full(count, False)}

    def _read(self, block, known, k, data):
        dims, values = cdr.unpack_multi_array(data)
        self._last = shape = self._shape_of(dims, len(values))
        stamp = cdr.stamp_of(dims)
        if shape is not None:
            known[k] = True
            block['values'][(k, *map(slice, shape))] = np.reshape(values, shape)
            if stamp is not None:
                block['stamped'][k] = True
                block['stamps'][k] = min(max(stamp, -_FAR), _FAR)
        return cdr.array_layout(dims, len(values), data[:4]) if len(values) and data[1] else None

    def _copy(self, block, start, numbers, records):
        block['values'][(numbers, *map(slice, self._last))] = \
            records['data'].reshape(-1, *self._last)
        block['stamped'][numbers] = block['stamped'][start]
        block['stamps'][numbers] = block['stamps'][start]
        if 'digits' in records.dtype.names:
            stamps = np.zeros(len(records), dtype=np.uint64)
            for digit in (records['digits'] - np.uint8(ord('0'))).T:
                stamps = stamps * np.uint64(10) + digit
            block['stamps'][numbers] = np.minimum(stamps, np.uint64(_FAR)).astype(np.int64)
