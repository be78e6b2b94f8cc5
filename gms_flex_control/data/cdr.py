# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The messages of the control loop: labels, layouts, and CDR bytes packed by hand for speed."""

from functools import lru_cache
import struct

from gms_flex_control.errors import BagError
import numpy as np

JOINT_STATE = 'sensor_msgs/msg/JointState'
MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
PHASE_TOPIC = '/identification/phase'
STAMP_LABEL = 'stamp:'
SOURCE_LABEL = 'source:'
LITTLE_ENDIAN = b'\x00\x01\x00\x00'
VALUES = ('position', 'velocity', 'effort')

_SECOND = 1_000_000_000  # [ns]
_DIGITS = 19             # more do not fit 64 bits


class MessageLayout:
    """The bytes of every message that has the same texts and lengths, as one numpy record."""

    def __init__(self, head=LITTLE_ENDIAN):
        self._fields, self._constants, self.size = [], {}, 0
        self.place('head', '<u4', np.frombuffer(head, '<u4')[0])

    def place(self, name, kind, constant=None) -> None:
        """Put a field of a numpy type behind the others, aligned as in CDR."""
        dtype = np.dtype(kind)
        align = 1 if dtype.kind == 'S' else dtype.base.itemsize
        self.size += -(self.size - len(LITTLE_ENDIAN)) % align
        self._fields.append((name, kind, self.size))
        if constant is not None:
            self._constants[name] = np.array(constant, dtype=dtype)
        self.size += dtype.itemsize

    def place_text(self, name, text) -> None:
        """Put a string behind the other fields."""
        raw = text.encode() + b'\0'
        self.place(f'{name}_size', '<u4', len(raw))
        self.place(name, f'S{len(raw)}', raw)

    def dtype(self, size=None) -> np.dtype:
        """Return the record type, ``size`` bytes long where a writer pads the end."""
        names, formats, offsets = zip(*self._fields, strict=True)
        return np.dtype({'names': names, 'formats': formats, 'offsets': offsets,
                         'itemsize': size or self.size})

    def template(self) -> bytes:
        """Return one message with zeros for all that is not the same in each (bytes)."""
        record = np.zeros(1, self.dtype())
        for name, value in self._constants.items():
            record[name] = value
        return record.tobytes()

    def fits(self, records) -> np.ndarray:
        """Return which of ``records`` (T,) are laid out like this, bool (T,)."""
        good = np.full(len(records), True)
        for name, value in self._constants.items():
            good &= records[name] == value
        if 'digits' in records.dtype.names:
            good &= (records['digits'] - np.uint8(ord('0')) <= 9).all(axis=1)
        return good


def joint_state_layout(names, counts, frame='', head=LITTLE_ENDIAN) -> MessageLayout:
    """Return the MessageLayout of JointStates with these names and lengths of VALUES."""
    layout = MessageLayout(head)
    layout.place('sec', '<i4')
    layout.place('nanosec', '<u4')
    layout.place_text('frame', frame)
    layout.place('names', '<u4', len(names))
    for k, name in enumerate(names):
        layout.place_text(f'name{k}', name)
    for name, count in zip(VALUES, counts, strict=True):
        layout.place(f'{name}_count', '<u4', count)
        if count:
            layout.place(name, f'({count},)<f8')
    return layout


def array_layout(dims, count, head=LITTLE_ENDIAN) -> MessageLayout:
    """Return the MessageLayout of Float64MultiArrays alike but for values and the stamp."""
    layout = MessageLayout(head)
    layout.place('dims', '<u4', len(dims))
    stamped = False
    for k, (label, size, stride) in enumerate(dims):
        digits = label[len(STAMP_LABEL):]
        if (not stamped and label.startswith(STAMP_LABEL) and digits.isascii()
                and digits.isdigit() and len(digits) <= _DIGITS):
            layout.place('stamp_size', '<u4', len(label) + 1)
            layout.place('stamp_prefix', f'S{len(STAMP_LABEL)}', STAMP_LABEL.encode())
            layout.place('digits', f'({len(digits)},)u1')
            layout.place('stamp_end', 'u1', 0)
        else:
            layout.place_text(f'label{k}', label)
        stamped = stamped or label.startswith(STAMP_LABEL)
        layout.place(f'size{k}', '<u4', size)
        layout.place(f'stride{k}', '<u4', stride)
    layout.place('offset', '<u4', 0)
    layout.place('count', '<u4', count)
    if count:
        layout.place('data', f'({count},)<f8')
    return layout


