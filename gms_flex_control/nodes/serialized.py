# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
Messages that come and go again and again, as bytes of which only what changes is touched.

Between a message of Python and its bytes lies several times more work than sending them takes.
"""

from array import array
import struct

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

_TIME, _TIME_AT = struct.Struct('<iI'), 4  # of a header, behind the encapsulation
_STAMP = 'stamp:'
_GAP = 8  # bytes between two sequences of doubles: length and padding


class Serialized:
    """
    One reused JointState or Float64MultiArray, and its bytes.

    Stamp and numbers may change at any time; the rest only where the count of numbers does.

    Parameters
    ----------
    message : JointState or Float64MultiArray
        As it is published first. Sequences of a JointState are equally long; numbers are
        ``array('d')``.

    """

    def __init__(self, message):
        self._message, self._has_header = message, isinstance(message, JointState)
        self._fields = ('position', 'velocity', 'effort') if self._has_header else ('data',)
        self._labels = [] if self._has_header else [
            dimension for dimension in message.layout.dim if dimension.label.startswith(_STAMP)]
        self._lengths = None

    def data(self):
        """Return the message as it is now (bytes)."""
        message = self._message
        numbers = [getattr(message, field) for field in self._fields]
        label = self._labels[0].label.encode() if self._labels else b''
        lengths = [len(numbers[0]), len(label)]
        if lengths != self._lengths:
            self._learn(label, len(numbers[0]))
            self._lengths = lengths
        data = self._data
        if self._has_header:
            _TIME.pack_into(data, _TIME_AT, message.header.stamp.sec, message.header.stamp.nanosec)
        data[self._label] = label
        for place, values in zip(self._places, numbers, strict=True):
            data[place] = values.tobytes()
        return bytes(data)

    def _learn(self, label, count):
        """Find out where in the bytes everything stands."""
        self._data = data = bytearray(serialize_message(self._message))
        begin = data.find(label)
        self._label = slice(begin, begin + len(label))
        self._places = _places(len(data), count, len(self._fields))


class Deserialized:
    """
    JointStates from their bytes: one message for all that differ in stamp and numbers only.

    Whoever takes it keeps nothing of it.
    """

    def __init__(self):
        self._message, self._places = None, ()

    def message(self, data):
        """Return the JointState of ``data`` (bytes)."""
        if not self._places or len(data) != self._size or self._rest(data) != self._known:
            return self._learn(data)
        message, stamp = self._message, self._message.header.stamp
        stamp.sec, stamp.nanosec = _TIME.unpack_from(data, _TIME_AT)
        message.position, message.velocity, message.effort = (
            array('d', data[place]) for place in self._places)
        return message

    def _rest(self, data):
        """Return what stands before the positions, and how many numbers the others are."""
        position, velocity, effort = self._places
        return (data[_TIME_AT + _TIME.size:position.start],
                *(data[place.start - _GAP:place.start - 4] for place in (velocity, effort)))

    def _learn(self, data):
        self._message, self._size = deserialize_message(data, JointState), len(data)
        numbers = self._message.position, self._message.velocity, self._message.effort
        places = _places(self._size, len(numbers[0]), len(numbers))
        # of other lengths or another byte order, they do not stand there
        fits = all(data[place] == values.tobytes() and values
                   for place, values in zip(places, numbers, strict=True))
        self._places = places if fits else ()
        self._known = self._rest(data) if fits else None
        return self._message


def stamp_in(data, kind):
    """
    Return the stamp [ns] in the bytes of a JointState or Float64MultiArray, None without one.

    It is read without the rest; only bytes of the other byte order make a wrong one.
    """
    if kind is JointState:
        sec, nanosec = _TIME.unpack_from(data, _TIME_AT)
        return sec * 1_000_000_000 + nanosec
    begin = data.find(_STAMP.encode())
    digits = data[begin + len(_STAMP):data.find(b'\0', begin)] if begin >= 0 else b''
    return int(digits) if digits.isdigit() else None


def _places(end, count, sequences):
    """Return where (slices) the last sequences of ``count`` doubles stand that end at ``end``."""
    size = 8 * count
    ends = [end - k * (size + _GAP) for k in reversed(range(sequences))]
    return [slice(end - size, end) for end in ends]
