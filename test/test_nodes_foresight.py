# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""An effort that is sent ahead is what bridge and controller come to, or there is none."""

from dataclasses import replace
from types import SimpleNamespace

from gms_flex_control.file_io import share_path
from gms_flex_control.hardware.bridge import Bridge
from gms_flex_control.hardware.mapping import ReadingError
from gms_flex_control.schema.files import load_controller, load_robot, read_values
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

following = pytest.importorskip('gms_flex_control.nodes.following')
foresight = pytest.importorskip('gms_flex_control.hardware.foresight')
node_values = pytest.importorskip('gms_flex_control.schema.build')

CONFIG = share_path() / 'config'
FILES = [CONFIG / f'{name}.yaml' for name in ('robot', 'first_start')]
PERIOD = 2_000_000   # [ns]
MOTION = builders.sinusoid([0.3, 0.3], 3.0, ramp_time=1.0)
VALUES = {'mode': 'realtime', 'reference_timeout': 0.1, 'reference_hold': 2.0,
          'reference_relax': 1.0, 'resume_time': 0.2}


class Chain:
    """A simulated robot, a bridge and a controller's follower, state by state."""

    def __init__(self, compensation='gms', **limits):
        self.model = load_robot(FILES[:1])
        self.gains = replace(load_controller(FILES, self.model), compensation=compensation)
        values = read_values([CONFIG / 'robot.yaml', CONFIG / 'bridge.yaml'])[0]
        self.bridge = Bridge(node_values.bridge_from_values(
            values | {f'limits.joint1.{name}': value for name, value in limits.items()},
            self.model.joints, self.model.motors))
        self.health = SimpleNamespace(fault='', name='controller', report=lambda *_: None,
                                      warn=lambda *_, **__: None)
        self.follower = following.Follower(self.model, self.gains, VALUES, self.health)
        self.sent, self.rng = np.zeros(2), np.random.default_rng(1)
        self.foresight = foresight.Foresight(
            self.bridge, [self.health], SimpleNamespace(follower=self.follower, sent=self.sent))
        self.plant = SteppedPlant(self.model, period=PERIOD / 1e9, substeps=20)
        self.names = list(self.bridge.params.joint_map.names)
        self.count, self.now, self.begin = 0, 10**12, 10**12
        self.spoil = lambda fields: None

    def tick(self):
        """Let a sample pass; return what was foreseen and what came, lists of efforts."""
        self.now += PERIOD + int(self.rng.integers(-200_000, 200_000))
        self.count += 1
        if self.count % 2:  # every other one is extrapolated
            self.follower.keep(self.now, following.Reference(
                'motion', MOTION.sample((self.now - self.begin) / 1e9)), '/trajectory')
            self.foresight.plan()
        self.plant.advance(np.array(self.bridge.torque))
        seen = self.plant.measured
        fields = [np.concatenate([seen.q_link, seen.q_motor]),
                  np.concatenate([seen.dq_link, seen.dq_motor]),
                  np.concatenate([[np.nan] * 2, self.plant.applied])]
        self.spoil(fields)
        arrived = self.now + int(self.rng.integers(50_000, 300_000))
        foreseen = self.foreseen = self.foresight.efforts(self.names, fields, self.now, arrived)
        self.bridge.take_state(0, self.names, *fields, self.now, arrived)
        robot = self.bridge.robot
        for name in ('q_link', 'dq_link', 'q_motor', 'dq_motor'):
            getattr(self.follower.controller.measured, name)[:] = getattr(robot.measured, name)
        self.follower.encoders.act(self.sent, robot.applied.tolist())
        self.sent[:] = self.follower.answer(robot.stamp, False)
        self.bridge.take_command(self.sent.tolist(), robot.stamp, '/controller', arrived)
        self.foresight.plan()
        self.bridge.enable(arrived)
        return foreseen, self.bridge.params.joint_map.efforts(self.bridge.torque).tolist()

    def settled(self):
        """Go on until efforts are foreseen."""
        while self.tick()[0] is None:
            assert self.count < 1000
        return self


