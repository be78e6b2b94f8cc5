# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Frozen encoders are reported, an arm that stands never is."""

from dataclasses import replace
import math
from types import SimpleNamespace

from core_runs import effect_on
from gms_flex_control.control import frozen_encoders as frozen
from gms_flex_control.control.cascade import SteppedController
from gms_flex_control.control.frozen_encoders import EncoderWatch, FrozenEncoders
from gms_flex_control.params.robot import EncoderParams
from gms_flex_control.simulation import loop
from gms_flex_control.simulation.loop import SteppedPlant
from gms_flex_control.trajectory import builders
import numpy as np
import pytest

DT = 0.002
SIDES = ('q_link', 'dq_link', 'q_motor', 'dq_motor')
COARSE = EncoderParams(counts=4096.0, velocity_cutoff=50.0)
TORQUES = tuple(effect_on(joint, 'motor_coulomb', 0.3) for joint in ('joint1', 'joint2'))


def state(q_link=(0.1, 0.2), dq_link=(0.0, 0.0), q_motor=(0.3, 0.4), dq_motor=(0.0, 0.0)):
    """Return what is measured of two joints."""
    return SimpleNamespace(**{name: np.array(value) for name, value in zip(
        SIDES, (q_link, dq_link, q_motor, dq_motor), strict=True)})


@pytest.fixture
def judge(robot, gains):
    """Return one that has seen the first state."""
    return begun(robot, gains)


def begun(robot, gains):
    made = FrozenEncoders(robot, gains.torque_limit)
    assert made.look(state(), np.zeros(2), 0.0) is None
    return made


def time_to(judge, states, torques=(0.0, 0.0), dt=DT, longest=20.0):
    """Return when it speaks and what it says; both may be functions of time [s]."""
    for k in range(1, round(longest / dt)):
        now = states(k * dt) if callable(states) else states
        torque = torques(k * dt) if callable(torques) else torques
        said = judge.look(now, np.array(torque), dt)
        if said:
            return k * dt, said
    return None


def rest(judge, torques=(0.0, 0.0), duration=0.5):
    """Let the arm stand; nothing is to be said of it."""
    assert time_to(judge, state(), torques, longest=duration) is None


@pytest.mark.parametrize('dt', [1e-3, 2e-3, 5e-3])
@pytest.mark.parametrize('rate', [0.03, 0.3, -0.3])
def test_a_rate_reveals_a_frozen_link_after_20_mrad(robot, gains, rate, dt):
    time, said = time_to(begun(robot, gains), state(dq_link=(rate, 0.0)), dt=dt)
    # the integral forgets within a second: v T (1 - exp(-t / T)) = 20 mrad
    assert time == pytest.approx(-math.log(1.0 - 0.02 / abs(rate)), rel=0.02, abs=2 * dt)
    assert said.startswith('joint1 has been at exactly 0.1 rad for ')
    assert said.endswith('0.02 rad: the encoder is frozen')


def test_noise_and_outliers_of_the_rate_are_no_sign_of_a_frozen_encoder(judge):
    rng = np.random.default_rng(1)

    def noisy(time):
        spike = 1e5 if round(time / DT) % 500 == 0 else 0.0
        return state(dq_link=rng.normal(0.0, 0.1, 2) + spike, dq_motor=rng.normal(0.0, 0.1, 2))
    assert time_to(judge, noisy) is None


def test_a_motor_that_does_not_give_way_to_a_torque_is_reported(judge):
    """It changes by 2 N m in a second, the threshold is 1 N m."""
    rest(judge)
    time, said = time_to(judge, state(), lambda time: (2.0 * time, 0.0))
    # the average lags by 20 ms
    assert time == pytest.approx(0.5 + 0.02 + frozen.STANDING, abs=3 * DT)
    assert said.startswith('joint1_motor has been at exactly 0.3 rad')
    assert said.endswith('the encoder is frozen or the motor blocked')


@pytest.mark.parametrize('torques', [
    lambda time: (1.9, -1.9), lambda time: (0.45 * math.sin(9.0 * time), 0.0),
    lambda time: (2.0 * (-1.0) ** round(time / DT), 0.0)])
def test_constant_and_small_and_chattering_torques_hold_a_motor(judge, torques):
    assert time_to(judge, state(), torques, longest=5.0) is None


def test_a_motor_that_gets_nothing_is_not_expected_to_move(judge):
    """As while a robot is disabled; what it gets later begins from nothing."""
    rest(judge, (0.8, 0.0))
    rest(judge, (math.nan, math.nan))
    rest(judge, (-0.8, 0.9))


def test_it_stays_frozen_until_the_angle_changes(judge):
    stuck = state(dq_link=(0.5, 0.0))
    assert time_to(judge, stuck)
    for _ in range(100):
        assert judge.look(state(), np.zeros(2), DT)
    assert judge.look(state(), np.zeros(2), 0.2) and judge.look(state(), np.zeros(2), -9.0)
    assert judge.look(state(q_link=(0.1000001, 0.2)), np.zeros(2), DT) is None


@pytest.mark.parametrize('gap', [0.0, -1.0, 0.0301, 1e3])
def test_nothing_is_concluded_across_a_silence_or_a_jump(judge, gap):
    stuck = state(dq_link=(0.5, 0.0))
    for _ in range(20):
        assert time_to(judge, stuck, longest=0.03) is None
        assert judge.look(stuck, np.array([1.9, 1.9]), gap) is None


