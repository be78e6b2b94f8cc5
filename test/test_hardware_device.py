# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Frames through a bad line, the device interface, and the serial example with its fake robot."""

from importlib import metadata
import json
from pathlib import Path
import subprocess
import sys
import time

from gms_flex_control.errors import ConfigError
from gms_flex_control.hardware import device as devices
from gms_flex_control.hardware.device import Device, DeviceError, Sample
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / 'examples'
sys.path.append(str(EXAMPLES))
from serial_arm import Decoder, EFFORT, encode, SerialArm, STATE  # noqa: E402  no package has it

FAKE = [sys.executable, str(EXAMPLES / 'serial_arm.py'), '--joints', '2']
NAMES = 'a1,a2,m1,m2'


def test_frames_come_through_in_pieces_of_any_size():
    rng = np.random.default_rng(0)
    numbers = [tuple(rng.normal(size=rng.integers(0, 9))) for _ in range(300)]
    stream = b''.join(encode(STATE, k, row) for k, row in enumerate(numbers))
    decoder, frames = Decoder(), []
    while stream:
        size = int(rng.integers(1, 60))
        frames += decoder.feed(stream[:size])
        stream = stream[size:]
    assert [frame.numbers for frame in frames] == numbers
    assert (decoder.broken, decoder.lost) == (0, 0)


def test_a_line_that_loses_and_changes_bytes_never_delivers_a_wrong_number():
    """Of 2000 frames with a fault in every tenth, the others come and nothing else does."""
    rng = np.random.default_rng(1)
    sent, stream, hit = {}, b'', 0
    for k in range(2000):
        numbers = (float(k), *rng.normal(size=4))
        sent[float(k)] = numbers
        frame = bytearray(encode(EFFORT, k, numbers))
        if rng.random() < 0.1:
            hit += 1
            place = int(rng.integers(len(frame)))
            if rng.random() < 0.5:
                del frame[place:place + int(rng.integers(1, 5))]
            else:
                frame[place] ^= 1 << int(rng.integers(8))
        stream += bytes(frame)
    decoder = Decoder()
    got = [frame.numbers for frame in decoder.feed(stream)]
    assert all(sent[numbers[0]] == numbers for numbers in got)
    # a byte too few, or a wrong count, can take a neighbour along while sync is found again
    assert 2000 - 2 * hit <= len(got) <= 2000 - hit + 1
    assert decoder.broken > 0 and decoder.lost == 2000 - len(got)


class Silent(Device):
    """A robot that says nothing."""

    def __init__(self, options, order):
        self.options, self.order = options, order

    names = ('a',)

    def connect(self):
        pass

    def read(self, timeout):
        return Sample(position=(0.0,))

    def write(self, efforts):
        pass

    def close(self):
        pass


@pytest.fixture
def offered(monkeypatch):
    """Offer Silent and other things as entry points."""
    entries = [metadata.EntryPoint(name, value, devices.GROUP) for name, value in (
        ('silent', f'{__name__}:Silent'), ('text', 'json:dumps'), ('gone', 'no_such_module:X'))]
    monkeypatch.setattr(devices.metadata, 'entry_points', lambda group: [
        entry for entry in entries if entry.group == group])


def test_a_device_is_found_by_its_entry_point_with_its_options(offered):
    device = devices.find('silent', ['baud=115200', 'path=a=b'], ('m1', 'm2'))
    assert device.options == {'baud': '115200', 'path': 'a=b'} and device.order == ('m1', 'm2')
    assert device.figures() == {}


@pytest.mark.parametrize('name, options, words', [
    ('silnet', [], "no package offers 'silnet'.*did you mean 'silent'"),
    ('text', [], 'is not a subclass of gms_flex_control.hardware.device.Device'),
    ('gone', [], "'gone' cannot be loaded"),
    ('silent', ['baud'], "'baud' must have the form name=value"),
    ('serial_arm:SerialArm', ['port=/dev/null'], 'takes port=<path> and names='),
    ('serial_arm:SerialArm', ['port=/x', 'names=a', 'speed=9'], 'not speed')])
def test_a_device_that_cannot_be_had_is_refused(offered, name, options, words):
    with pytest.raises(ConfigError, match=words):
        devices.find(name, options, ('m1',))


@pytest.fixture
def fake():
    """Run the fake robot; yield its process and a device connected to it."""
    process = subprocess.Popen(FAKE, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    path = process.stdout.readline().strip()
    device = SerialArm({'port': path, 'names': NAMES}, ('m1', 'm2'))
    device.connect()
    yield process, device
    device.close()
    process.kill()
    process.wait()


def order(process, *lines):
    """Give orders to the fake robot."""
    process.stdin.write(''.join(f'{line}\n' for line in lines))
    process.stdin.flush()


def samples(device, count, efforts=None):
    """Return so many samples, writing efforts for each."""
    found, end = [], time.monotonic() + 30.0
    while len(found) < count:
        assert time.monotonic() < end
        sample = device.read(0.1)
        if sample is not None:
            found.append(sample)
            if efforts is not None:
                device.write(efforts)
    return found


def report(process):
    """Return what the fake robot knows of itself."""
    order(process, 'report')
    return json.loads(process.stdout.readline())


def test_efforts_arrive_and_the_robot_moves(fake):
    process, device = fake
    last = samples(device, 100, [0.1, -0.2])[-1]
    assert report(process)['torque'] == [0.1, -0.2]
    assert last.effort[2:] == (0.1, -0.2) and np.isnan(last.effort[:2]).all()
    assert last.position[2] > 0.0 > last.position[3] and last.velocity == ()
    assert samples(device, 1)[0].stamp > last.stamp > 0


def test_the_robot_ends_its_torque_by_itself_when_nobody_writes(fake):
    process, device = fake
    samples(device, 20, [0.1, 0.1])
    samples(device, 100)  # 0.2 s without an effort
    assert report(process)['torque'] == [0.0, 0.0] and report(process)['quiet'] >= 1


def test_a_robot_that_dies_is_a_broken_link_that_says_so(fake):
    process, device = fake
    samples(device, 5)
    order(process, 'die')
    with pytest.raises(DeviceError, match='closed by the other side|cannot be read'):
        samples(device, 1000)
    device.close()
    with pytest.raises(DeviceError, match='is not open'):
        device.read(0.0)
    device.write([0.0, 0.0])  # does nothing
    with pytest.raises(DeviceError, match='cannot be opened'):
        SerialArm({'port': '/dev/no_such_line', 'names': 'a'}, ('m',)).connect()
