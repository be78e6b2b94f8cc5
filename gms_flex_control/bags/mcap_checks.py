# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""What of an mcap file can be told without reading its records one by one."""

import mmap
import struct
import zlib

from mcap.opcode import Opcode

FRAME = struct.Struct('<BQ')
CHUNK_HEAD = struct.Struct('<QQQII')
_INDEX_HEAD = struct.Struct('<HI')
_INDEX_ENTRY = 16        # bytes: time and place of one message
_WINDOW = 8 * 1024 ** 2  # what of a mapped file is resident at once [bytes]


class Window:
    """
    Let go of what was read of a mapped file, for its pages count as memory of the process.

    Parameters
    ----------
    data : mmap
        The file; what was let go is read again when asked for.

    """

    def __init__(self, data):
        self._data, self._start = data, 0

    def reach(self, at):
        """Say that what is before byte ``at`` is done with."""
        if at - self._start >= _WINDOW and hasattr(self._data, 'madvise'):
            end = at - at % mmap.PAGESIZE
            self._data.madvise(mmap.MADV_DONTNEED, self._start, end - self._start)
            self._start = end


def checksum(data, end):
    """Return the CRC-32 of the first ``end`` bytes of a mapped file."""
    value, window = 0, Window(data)
    for at in range(0, end, _WINDOW):
        value = zlib.crc32(data[at:min(at + _WINDOW, end)], value)
        window.reach(min(at + _WINDOW, end))
    return value


def index_entries(data, at, size):
    """Return how many messages the index record at ``at`` names, None if it is malformed."""
    if size < _INDEX_HEAD.size:
        return None
    _, length = _INDEX_HEAD.unpack_from(data, at + FRAME.size)
    entries = -(-length // _INDEX_ENTRY)
    return entries if size == _INDEX_HEAD.size + entries * _INDEX_ENTRY else None


def summary_is_sound(footer, data, at):
    """Return whether the index before the footer record at ``at`` has its checksum."""
    start = footer.summary_start
    return 0 < start <= at and zlib.crc32(memoryview(data)[start:at + 25]) == footer.summary_crc


def is_chunk(data, at, size):
    """Return whether the chunk record at ``at`` has lengths that agree with each other."""
    if size < CHUNK_HEAD.size + 8:
        return False
    _, _, uncompressed, _, name = CHUNK_HEAD.unpack_from(data, at + 9)
    if name not in (0, 3, 4) or size < CHUNK_HEAD.size + name + 8:
        return False
    inner, = struct.unpack_from('<Q', data, at + 9 + CHUNK_HEAD.size + name)
    return (inner + name + CHUNK_HEAD.size + 8 == size
            and (name > 0 or inner == uncompressed))


def next_sound(data, start):
    """Return where the next chunk or the end of the data begins, None if there is none."""
    end_mark = data.find(FRAME.pack(Opcode.DATA_END, 4), start)
    at = data.find(b'\x06', start)
    while at != -1 and (end_mark == -1 or at < end_mark):
        if at + 9 <= len(data):
            _, size = FRAME.unpack_from(data, at)
            if at + 9 + size <= len(data) and is_chunk(data, at, size):
                return at
        at = data.find(b'\x06', at + 1)
    return None if end_mark == -1 else end_mark