@pytest.mark.parametrize('compensation', ['gms', 'disturbance_observer'])
def test_what_is_sent_ahead_is_what_follows_to_the_last_bit(compensation):
    chain = Chain(compensation, torque_rate=3.0, velocity_margin=20.0).settled()
    pairs = [chain.tick() for _ in range(700)]
    foreseen = [pair for pair in pairs if pair[0] is not None]
    assert len(foreseen) > 690
    assert all(ahead == came for ahead, came in foreseen)
    assert chain.bridge.counters['commands held back by torque_rate']
    assert np.ptp([came[0] for _, came in pairs]) > 0.1


@pytest.mark.parametrize(('lost', 'phase'), [(1.0, 'holding'), (2.5, 'relaxing')])
def test_a_reference_that_comes_back_is_met_without_a_jump(lost, phase):
    """From where the arm is held, with its torque; from a torque let down, with what is left."""
    chain, asked, torques = Chain().settled(), [], []
    chain.follower.handover = following.Handover(2.0)
    law = chain.follower.controller.tick
    chain.follower.controller.tick = lambda motion, elapsed: (
        asked.append(motion[0].copy()), law(motion, elapsed))
    keep, chain.follower.references.keep = chain.follower.references.keep, lambda *_: None
    while chain.now - chain.begin < lost * 1e9:
        chain.tick()
    assert chain.follower.references.phase == phase
    held, given = asked[-1], chain.sent.copy()
    asked.clear()
    chain.follower.references.keep = keep
    for _ in range(100):
        chain.tick()
        torques.append(chain.sent.copy())
    assert chain.follower.references.phase == following.FOLLOWING
    assert np.abs(MOTION.sample(lost)[0] - held).max() > 0.05  # the reference is elsewhere
    assert np.abs(np.diff(asked, axis=0)).max() < 2e-3
    assert np.abs(asked[0] - held).max() < (2e-3 if phase == 'holding' else 0.05)
    assert np.abs(np.diff([given, *torques[:20]], axis=0)).max() < 0.1


def silent(chain):
    """Stay away for longer than a controller may, while the watch goes on."""
    chain.now += 40_000_000
    chain.bridge.robot.arrived = chain.bridge._watched = chain.now


@pytest.mark.parametrize('change', [
    lambda chain: vars(chain).update(spoil=lambda fields: fields[1].__setitem__(0, 50.0)),
    lambda chain: vars(chain).update(spoil=lambda fields: fields[0].__setitem__(
        2, fields[0][2] + 0.4)),
    lambda chain: vars(chain.health).update(fault='an exception'), silent,
    lambda chain: vars(chain).update(now=chain.now + 10**9),  # by another clock
    lambda chain: chain.bridge.fault('a fault'),
    lambda chain: chain.bridge.supervisor.stop('the button'),
    lambda chain: chain.follower.use(chain.gains), lambda chain: chain.follower.reset(),
    lambda chain: chain.bridge.take_torque_away(), lambda chain: chain.names.reverse(),
    lambda chain: chain.bridge.watch(chain.now - 10**8)])
def test_nothing_is_sent_ahead_where_something_has_changed(change):
    chain = Chain().settled()
    change(chain)
    chain.count += chain.count % 2 + 1  # no reference, after which it is planned anew
    assert chain.tick()[0] is None


def test_nothing_is_sent_ahead_that_is_no_number():
    chain = Chain().settled()
    chain.spoil = lambda fields: fields[0].__setitem__(0, np.nan)
    with pytest.raises(ReadingError):
        chain.tick()
    assert chain.foreseen is None


def test_nothing_is_sent_ahead_for_a_frozen_encoder_or_without_reference():
    chain = Chain().settled()
    frozen = chain.plant.measured.q_link[0]
    chain.spoil = lambda fields: (fields[0].__setitem__(0, frozen), fields[1].__setitem__(0, 0.5))
    for _ in range(100):
        ahead, came = chain.tick()
        if chain.follower.encoders.frozen:
            break
    assert ahead is None and came == [0.0, 0.0]
    late = Chain().settled()
    late.count = 2**60  # even for good after one more
    late.follower.keep = lambda *_: None
    assert [late.tick()[0] for _ in range(60)][-1] is None
