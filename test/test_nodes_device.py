# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The bridge to a robot without ros2_control: the example at a serial line."""

import json
import os
import subprocess

from bridge_lab import ask, bridge_lab, enable, move, report
from gms_flex_control.hardware.device import Device, DeviceError
from gms_flex_control.nodes import robot_links
import pytest
from test_hardware_device import EXAMPLES, FAKE, order


def start_fake(lab):
    """Start a fake robot and put its line where the bridge looks for it."""
    fake = subprocess.Popen(FAKE, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    path = fake.stdout.readline().strip()
    link = lab.folder / 'line.new'
    link.symlink_to(path)
    os.replace(link, lab.folder / 'line')
    lab.processes.append(fake)
    return fake


def figures(lab, said='ACTIVE'):
    """Return the newest figures of the plant on /diagnostics."""
    del lab.reports[:]
    return {one.key: one.value for one in report(lab, said).values}


def ask_fake(fake):
    """Return what the fake robot knows."""
    order(fake, 'report')
    return json.loads(fake.stdout.readline())


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run bridge, controller and trajectory; the line does not exist yet."""
    folder = tmp_path_factory.mktemp('device')
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('PYTHONPATH', str(EXAMPLES), os.pathsep)
        with bridge_lab(folder, robot=False, silence_timeout=0.3, mapping=f"""
bridge:
  device: serial_arm:SerialArm
  device_options: ['port={folder}/line', 'names=joint1,joint2,joint1_motor,joint2_motor']
""") as running:
            yield running
            assert running.plant.runs


def test_a_robot_at_a_line_that_comes_later_is_held_and_survives_lost_bytes(lab):
    lab.until(lambda: 'cannot be opened' in lab.plant.printed())
    assert 'no joint states from device serial_arm:SerialArm yet' in ask(lab, 'enable').message
    lab.fake = fake = start_fake(lab)
    lab.until(lambda: lab.states)
    move(lab, flows=lambda: any(ask_fake(fake)['torque']))
    order(fake, 'drop 7')
    ask_fake(fake)
    order(fake, 'corrupt 4')
    lab.until(lambda: int(figures(lab, '')['frames broken']) >= 3)
    assert ask_fake(fake)['frames'] > 20


def test_a_line_that_dies_is_a_fault_and_a_new_one_is_taken_up_after_a_reset(lab):
    if not hasattr(lab, 'fake'):  # this test is repeated, or runs alone
        lab.fake = start_fake(lab)
    lab.until(lambda: ask(lab, 'reset').success and lab.states)
    enable(lab)
    connected = lab.plant.printed().count('is connected')
    order(lab.fake, 'die')
    lab.fake.wait()
    report(lab, 'FAULT: device serial_arm:SerialArm')
    assert not ask(lab, 'enable').success
    lab.fake = fake = start_fake(lab)
    lab.until(lambda: lab.plant.printed().count('is connected') > connected)
    assert ask(lab, 'reset').success
    enable(lab)
    assert lab.plant.signal(2) == 0
    lab.until(lambda: not any(ask_fake(fake)['torque']))
    lab.plant = lab.start('plant_node.new', files=lab.files, **lab.given)


class Failing(Device):
    """A device that notes what is done to it, and of which one method fails once."""

    names = ('j',)

    def __init__(self, fails):
        self.done, self._fails = [], fails

    def _do(self, what):
        self.done.append(what)
        if self._fails == what:
            self._fails = None
            raise DeviceError(f'{what} failed')

    def connect(self):
        self._do('connect')

    def read(self, timeout):
        if 'write 0.5' in self.done:
            self._do('read')

    def write(self, efforts):
        self._do(f'write {efforts[0]}')

    def close(self):
        self.done.append('close')
        raise OSError('the line is gone')


class Zeroed:
    """A robot that sends zero through its link when it fails, as every robot does."""

    def fail(self, sentence):
        try:
            self.link.write([0.0])
        except DeviceError:
            pass


@pytest.mark.parametrize('fails', ['read', 'write 0.5'])
def test_a_device_that_fails_gets_zero_before_it_is_closed_and_is_opened_again(
        lab, monkeypatch, fails):
    device, robot = Failing(fails), Zeroed()
    monkeypatch.setattr(robot_links.devices, 'find', lambda *_: device)
    robot.link = link = robot_links.DeviceLink(
        lab.node, robot, {'bridge.device': 'failing', 'bridge.device_options': []}, ('m',))
    with link.reading():
        lab.until(lambda: not link.broken)
        try:
            link.write([0.5])
        except DeviceError as error:
            assert fails == 'write 0.5' and 'device failing: write 0.5 failed' in str(error)
        lab.until(lambda: device.done.count('connect') == 2)
    done = [what for what in device.done if what != 'read']
    assert done[:5] == ['connect', 'write 0.5', 'write 0.0', 'close', 'connect']
