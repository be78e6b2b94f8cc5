# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Three processes in lockstep over DDS give the numbers of one process, to the last bit."""

from dataclasses import fields
import sys
import warnings

from gms_flex_control.data.bag import Bag, BagWarning
from gms_flex_control.data.cdr import unpack_joint_state
from gms_flex_control.data.reader import read_recording
from gms_flex_control.experiment import driven as over_dds
from gms_flex_control.experiment.simulated import read_plan, simulate_to_bag
from gms_flex_control.schema.files import load_robot, save_robot
import node_harness
from node_harness import array_message, FILES, stamp_of, write_parameters
import numpy as np
import pytest

RECORDER = """
from functools import partial
import os
import signal
import struct
import subprocess
import sys
import time

from gms_flex_control.cli.main import main
from gms_flex_control.nodes import recorder


class Tardy(recorder.Recorder):
    begun, lost = None, [10**6 * int(one) for one in os.environ.get('LOST', '').split()]

    def __init__(self, node, *rest):
        self._create, self._later = node.create_subscription, {}
        node.create_subscription = self._subscribe_later
        super().__init__(node, *rest)

    def _subscribe_later(self, kind, name, hear, *rest, **options):
        if name != '/joint_states':
            self._later[name] = partial(self._create, kind, name, hear, *rest, **options)
            return None
        self.begun = time.monotonic()
        return self._create(kind, name, partial(self._lose, hear), *rest, **options)

    def _lose(self, hear, data):
        if struct.unpack_from('=iI', data, 4)[1] not in self.lost:
            hear(data)

    def poll(self):
        super().poll()
        if self._later and self.begun and time.monotonic() > self.begun + 1.0:
            self._subscriptions |= {name: create() for name, create in self._later.items()}
            self._later.clear()
            self.begun = time.monotonic()
        elif self.begun and not self._later and time.monotonic() > self.begun + 0.5:
            self.begun = None
            subprocess.Popen(['sh', '-c', f'sleep 2; kill -CONT {os.getpid()}'])
            os.kill(os.getpid(), signal.SIGSTOP)


recorder.Recorder = Tardy
sys.exit(main())
"""
MIXED = """
motors: ['', joint2_motor]
arm: {joint1: {stiffness: .inf}}
encoder: {noise: 1e-4}
"""


def both(tmp_path, monkeypatch, files, *, duration, compensation, rate=500.0):
    """Return the recording of three nodes, that of one process, and the plan."""
    domain, lock = node_harness.take_domain()
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv(node_harness.DISCOVERY, 'LOCALHOST')
    with lock:
        over_dds.drive_recorded(over_dds.DrivenPlan(
            files=tuple(files), model=files[0], compensation=compensation, duration=duration,
            rate=rate), tmp_path / 'driven', log=tmp_path / 'log')
    plan = read_plan(files, duration=duration,
                     overrides={'compensation': compensation, 'rate': rate})
    simulate_to_bag(plan, tmp_path / 'simulated')
    names = plan.robot.joints, plan.robot.motors
    return (read_recording(tmp_path / 'driven', *names),
            read_recording(tmp_path / 'simulated', *names), plan)


def assert_equal(driven, simulated):
    for field in fields(driven):
        if field.name != 'source':
            np.testing.assert_array_equal(getattr(driven, field.name),
                                          getattr(simulated, field.name), err_msg=field.name)


def test_nodes_and_one_process_agree(tmp_path, monkeypatch):
    """
    At 300 Hz the period is no whole number of nanoseconds; noise comes from the same seed.

    The first joint is rigid: it has no motor side and no motor name, and its link the effort.
    """
    mixed = write_parameters(tmp_path / 'mixed.yaml', MIXED)
    save_robot(load_robot([FILES[0], mixed]), tmp_path / 'robot.yaml')
    extra = write_parameters(tmp_path / 'extra.yaml', (
        'seed: 7\ninitial: {joint1: 0.4}\n'
        'trajectory: {joint1: {amplitude: 0.7}, ramp_time: 1}'))
    files = [tmp_path / 'robot.yaml', FILES[1], node_harness.CONFIG / 'sinusoid.yaml', extra]
    driven, simulated, plan = both(tmp_path, monkeypatch, files, duration=3.0,
                                   compensation='gms', rate=300.0)
    assert len(driven.time) == 900
    assert np.all(np.isfinite(driven.reference)) and np.all(np.isfinite(driven.command))
    assert np.all(np.isfinite(driven.friction_hat))
    assert np.ptp(driven.tau_motor, axis=0).min() > 0.05
    np.testing.assert_array_equal(np.isfinite(driven.q_motor), [[False, True]] * 900)
    assert np.all(np.diff(np.rint(driven.time * 1e9)) == plan.period_ns)
    assert np.ptp(driven.q_link[:, 0]) > 0.3  # it moved
    assert_equal(driven, simulated)
    names = {tuple(unpack_joint_state(data)[2]) for batch in Bag(tmp_path / 'driven').batches()
             for topic, _, _, data in batch if topic == node_harness.STATES}
    assert names == {('joint1', 'joint2', 'joint2_motor')}


def begin_tardily(monkeypatch, **environment):
    """
    Let the recorder say that it has subscribed, and subscribe to the answers a second after that.

    Soon afterwards it stands still for two seconds.
    """
    usual = over_dds.executable
    monkeypatch.setattr(over_dds, 'executable', lambda name: (
        [sys.executable, '-c', RECORDER] if name == 'gms_flex' else usual(name)))
    for name, value in environment.items():
        monkeypatch.setenv(name, value)


def test_a_recorder_that_comes_late_and_stands_still_lacks_nothing(tmp_path, monkeypatch):
    begin_tardily(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', BagWarning)  # of states that were sent again meanwhile
        driven, simulated, _ = both(tmp_path, monkeypatch, node_harness.MOTION, duration=8.0,
                                    compensation='gms')
    assert len(driven.time) == 4000
    assert_equal(driven, simulated)


def test_a_recording_that_lacks_samples_is_refused(tmp_path, monkeypatch):
    begin_tardily(monkeypatch, LOST='20 22 24')
    with pytest.raises(over_dds.ProcessError, match=r'driven: 3 of 50 samples lack .* repeat'):
        both(tmp_path, monkeypatch, node_harness.MOTION, duration=0.1, compensation='gms')


def test_the_last_sample_is_answered_before_the_plant_ends(lab):
    """A recording of N states has N commands; unanswered the plant would wait."""
    states = lab.hear('states')
    commands = lab.say('commands')
    plant = lab.start('plant_node', mode='lockstep', rate=100.0, duration=0.03,
                      wait_for_subscribers=1)
    lab.until(lambda: states and commands.get_subscription_count())
    for stamp in (0, 10_000_000):
        commands.publish(array_message([0.0, 0.0], f'stamp:{stamp}'))
        lab.until(lambda stamp=stamp: stamp_of(states[-1]) == stamp + 10_000_000)
    lab.more(states, 1)  # the last one, sent again
    assert plant.runs and stamp_of(states[-1]) == 20_000_000
    commands.publish(array_message([0.0, 0.0], 'stamp:20000000'))
    assert plant.wait() == 0