@pytest.mark.parametrize('efforts, frozen_then', [
    ((), True), ((math.nan, math.nan), True), ((1.8, 0.0), True), ((-1.8, 0.0), True),
    ((180.0, 0.0), True), ((0.5, 0.0), False), ((0.0, 0.0), False), ((0.019, 0.0), False)])
def test_a_robot_that_says_it_gives_less_torque_than_was_sent_is_believed(
        robot, gains, efforts, frozen_then):
    watch = EncoderWatch(robot, gains.torque_limit, state())
    began = 0
    for k in range(200):
        watch.act(np.array([1.8, 0.0]) * (k > 100), efforts if k > 100 else efforts[:0])
        watch.look(DT)
        began += watch.began
    assert bool(watch.frozen) == frozen_then and watch.count == began == frozen_then
    watch.reset()
    assert not watch.frozen


MOTIONS = {
    'sinusoid': builders.sinusoid([1.0, 1.0], 6.0, ramp_time=3.0),
    'creeping': builders.sinusoid([0.05, 0.05], 30.0, ramp_time=3.0),
    'fast': builders.sinusoid([0.5, 0.5], 1.0, ramp_time=1.0),
    'between rests': builders.polynomial([1.0, 1.0], 1.5, 2.0, 3),
    'hold': builders.hold([0.0, 0.0])}


@pytest.mark.parametrize(('compensation', 'effects'), [('none', ()), ('gms', TORQUES)])
@pytest.mark.parametrize('motion', MOTIONS)
def test_no_motion_with_4096_counts_looks_frozen(robot, gains, motion, compensation, effects):
    """Begun 0.2 rad away, that the torque be large; the controller knows of no motor friction."""
    model = replace(robot, encoder=COARSE)
    gains = replace(gains, compensation=compensation)
    run = loop.run(replace(model, effects=effects), model, gains, MOTIONS[motion],
                   duration=12.0, period_ns=round(DT * 1e9), q_link=np.array([0.2, -0.1]))
    judge, last = FrozenEncoders(model, gains.torque_limit), np.zeros(2)
    longest = 0.0
    for k, (row, command) in enumerate(zip(run.measured, run.command, strict=True)):
        said = judge.look(state(*row), last, DT if k else 0.0)
        assert said is None, f'{k * DT:.3f} s: {said}'
        longest, last = max(longest, *judge.memory['still']), command
    assert longest > 2 * frozen.STANDING  # there was something to report


@pytest.mark.parametrize('stiffness', [1.5, 200.0, np.inf])
def test_presliding_and_break_away_do_not_look_frozen(robot, gains, stiffness):
    """Torques through levels of F_s as the identification experiment asks for them."""
    rigid = np.isinf(stiffness)
    model = replace(robot, encoder=COARSE, arm=replace(robot.arm, stiffness=np.full(2, stiffness)),
                    motors=('', '') if rigid else robot.motors)
    levels = 1.5 * 0.1 * np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    ramp = builders.torque_levels(levels, 0.1)
    plant = SteppedPlant(model, period=DT, substeps=20)
    judge, torque = FrozenEncoders(model, 0.3 * gains.torque_limit), np.zeros(2)
    plant.measure()
    for k in range(round(ramp.end / DT)):
        said = judge.look(plant.measured, torque, DT if k else 0.0)
        assert said is None, f'{k * DT:.3f} s: {said}'
        torque = np.array(ramp.sample(k * DT)[0])
        plant.advance(torque)


def first_word(robot, gains, side, joint, *, velocity, at=6.0, longest=1.5):
    """Return how long after an encoder froze in a motion it is reported [s], and the sentence."""
    plant = SteppedPlant(robot, period=DT, substeps=20)
    controller, judge = SteppedController(gains, robot), FrozenEncoders(robot, gains.torque_limit)
    motion, torque, held, seen = MOTIONS['sinusoid'], np.zeros(2), None, controller.measured
    plant.measure()
    for k in range(round((at + longest) / DT)):
        for name in SIDES:
            getattr(seen, name)[:] = getattr(plant.measured, name)
        if k * DT >= at:
            held = float(getattr(seen, f'q_{side}')[joint]) if held is None else held
            getattr(seen, f'q_{side}')[joint] = held
            getattr(seen, f'dq_{side}')[joint] *= velocity
        said = judge.look(seen, torque, DT if k else 0.0)
        if said:
            return k * DT - at, said
        torque = controller.tick(motion.sample(k * DT), DT).copy()
        plant.advance(torque)
    return None


@pytest.mark.parametrize('joint', [0, 1])
@pytest.mark.parametrize(('name', 'velocity', 'soonest', 'latest', 'words'), [
    ('joint{}', 1.0, 0.03, 0.06, ''), ('joint{}_motor', 1.0, 0.03, 0.06, ''),
    ('joint{}_motor', 0.0, 0.0, 0.6, 'its torque changed by')])
def test_an_encoder_that_freezes_in_motion_is_found_by_its_velocity_or_the_torque(
        robot, gains, joint, name, velocity, soonest, latest, words):
    side = 'motor' if name.endswith('motor') else 'link'
    after, said = first_word(robot, gains, side, joint, velocity=velocity)
    assert soonest < after < latest and words in said
    assert said.startswith(name.format(joint + 1) + ' has been')