@lru_cache(maxsize=64)
def _joint_state_template(names, counts):
    layout = joint_state_layout(names, counts)
    return layout.dtype(), layout.template()


def pack_joint_states(names, stamps, position, velocity=None, effort=None) -> list[bytes]:
    """Pack many JointState messages that share their names (m,), little endian, padding zero."""
    stamps = np.asarray(stamps, dtype=np.int64)
    columns = {name: np.asarray(values, dtype=float) for name, values in zip(
        VALUES, (position, velocity, effort), strict=True) if values is not None}
    counts = tuple(len(names) if name in columns else 0 for name in VALUES)
    dtype, template = _joint_state_template(tuple(names), counts)
    buffer = bytearray(template * len(stamps))
    records = np.frombuffer(buffer, dtype)
    records['sec'], records['nanosec'] = stamps // _SECOND, stamps % _SECOND
    for name, values in columns.items():
        if values.shape[1]:
            records[name] = values
    size, raw = dtype.itemsize, bytes(buffer)
    return [raw[k:k + size] for k in range(0, len(raw), size)]


@lru_cache(maxsize=512)
def _multi_array_struct(label_sizes, count):
    form, at = ['<4sI'], 4
    for size in label_sizes:
        form.append(f'I{size}s{-(at + size) % 4}xII')
        at += 4 + size
        at += -at % 4 + 8
    form.append('II')
    at += 8
    if count:
        form.append(f'{-at % 8}x{count}d')
    return struct.Struct(''.join(form))


def pack_multi_array(dims, data) -> bytes:
    """Pack a Float64MultiArray of ``dims`` (label, size, stride) and ``data``, best a list."""
    fields, sizes = [], []
    for label, size, stride in dims:
        text = label.encode() + b'\0'
        sizes.append(len(text))
        fields += (len(text), text, size, stride)
    return _multi_array_struct(tuple(sizes), len(data)).pack(
        LITTLE_ENDIAN, len(sizes), *fields, 0, len(data), *data)


def pack_command(torque, stamp=None, source=None) -> bytes:
    """Pack a torque (n,) [N m], with the stamp of the state it answers [ns] and who sends it."""
    dims = [] if stamp is None and source is None else [('joint', len(torque), len(torque))]
    return pack_multi_array(dims + _labels(stamp) + (
        [] if source is None else [(f'{SOURCE_LABEL}{source}', 1, 1)]), torque)


def pack_reference(values, stamp, kind='derivative') -> bytes:
    """Pack a reference, rows x joints (``kind`` names the rows), for the time ``stamp`` [ns]."""
    values = np.asarray(values, dtype=float)
    rows, joints = values.shape
    return pack_multi_array([(kind, rows, rows * joints), ('joint', joints, joints),
                             *_labels(stamp)], values.ravel().tolist())


def pack_supply(voltage, stamp) -> bytes:
    """Pack the voltage of the drives' supply [V] at the time ``stamp`` [ns]."""
    return pack_multi_array([('supply', 1, 1), *_labels(stamp)], [float(voltage)])


def pack_phase(phase) -> bytes:
    """Return a Phase as CDR bytes, its ``time_ns`` as the stamp it holds from."""
    return pack_multi_array([(label, 1, 1) for label in phase_labels(phase)], [float(phase.value)])


