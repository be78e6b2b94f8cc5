# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The messages of the control loop: labels, layouts, and CDR bytes packed by hand for speed."""

from functools import lru_cache
import struct

from gms_flex_control.errors import BagError
import numpy as np

LITTLE_ENDIAN = b'\x00\x01\x00\x00'
VALUES = ('position', 'velocity', 'effort')


class Layout:
    """The fields of one message after its CDR header, placed one after the other."""

    def __init__(self):
        self._fields, self._constants, self._at = [], {}, 0

    def _place(self, name, kind, constant=None):
        dtype = np.dtype(kind)
        align = 1 if dtype.kind == 'S' else dtype.base.itemsize
        self._at += -self._at % align
        self._fields.append((name, kind, self._at + len(LITTLE_ENDIAN)))
        if constant is not None:
            self._constants[name] = np.array(constant, dtype=dtype)
        self._at += dtype.itemsize

    def _place_text(self, name, text):
        raw = text.encode() + b'\0'
        self._place(f'{name}_size', '<u4', len(raw))
        self._place(name, f'S{len(raw)}', raw)

    @property
    def size(self):
        """Return the length of a message [bytes]."""
        return self._at + len(LITTLE_ENDIAN)

    def dtype(self, size=None):
        """Return the record type, ``size`` bytes long where a writer pads the end."""
        names, formats, offsets = zip(*self._fields, strict=True)
        return np.dtype({'names': names, 'formats': formats, 'offsets': offsets,
                         'itemsize': size or self.size})

    def fits(self, records):
        """Return which of ``records`` (T,) have these names and lengths, bool (T,)."""
        good = np.full(len(records), True)
        for name, value in self._constants.items():
            good &= records[name] == value
        return good


class JointStateLayout(Layout):
    """
    The bytes of every JointState with the same names and lengths.

    Parameters
    ----------
    names : tuple of str
        Joint names.
    counts : tuple of int
        Lengths of position, velocity and effort.
    frame : str, optional
        The header's frame_id.

    """

    def __init__(self, names, counts, frame=''):
        super().__init__()
        self._place('sec', '<i4')
        self._place('nanosec', '<u4')
        self._place_text('frame', frame)
        self._place('names', '<u4', len(names))
        for k, name in enumerate(names):
            self._place_text(f'name{k}', name)
        for name, count in zip(VALUES, counts, strict=True):
            self._place(f'{name}_count', '<u4', count)
            if count:
                self._place(name, f'({count},)<f8')

    def template(self):
        """Return one message with zeros for its stamp and values."""
        record = np.zeros(1, self.dtype())
        for name, value in self._constants.items():
            record[name] = value
        return LITTLE_ENDIAN + record.tobytes()[len(LITTLE_ENDIAN):]


class ArrayLayout(Layout):
    """
    The bytes of every Float64MultiArray with the same layout but for the digits of its stamp.

    Parameters
    ----------
    dims : sequence of (label, size, stride)
        The layout.
    count : int
        Number of values, all of them data.
    head : bytes
        The CDR header.
    stamp : tuple of (int, int), optional
        Which dimension carries the stamp, and where in its label the digits begin.

    """

    def __init__(self, dims, count, head, stamp=None):
        super().__init__()
        self._fields.append(('head', '<u4', 0))
        self._constants['head'] = np.frombuffer(head, '<u4')[0]
        self._place('dims', '<u4', len(dims))
        for k, (label, size, stride) in enumerate(dims):
            if stamp is not None and k == stamp[0]:
                self._place_stamp(label.encode(), stamp[1])
            else:
                self._place_text(f'label{k}', label)
            self._place(f'size{k}', '<u4', size)
            self._place(f'stride{k}', '<u4', stride)
        self._place('offset', '<u4', 0)
        self._place('count', '<u4', count)
        if count:
            self._place('data', f'({count},)<f8')

    def _place_stamp(self, raw, start):
        self._place('stamp_size', '<u4', len(raw) + 1)
        self._place('stamp_prefix', f'S{start}', raw[:start])
        self._place('digits', f'({len(raw) - start},)u1')
        self._place('stamp_end', 'u1', 0)

    @staticmethod
    def stamps(records):
        """Return the stamps [ns], uint64 (T,), and which are digits and no more, bool (T,)."""
        digits = records['digits'] - np.uint8(ord('0'))
        stamps = np.zeros(len(records), dtype=np.uint64)
        for digit in digits.T:
            stamps = stamps * np.uint64(10) + digit
        return stamps, (digits <= 9).all(axis=1)


