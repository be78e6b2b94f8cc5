# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Frames of the example device: sync, kind, sequence number, count, doubles, checksum.

``A5 5A | kind 1 | sequence 1 | count 1 | count x float64, little endian | CRC-16/CCITT 2``; the
checksum covers everything between the sync bytes and itself.
"""

from binascii import crc_hqx
import struct
from typing import NamedTuple

SYNC = b'\xa5\x5a'
STATE, EFFORT = ord('S'), ord('E')
_HEADER = struct.Struct('<BBB')
_CHECKSUM = struct.Struct('<H')
_START = 0xffff


class Frame(NamedTuple):
    """One frame that came whole."""

    kind: int
    sequence: int
    numbers: tuple


def encode(kind, sequence, numbers):
    """Return the bytes of one frame; at most 255 ``numbers``, the sequence is taken mod 256."""
    body = _HEADER.pack(kind, sequence % 256, len(numbers)) + struct.pack(
        f'<{len(numbers)}d', *numbers)
    return SYNC + body + _CHECKSUM.pack(crc_hqx(body, _START))


class Decoder:
    """
    Find frames in a stream that loses and changes bytes.

    Attributes
    ----------
    broken : int
        Frames whose checksum was wrong.
    lost : int
        Frames whose number was skipped.

    """

    def __init__(self):
        self._buffer = bytearray()
        self._next = None
        self.broken = self.lost = 0

    def feed(self, data):
        """Return the frames (list of Frame) that ``data`` (bytes) completes."""
        self._buffer += data
        frames = []
        while self._synchronise():
            length = len(SYNC) + _HEADER.size + 8 * self._buffer[4] + _CHECKSUM.size
            if len(self._buffer) < length:
                break
            body = bytes(self._buffer[len(SYNC):length - _CHECKSUM.size])
            checksum, = _CHECKSUM.unpack_from(self._buffer, length - _CHECKSUM.size)
            if checksum != crc_hqx(body, _START):
                self.broken += 1
                del self._buffer[:len(SYNC)]  # the count may be wrong too: look for the next sync
                continue
            del self._buffer[:length]
            frames.append(self._frame(body))
        return frames

    def _synchronise(self):
        """Drop what is before the next sync; return whether a header is there."""
        begin = self._buffer.find(SYNC)
        if begin < 0:
            begin = len(self._buffer) - (self._buffer[-1:] == SYNC[:1])
        del self._buffer[:begin]
        return len(self._buffer) >= len(SYNC) + _HEADER.size

    def _frame(self, body):
        kind, sequence, count = _HEADER.unpack_from(body)
        if self._next is not None:
            self.lost += (sequence - self._next) % 256
        self._next = (sequence + 1) % 256
        return Frame(kind, sequence, struct.unpack_from(f'<{count}d', body, _HEADER.size))
