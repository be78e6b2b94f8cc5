# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""
Example of a Device: an arm at a serial line, and a fake one to try it without hardware.

``bridge.device: serial_arm:SerialArm`` takes it where this folder is on the PYTHONPATH.

A frame is ``A5 5A | kind 1 | sequence 1 | count 1 | count x float64, little endian |
CRC-16/CCITT 2``; the checksum covers everything between the sync bytes and itself. A state frame
holds the device's time [s], the angle of each encoder and the effort of each actuator; an effort
frame one effort per actuator.

``python3 examples/serial_arm.py --joints 2`` is the fake robot. It prints the path of its line, a
pseudo terminal, and obeys orders on its standard input: ``drop N`` (bytes), ``corrupt N``
(frames), ``mute``, ``unmute``, ``freeze`` (the same state again and again), ``report`` (JSON),
``die``.
"""

import argparse
from binascii import crc_hqx
import json
import math
import os
import select
import struct
import sys
import time
import tty
from typing import NamedTuple

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.device import Device, DeviceError, Sample

STATE, EFFORT = ord('S'), ord('E')
_SYNC = b'\xa5\x5a'
_HEADER = struct.Struct('<BBB')
_CHECKSUM = struct.Struct('<H')
_START = 0xffff
_CHUNK = 4096
# the fake robot:
_WATCHDOG = 0.05           # no torque without an effort frame for that long [s]
_STIFFNESS, _LINK, _MOTOR = 1.5, 0.05, 0.006  # N m/rad, kg m^2
_FRICTION = 0.02           # viscous, both sides [N m s/rad]
_SUBSTEPS = 10


class Frame(NamedTuple):
    """One frame that came whole."""

    kind: int
    sequence: int
    numbers: tuple


def encode(kind, sequence, numbers) -> bytes:
    """Return the bytes of one frame; at most 255 ``numbers``, the sequence is taken mod 256."""
    body = _HEADER.pack(kind, sequence % 256, len(numbers)) + struct.pack(
        f'<{len(numbers)}d', *numbers)
    return _SYNC + body + _CHECKSUM.pack(crc_hqx(body, _START))


class Decoder:
    """Find frames in a stream that loses and changes bytes."""

    def __init__(self):
        self._buffer = bytearray()
        self._next = None
        self.broken = self.lost = 0  # wrong checksums, skipped numbers

    def feed(self, data):
        """Return the frames (list of Frame) that ``data`` (bytes) completes."""
        self._buffer += data
        frames = []
        while self._synchronise():
            length = len(_SYNC) + _HEADER.size + 8 * self._buffer[4] + _CHECKSUM.size
            if len(self._buffer) < length:
                break
            body = bytes(self._buffer[len(_SYNC):length - _CHECKSUM.size])
            checksum, = _CHECKSUM.unpack_from(self._buffer, length - _CHECKSUM.size)
            if checksum != crc_hqx(body, _START):
                self.broken += 1
                del self._buffer[:len(_SYNC)]  # the count may be wrong too: look for the next sync
                continue
            del self._buffer[:length]
            frames.append(self._frame(body))
        return frames

    def _synchronise(self):
        """Drop what is before the next sync; return whether a header is there."""
        begin = self._buffer.find(_SYNC)
        if begin < 0:
            begin = len(self._buffer) - (self._buffer[-1:] == _SYNC[:1])
        del self._buffer[:begin]
        return len(self._buffer) >= len(_SYNC) + _HEADER.size

    def _frame(self, body):
        kind, sequence, count = _HEADER.unpack_from(body)
        if self._next is not None:
            self.lost += (sequence - self._next) % 256
        self._next = (sequence + 1) % 256
        return Frame(kind, sequence, struct.unpack_from(f'<{count}d', body, _HEADER.size))


class SerialArm(Device):
    """
    A robot that sends time, angles and efforts, and takes efforts.

    Options are ``port``, the path of the line, and ``names`` of the encoders with commas between.
    """

    def __init__(self, options, order):
        self._order = order
        unknown = sorted(set(options) - {'port', 'names'})
        if unknown or 'port' not in options or not options.get('names'):
            raise ConfigError('bridge.device_options: a serial arm takes '
                              'port=<path> and names=<name>,<name>,... of its encoders'
                              f'{f", not {unknown[0]}" if unknown else ""}')
        self._port, self._names = options['port'], tuple(options['names'].split(','))
        self._file, self._decoder, self._sequence = None, Decoder(), 0
        self._unsent = 0

    @property
    def names(self):
        """Return the names of the encoders, then of actuators without one."""
        return (*self._names, *(name for name in self._order if name not in self._names))

    def connect(self):
        """Open the line."""
        self.close()
        try:
            self._file = os.open(self._port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._file)
        except (OSError, tty.error) as error:
            self.close()
            raise DeviceError(f'{self._port}: cannot be opened ({error})') from error
        self._decoder = Decoder()

    def read(self, timeout):
        """Return the newest Sample, or None if no frame is complete within ``timeout`` [s]."""
        if self._file is None:
            raise DeviceError(f'{self._port}: is not open')
        try:
            if not select.select([self._file], [], [], timeout)[0]:
                return None
            data = os.read(self._file, _CHUNK)
        except (OSError, ValueError) as error:
            raise DeviceError(f'{self._port}: cannot be read ({error})') from error
        if not data:
            raise DeviceError(f'{self._port}: was closed by the other side')
        expected = 1 + len(self._names) + len(self._order)
        frames = [frame for frame in self._decoder.feed(data) if frame.kind == STATE]
        if not frames:
            return None
        numbers = frames[-1].numbers
        if len(numbers) != expected or not math.isfinite(numbers[0]):
            raise DeviceError(f'{self._port}: a state has {len(numbers)} numbers, expected time, '
                              f'{len(self._names)} angles and {len(self._order)} efforts')
        return self._sample(numbers)

    def _sample(self, numbers):
        count = len(self._names)
        angles = list(numbers[1:1 + count])
        efforts = dict(zip(self._order, numbers[1 + count:], strict=True))
        unseen = len(self.names) - count
        return Sample(position=tuple(angles + [0.0] * unseen), stamp=int(1e9 * numbers[0]),
                      effort=tuple(efforts.get(name, math.nan) for name in self.names))

    def write(self, efforts):
        """Send one effort frame; one that does not fit into the line at once is lost."""
        if self._file is None:
            return
        self._sequence += 1
        try:
            os.write(self._file, encode(EFFORT, self._sequence, efforts))
        except BlockingIOError:
            self._unsent += 1
        except OSError as error:
            raise DeviceError(f'{self._port}: cannot be written ({error})') from error

    def close(self):
        """Close the line."""
        file, self._file = self._file, None
        if file is not None:
            os.close(file)

    def figures(self):
        """Return how the line does."""
        return {'frames broken': self._decoder.broken, 'frames lost': self._decoder.lost,
                'frames unsent': self._unsent}


class FakeRobot:
    """
    Flexible joints without effect on each other, at one end of a line.

    Its encoders are all links, then all motors; it sends ``rate`` states per second.
    """

    def __init__(self, joints, rate):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # kept open: the line outlives those who open it
        os.set_blocking(self._master, False)
        self._period, self._decoder = 1.0 / rate, Decoder()
        self._state = [[0.0] * 4 for _ in range(joints)]  # q1, dq1, q2, dq2
        self.torque, self._heard = [0.0] * joints, 0.0
        self._sequence = self._drop = self._corrupt = self.frames = self.quiet = 0
        self._muted = self._frozen = False

    @property
    def path(self):
        """Return the path of the line."""
        return os.ttyname(self._slave)

    def order(self, line):
        """Obey one order."""
        word, _, number = line.strip().partition(' ')
        if word == 'drop':
            self._drop += int(number)
        elif word == 'corrupt':
            self._corrupt += int(number)
        elif word in ('mute', 'unmute'):
            self._muted = word == 'mute'
        elif word == 'freeze':
            self._frozen = True
        elif word == 'report':
            print(json.dumps({'torque': self.torque, 'frames': self.frames, 'quiet': self.quiet,
                              'broken': self._decoder.broken, 'state': self._state}), flush=True)
        elif word == 'die':
            os._exit(1)

    def step(self):
        """Move for one period, hear and speak."""
        self._hear()
        if not self._frozen:
            for joint, torque in zip(self._state, self.torque, strict=True):
                self._move(joint, torque)
        self._speak()

    def _move(self, joint, torque):
        h = self._period / _SUBSTEPS
        for _ in range(_SUBSTEPS):
            spring = _STIFFNESS * (joint[2] - joint[0])
            joint[1] += h * (spring - _FRICTION * joint[1]) / _LINK
            joint[3] += h * (torque - spring - _FRICTION * joint[3]) / _MOTOR
            joint[0] += h * joint[1]
            joint[2] += h * joint[3]

    def _hear(self):
        try:
            data = os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            data = b''
        for frame in self._decoder.feed(data):
            if frame.kind == EFFORT and len(frame.numbers) == len(self.torque):
                self.torque, self._heard = list(frame.numbers), time.monotonic()
                self.frames += 1
        if any(self.torque) and time.monotonic() - self._heard > _WATCHDOG:
            self.torque = [0.0] * len(self.torque)
            self.quiet += 1

    def _speak(self):
        if self._muted:
            return
        self._sequence += not self._frozen
        data = encode(STATE, self._sequence, [
            self._sequence * self._period, *(joint[0] for joint in self._state),
            *(joint[2] for joint in self._state), *self.torque])
        if self._corrupt:
            self._corrupt -= 1
            data = data[:9] + bytes([data[9] ^ 0x10]) + data[10:]
        dropped = min(self._drop, len(data))
        self._drop -= dropped
        try:
            os.write(self._master, data[dropped:])
        except BlockingIOError:
            pass  # nobody reads: a real line forgets as well


def main():
    """Run until the standard input ends."""
    parser = argparse.ArgumentParser(description='A fake robot at a pseudo terminal')
    parser.add_argument('--joints', type=int, default=2)
    parser.add_argument('--rate', type=float, default=500.0, help='states per second')
    args = parser.parse_args()
    robot = FakeRobot(args.joints, args.rate)
    print(robot.path, flush=True)
    deadline = time.monotonic()
    while True:
        deadline = max(deadline + 1.0 / args.rate, time.monotonic() - 0.1)
        wait = max(0.0, deadline - time.monotonic())
        if select.select([sys.stdin], [], [], wait)[0]:
            orders = os.read(sys.stdin.fileno(), 4096)  # whole lines, as they are typed
            if not orders:
                return 0
            for line in orders.decode().splitlines():
                robot.order(line)
            time.sleep(max(0.0, deadline - time.monotonic()))
        robot.step()


if __name__ == '__main__':
    sys.exit(main())