JOINT_STATE = 'sensor_msgs/msg/JointState'
MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
CLOCK = 'rosgraph_msgs/msg/Clock'

_SECOND = 1_000_000_000


@lru_cache(maxsize=64)
def _joint_state_template(names, counts):
    layout = JointStateLayout(names, counts)
    return layout.dtype(), layout.template()


def pack_joint_states(names, stamps, position, velocity=None, effort=None):
    """
    Pack many JointState messages that share their names.

    Parameters
    ----------
    names : sequence of str
        Joint names, ``m`` of them.
    stamps : array_like of int, shape (T,)
        Header stamps [ns].
    position, velocity, effort : array_like, shape (T, m), optional
        Values [rad, rad/s, N m]; None leaves the field empty.

    Returns
    -------
    list of bytes
        ``T`` CDR messages (little endian, padding zero).

    """
    stamps = np.asarray(stamps, dtype=np.int64)
    columns = {}
    for name, values in zip(VALUES, (position, velocity, effort), strict=True):
        if values is not None:
            columns[name] = np.asarray(values, dtype=float)
            if columns[name].shape != (len(stamps), len(names)):
                raise BagError(f'{name} has shape {columns[name].shape}, expected '
                               f'{(len(stamps), len(names))} for {len(names)} names')
    counts = tuple(len(names) if name in columns else 0
                   for name in VALUES)
    dtype, template = _joint_state_template(tuple(names), counts)
    buffer = bytearray(template * len(stamps))
    records = np.frombuffer(buffer, dtype)
    records['sec'], records['nanosec'] = stamps // _SECOND, stamps % _SECOND
    for name, values in columns.items():
        if values.shape[1]:
            records[name] = values
    size, raw = dtype.itemsize, bytes(buffer)
    return [raw[k:k + size] for k in range(0, len(raw), size)]


def pack_joint_state(names, stamp, position, velocity=None, effort=None):
    """Pack one JointState; as :func:`pack_joint_states` with one stamp and flat arrays."""
    rows = [None if values is None else [values] for values in (position, velocity, effort)]
    return pack_joint_states(names, [stamp], *rows)[0]


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


def pack_multi_array(dims, data, data_offset=0):
    """
    Pack one Float64MultiArray.

    Parameters
    ----------
    dims : sequence of (label, size, stride)
        The layout, outermost first.
    data : sequence of float
        Flat values; a list is fastest.
    data_offset : int, optional
        Where the values begin in ``data``.

    Returns
    -------
    bytes
        The CDR message.

    """
    fields, sizes = [], []
    for label, size, stride in dims:
        text = label.encode() + b'\0'
        sizes.append(len(text))
        fields += (len(text), text, size, stride)
    return _multi_array_struct(tuple(sizes), len(data)).pack(
        LITTLE_ENDIAN, len(sizes), *fields, data_offset, len(data), *data)