def phase_labels(phase) -> tuple:
    """Return what the layout of a message says of a Phase; its value is the number in it."""
    return (f'{STAMP_LABEL}{phase.time_ns}', f'phase:{phase.phase}', f'joint:{phase.joint}',
            f'step:{phase.step}')


def _labels(stamp):
    return [] if stamp is None else [(f'{STAMP_LABEL}{stamp}', 1, 1)]


def stamp_of(dims) -> int | None:
    """Return the nanoseconds of the first 'stamp:' label in a layout, None if absent."""
    for label, _, _ in dims:
        if label.startswith(STAMP_LABEL):
            try:
                return int(label[len(STAMP_LABEL):])
            except ValueError:
                raise BagError(f'has the label {label!r}, expected '
                               f'{STAMP_LABEL}<whole nanoseconds>') from None
    return None


@lru_cache(maxsize=512)
def _numbers(order, count, form):
    code = struct.Struct(f'{order}{count}{form}')
    return code, code.size // count


class _CdrReader:
    """
    Read one CDR message from its start, either byte order; lengths are never believed.

    rosbags 0.11 refuses a JointState whose velocities or efforts are empty as rclpy writes it,
    for the bytes behind it.
    """

    def __init__(self, data):
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise BagError(f'is not plain CDR (begins with {bytes(data[:4]).hex(" ")!r})')
        self._data = data
        self._order = '<' if data[1] else '>'
        self._at = 4

    def take(self, form, count=1) -> tuple:
        """Return ``count`` numbers of struct code ``form``, aligned as in CDR."""
        code, align = _numbers(self._order, count, form)
        start = self._at + -(self._at - 4) % align
        self._reach(start + code.size)
        return code.unpack_from(self._data, start)

    def _reach(self, end):
        if end > len(self._data):
            raise BagError(f'is cut short: needs {end} bytes, has {len(self._data)}')
        self._at = end

    def stamp(self) -> int:
        """Return a builtin_interfaces/Time in nanoseconds."""
        return self.take('i')[0] * _SECOND + self.take('I')[0]

    def text(self) -> str:
        """Return one string."""
        size, = self.take('I')
        start = self._at
        self._reach(start + size)
        raw = bytes(self._data[start:self._at])
        try:
            return raw.rstrip(b'\0').decode()
        except UnicodeDecodeError:
            raise BagError(f'holds a string that is not text: {raw[:20]!r}') from None

    def doubles(self) -> tuple:
        """Return a sequence of float64 as a tuple, empty if absent."""
        count = self._count(8)
        return self.take('d', count) if count else ()

    def texts(self) -> tuple:
        """Return a sequence of strings as a tuple."""
        return tuple(self.text() for _ in range(self._count(4)))

    def dimensions(self) -> tuple:
        """Return the layout dimensions as a tuple of (label, size, stride)."""
        return tuple((self.text(), *self.take('I', 2)) for _ in range(self._count(4)))

    def _count(self, least):
        """Return how many entries of at least ``least`` bytes follow; they must fit."""
        count, = self.take('I')
        if count * least > len(self._data) - self._at:
            raise BagError(f'is cut short: announces {count} entries, '
                           f'has {len(self._data) - self._at} bytes left')
        return count


def unpack_multi_array(data: bytes) -> tuple:
    """
    Return the dims, tuples (label, size, stride), and values of one Float64MultiArray.

    Raises BagError, its sentence without a subject, if the bytes are no such message.
    """
    reader = _CdrReader(data)
    dims, (offset,), values = reader.dimensions(), reader.take('I'), reader.doubles()
    return dims, values[offset:]


def unpack_joint_state(data: bytes) -> tuple:
    """
    Return stamp [ns], frame, names, position, velocity and effort (tuples) of one JointState.

    Raises BagError, its sentence without a subject, if the bytes are no such message.
    """
    reader = _CdrReader(data)
    return (reader.stamp(), reader.text(), reader.texts(),
            reader.doubles(), reader.doubles(), reader.doubles())
