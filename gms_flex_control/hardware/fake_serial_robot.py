# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""
A fake robot at a pseudo terminal, to try the serial example and its faults without hardware.

``python -m gms_flex_control.hardware.fake_serial_robot --joints 2`` prints the path of its line
and obeys orders on its standard input: ``drop N`` (bytes), ``corrupt N`` (frames), ``mute``,
``unmute``, ``freeze`` (the same state again and again), ``report`` (JSON), ``die``.
"""

import argparse
import json
import os
import select
import sys
import time
import tty

from gms_flex_control.hardware.frames import Decoder, EFFORT, encode, STATE

WATCHDOG = 0.05            # no torque without an effort frame for that long [s]
_STIFFNESS, _LINK, _MOTOR = 1.5, 0.05, 0.006  # N m/rad, kg m^2
_FRICTION = 0.02           # viscous, both sides [N m s/rad]
_SUBSTEPS = 10


class FakeRobot:
    """
    Flexible joints without effect on each other, at one end of a line.

    Parameters
    ----------
    joints : int
        How many; their encoders are all links, then all motors.
    rate : float
        States per second.

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
        if any(self.torque) and time.monotonic() - self._heard > WATCHDOG:
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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
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
