# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The bytes of messages that are laid out alike, as one numpy record type."""

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
