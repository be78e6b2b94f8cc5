# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Example of a Device: a robot at a serial line that speaks the frames of frames.py."""

import math
import os
import select
import tty

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware.device import Device, DeviceError, Sample
from gms_flex_control.hardware.frames import Decoder, EFFORT, encode, STATE

_CHUNK = 4096


class SerialDevice(Device):
    """
    A robot that sends time, angles and efforts, and takes efforts.

    A state frame holds the device's time [s], the angle of each encoder and the effort of each
    actuator; an effort frame one effort per actuator.

    Parameters
    ----------
    options : dict of str to str
        ``port``: path of the line; ``names``: of the encoders, with commas between.
    order : tuple of str
        See Device.

    """

    def __init__(self, options, order):
        self._order = order
        unknown = sorted(set(options) - {'port', 'names'})
        if unknown or 'port' not in options or not options.get('names'):
            raise ConfigError('bridge.device_options: the serial example takes '
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