def pack_clock(stamp):
    """Return the CDR bytes of a rosgraph_msgs/Clock at ``stamp`` [ns]."""
    return struct.pack('<4siI', LITTLE_ENDIAN, stamp // _SECOND, stamp % _SECOND)


@lru_cache(maxsize=512)
def _numbers(order, count, form):
    code = struct.Struct(f'{order}{count}{form}')
    return code, code.size // count


class CdrReader:
    """Read one CDR message from its start, either byte order."""

    def __init__(self, data):
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise BagError(f'is not plain CDR (begins with {bytes(data[:4]).hex(" ")!r})')
        self._data = data
        self._order = '<' if data[1] else '>'
        self.at = 4

    def take(self, form, count=1):
        """Return ``count`` numbers of struct code ``form``, aligned as CDR asks."""
        code, align = _numbers(self._order, count, form)
        start = self.at + -(self.at - 4) % align
        if start + code.size > len(self._data):
            raise BagError(f'is cut short: needs {start + code.size} bytes, '
                           f'has {len(self._data)}')
        self.at = start + code.size
        return code.unpack_from(self._data, start)

    def number(self, form='I'):
        """Return one number of struct code ``form``."""
        return self.take(form)[0]

    def stamp(self):
        """Return a builtin_interfaces/Time in nanoseconds."""
        return self.number('i') * _SECOND + self.number('I')

    def text(self):
        """Return one string."""
        size = self.number()
        end = self.at + size
        if end > len(self._data):
            raise BagError(f'is cut short: needs {end} bytes, has {len(self._data)}')
        raw, self.at = bytes(self._data[self.at:end]), end
        return _decoded(raw)

    def doubles(self):
        """Return a sequence of float64 as a tuple, empty if there is none."""
        count = self.number()
        if count * 8 > len(self._data) - self.at:
            raise BagError(f'is cut short: announces {count} numbers, '
                           f'has {len(self._data) - self.at} bytes left')
        return self.take('d', count) if count else ()

    def texts(self):
        """Return a sequence of strings as a tuple."""
        return tuple(self.text() for _ in range(self._sized()))

    def _sized(self):
        """Return a count of things of at least 4 bytes, refused if they cannot fit."""
        count = self.number()
        if count * 4 > len(self._data) - self.at:
            raise BagError(f'is cut short: announces {count} entries, '
                           f'has {len(self._data) - self.at} bytes left')
        return count

    def dimensions(self):
        """Return the layout dimensions as a tuple of (label, size, stride)."""
        return tuple((self.text(), *self.take('I', 2)) for _ in range(self._sized()))


def unpack_multi_array(data, known=None):
    """
    Read one Float64MultiArray.

    Parameters
    ----------
    data : bytes
        The CDR message.
    known : dict, optional
        Layouts met before, by message length; kept by the caller, it makes a series fast.

    Returns
    -------
    tuple
        ``(dims, values)``: dims as tuples (label, size, stride), values after data_offset.

    Raises
    ------
    BagError
        If the bytes are no such message; the sentence has no subject yet.

    """
    guess = None if known is None else known.get(len(data))
    if guess is not None and data[:4] == LITTLE_ENDIAN:
        sizes, count, code = guess
        fields, end = code.unpack_from(data), 2 + 4 * len(sizes)
        if fields[1] == len(sizes) and fields[2:end:4] == sizes and fields[end + 1] == count:
            dims = tuple((_decoded(fields[k + 1]), fields[k + 2], fields[k + 3])
                         for k in range(2, end, 4))
            return dims, fields[end + 2 + fields[end]:]
    reader = CdrReader(data)
    dims, offset, values = reader.dimensions(), reader.number(), reader.doubles()
    if known is not None and data[1] == 1:
        sizes = tuple(len(label.encode()) + 1 for label, _, _ in dims)
        code = _multi_array_struct(sizes, len(values))
        if code.size <= len(data):
            known[len(data)] = sizes, len(values), code
    return dims, values[offset:]


def _decoded(raw):
    try:
        return raw.rstrip(b'\0').decode()
    except UnicodeDecodeError:
        raise BagError(f'holds a string that is not text: {raw[:20]!r}') from None


def unpack_joint_state(data):
    """
    Read one JointState.

    Returns
    -------
    tuple
        ``(stamp, frame, names, position, velocity, effort)``, stamp in ns, the last four
        tuples.

    Raises
    ------
    BagError
        If the bytes are no such message; the sentence has no subject yet.

    """
    reader = CdrReader(data)
    return (reader.stamp(), reader.text(), reader.texts(),
            reader.doubles(), reader.doubles(), reader.doubles())


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


def pack_supply(voltage, stamp):
    """Pack the voltage of the drives' supply [V] at the time ``stamp`` [ns]."""
    return pack_multi_array([('supply', 1, 1), (f'{STAMP_LABEL}{stamp}', 1, 1)],
                            [float(voltage)])


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


PHASE_TOPIC = '/identification/phase'


def pack_phase(phase):
    """Return a Phase as CDR bytes, its ``time_ns`` as the stamp it holds from."""
    labels = (f'{STAMP_LABEL}{phase.time_ns}', f'phase:{phase.phase}', f'joint:{phase.joint}',
              f'step:{phase.step}')
    return pack_multi_array([(label, 1, 1) for label in labels], [float(phase.value)])
