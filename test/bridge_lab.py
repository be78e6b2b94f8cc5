# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A bridge between the real controller and a robot process, and what a test needs to see."""

from contextlib import contextmanager
from pathlib import Path
import subprocess
import sys
import time

import node_harness
from node_harness import CONFIG, Trigger
import pytest
from rclpy.qos import QoSProfile
import ros2_control_robot as robot_process
from ros2_control_robot import EFFORTS, MAPPING, NAMES

DiagnosticArray = pytest.importorskip('diagnostic_msgs.msg').DiagnosticArray
RATE = 250.0


class Efforts(list):
    """Efforts on the wire, or those a robot says it drives with, and when they came [s]."""

    def append(self, message):
        super().append((time.monotonic(), list(message.data)))

    def driven(self, message):
        """Take the joint states of the robot."""
        super().append((time.monotonic(), [message.effort[NAMES.index(name)]
                                           for name in ('m2', 'm1')]))

    @property
    def last(self):
        """Return the efforts that hold now: zero before the first."""
        return self[-1][1] if self else [0.0]

    def first_zero_after(self, begin):
        """Return when torque ended for good after ``begin`` (None while it flows)."""
        if not self or any(self.last):
            return None
        flowing = [k for k, (_, data) in enumerate(self) if any(data)]
        last = flowing[-1] if flowing else -1
        return max(self[last + 1][0], begin)


@contextmanager
def bridge_lab(folder, *, robot=True, mapping=MAPPING, plant=None, composed=False,
               **parameters):
    """
    Yield a Lab with robot, bridge, controller and trajectory running, torque not enabled.

    ``plant`` is the command of the bridge, if it is not the installed one; ``composed`` runs
    all three nodes in one process.
    """
    mapping = node_harness.write_parameters(Path(folder) / 'mapping.yaml', mapping)
    with node_harness.Lab(Path(folder)) as lab:
        lab.files = [*node_harness.FILES, CONFIG / 'bridge.yaml', mapping]
        # a busy machine stops our robot of Python for longer than any real one
        lab.given = {'compensation': 'none', 'bridge__state_timeout': 0.3, **parameters}
        lab.processes, lab.clients = [], {}
        if robot:
            start_robot(lab)
        motion = {'files': [*lab.files, CONFIG / 'sinusoid.yaml'],
                  'trajectory__joint1__amplitude': 0.3, 'trajectory__joint2__amplitude': 0.3}
        if composed:
            lab.plant = lab.trajectory = lab.controller = lab.start(
                'loop_node', **motion, **lab.given)
        else:
            lab.plant = lab.start('plant_node', command=plant, files=lab.files, **lab.given)
            lab.trajectory = lab.start('trajectory_node', **motion)
        lab.efforts, lab.reports = Efforts(), []
        lab.driven = Efforts()
        lab.node.create_subscription(node_harness.JointState, robot_process.STATES,
                                     lab.driven.driven, QoSProfile(depth=100))
        lab.states = lab.hear('states')
        lab.node.create_subscription(node_harness.Float64MultiArray, EFFORTS, lab.efforts.append,
                                     QoSProfile(depth=100))
        lab.node.create_subscription(DiagnosticArray, '/diagnostics', lambda message: [
            lab.reports.append(one) for one in message.status if one.name == 'plant'],
            QoSProfile(depth=100))
        if not composed:
            start_controller(lab)
        try:
            yield lab
        finally:
            for process in lab.processes:
                process.kill()
                process.wait()


def start_robot(lab):
    """Start the robot process."""
    with (lab.folder / 'robot.log').open('wb') as log:
        lab.robot = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name('ros2_control_robot.py')), str(RATE)],
            env=lab.environment, stdout=log, stderr=subprocess.STDOUT)
    lab.processes.append(lab.robot)


def start_controller(lab, name='controller_node'):
    """Start a controller."""
    lab.controller = lab.start(name, files=lab.files, **lab.given)


def client_of(lab, name):
    """Return the client of a service; made early: DDS may lose the answer to one just made."""
    if name not in lab.clients:
        lab.clients[name] = lab.node.create_client(Trigger, name)
    return lab.clients[name]


def ask(lab, name):
    """Call a Trigger service, of the plant if ``name`` says no other; return its answer."""
    client = client_of(lab, name if name.startswith('/') else f'/plant/{name}')
    lab.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    lab.until(future.done)
    return future.result()


def enable(lab):
    """Enable torque as soon as the bridge agrees; leave a fault there may be first."""
    answers = []

    def enabled():
        answers.append(ask(lab, 'enable'))
        if 'reset first' in answers[-1].message:
            ask(lab, 'reset')
        return answers[-1].success
    lab.until(enabled)
    return answers


def move(lab, condition=lambda: True, flows=None, tries=10):
    """
    Enable torque, start the motion and wait until torque flows and ``condition()`` holds.

    A fault meanwhile, of a machine too busy for the loop, is left and all of it tried again.
    ``flows()`` says whether torque flows, where no efforts are published.
    """
    flows = flows or (lambda: all(lab.efforts.last))
    for _ in range(tries):
        assert ask(lab, 'reset').success
        lab.until(lambda: lab.states and max(map(abs, lab.states[-1].velocity)) < 0.05)
        enable(lab)
        del lab.reports[:]
        assert ask(lab, '/trajectory/start').success
        lab.until(lambda: fault_of(lab) or flows() and condition())
        if not fault_of(lab):
            return
    raise AssertionError(f'no motion: {fault_of(lab)}')


def fault_of(lab):
    """Return what the plant has said of a fault since the reports were cleared."""
    return next((one.message for one in lab.reports if 'FAULT' in one.message), '')


def fault(lab, act, text, undo=lambda: None, tries=5):
    """
    Let something happen while torque flows; return how long it then flowed on [s].

    A fault of another reason, of a machine too busy for the loop, is tried again.
    """
    for _ in range(tries):
        move(lab)
        lab.more(lab.states, 10)
        begin = time.monotonic()
        act()
        taken = time_to_zero(lab, begin)
        said = report(lab, 'FAULT').message
        if text in said:
            return taken
        undo()
    raise AssertionError(f'never {text!r}, in the end {said!r}')


def assert_fault_within(bound, lab, *arguments, tries=3, **options):
    """Assert that `fault` ends torque within ``bound`` [s], unless the machine is too busy."""
    taken = []
    for _ in range(tries):
        taken.append(fault(lab, *arguments, **options))
        if taken[-1] < bound:
            return
        options.get('undo', lambda: None)()
    raise AssertionError(f'torque flowed on for {taken} s')


def time_to_zero(lab, begin, efforts=None):
    """Wait for zero efforts and for 50 ms more of them; return when they came [s]."""
    efforts = lab.efforts if efforts is None else efforts
    lab.until(lambda: efforts.first_zero_after(begin)
              and time.monotonic() > efforts.first_zero_after(begin) + 0.05)
    return efforts.first_zero_after(begin) - begin


def report(lab, text):
    """Wait until /diagnostics says ``text`` of the plant; return that message."""
    return lab.until(lambda: next((one for one in reversed(lab.reports)
                                   if text in one.message), None))
