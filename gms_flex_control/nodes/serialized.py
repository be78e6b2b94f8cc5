# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
A message that is published again and again, as bytes of which only what changes is written anew.

To serialize a message of Python costs several times more than all the rest of publishing it.
"""

import struct

from rclpy.serialization import serialize_message
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
        size, end = 8 * count, len(data)
        ends = [end - k * (size + _GAP) for k in reversed(range(len(self._fields)))]
        self._places = [slice(end - size, end) for end in ends]
