# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What single nodes do with the messages of others: reordered, wrong, stale, plain."""

from itertools import pairwise
import math
import time

from node_harness import array_message, Float64MultiArray, joint_state, Lab, PATIENCE, stamp_of
import pytest

PERIOD = 2_000_000   # [ns]
Clock = pytest.importorskip('rosgraph_msgs.msg').Clock
POSITION = (0.1, 0.2, 0.15, 0.25)
INF, NAN = math.inf, math.nan


@pytest.fixture(scope='module')
def alone(tmp_path_factory):
    """Run controller and trajectory in lockstep on states that the test makes."""
    with Lab(tmp_path_factory.mktemp('alone')) as lab:
        lab.controller = lab.start('controller_node', mode='lockstep')
        lab.trajectory = lab.start('trajectory_node', mode='lockstep')
        lab.states = lab.say('states')
        lab.extra_reference = lab.say('references')
        lab.commands, lab.references = lab.hear('commands', 'references')
        lab.until(lambda: lab.states.get_subscription_count() == 2
                  and lab.extra_reference.get_subscription_count() == 2)
        lab.stamp = 0
        assert answer(lab, joint_state(0, POSITION))
        yield lab
        assert lab.controller.runs and lab.trajectory.runs


@pytest.fixture(scope='module')
def plant(tmp_path_factory):
    """Run a plant in real time at 200 Hz on commands that the test makes."""
    with Lab(tmp_path_factory.mktemp('plant')) as lab:
        lab.plant = lab.start('plant_node', rate=200.0, command_timeout=0.1, silence_timeout=0.3)
        lab.commands = lab.say('commands')
        lab.states = lab.hear('states')
        lab.until(lambda: lab.states and lab.commands.get_subscription_count())
        yield lab
        assert lab.plant.runs


def answer(lab, state):
    """Send a state, again each second as the plant does, and return its command."""
    stamp, due = stamp_of(state), 0.0

    def answered():
        nonlocal due
        if time.monotonic() > due:
            lab.states.publish(state)
            due = time.monotonic() + 1.0
        return [command for command in lab.commands if stamp_of(command) == stamp]
    return lab.until(answered)[0]


def following(lab, *arguments, **options):
    """Return the joint state that follows the last one made."""
    lab.stamp += PERIOD
    return joint_state(lab.stamp, *arguments, **options)


def test_names_are_mapped_whatever_their_order(alone):
    """Both robots stand still at the same angles: the same commands, and none that is zero."""
    answer(alone, following(alone, POSITION))
    first = answer(alone, following(alone, POSITION))
    mixed = ['joint2_motor', 'gripper', 'joint1', 'joint2', 'joint1_motor']
    second = answer(alone, following(alone, (0.25, NAN, 0.1, 0.2, 0.15), names=mixed,
                                     velocity=(0.0, NAN, 0.0, 0.0, 0.0)))
    assert list(second.data) == pytest.approx(list(first.data), abs=1e-3)
    assert all(abs(torque) > 0.01 for torque in first.data)
    reference = next(one for one in alone.references if stamp_of(one) == alone.stamp)
    assert list(reference.data[:2]) == [0.1, 0.2]


@pytest.mark.parametrize('label', ['stamp:', 'stamp:²', 'stamp:' + 5000 * '9', 'stamp:-7'])
def test_a_label_that_is_no_stamp_harms_nobody(alone, label):
    alone.extra_reference.publish(array_message((0.5,) * 10, label))
    answer(alone, following(alone, POSITION))


def test_a_state_sent_again_gets_the_same_answer(alone):
    state = following(alone, POSITION)
    answer(alone, state)
    alone.states.publish(state)
    same = alone.until(lambda: [command for command in alone.commands
                                if stamp_of(command) == alone.stamp][1:])
    assert list(same[0].data) == list(alone.commands[-2].data)


def test_time_set_back_begins_anew(alone):
    """As when the simulated robot is started again."""
    alone.stamp = 1 - PERIOD
    answer(alone, following(alone, (0.3, 0.2, 0.3, 0.2)))
    alone.until(lambda: any(stamp_of(reference) == 1 and list(reference.data[:2]) == [0.3, 0.2]
                            for reference in alone.references))
    assert 'observer begins anew' in alone.controller.printed()


def rest(lab):
    """Wait until the plant applies nothing, though it publishes on."""
    lab.until(lambda: not any(lab.states[-1].effort[2:]))


def test_a_plain_command_acts_from_its_arrival_until_the_timeout(plant):
    plant.commands.publish(Float64MultiArray(data=[0.03, -0.02]))
    plant.until(lambda: list(plant.states[-1].effort[2:]) == pytest.approx([0.03, -0.02]))
    rest(plant)
    acted = [state for state in plant.states if any(state.effort[2:])]
    # 0.1 s at 200 Hz, on a machine that may be busy
    assert 10 <= len(acted) <= 25


def test_a_stale_command_is_never_acted_on(plant):
    """Its stamp counts, not when it arrives; a stamp to come is no better."""
    rest(plant)
    begin = len(plant.states)
    for _ in range(20):
        now = stamp_of(plant.more(plant.states, 1)[0])
        for age in (105_000_000, 10**9, now, -60 * 10**9):
            plant.commands.publish(array_message([0.5, 0.5], f'stamp:{now - age}', 'source:test'))
    plant.more(plant.states, 5)
    assert not any(any(state.effort[2:]) for state in plant.states[begin:])


def test_a_fresh_command_acts_and_ends(plant):
    """Not with all of its torque at once, if there was a silence before."""
    rest(plant)
    end = time.monotonic() + PATIENCE
    while plant.states[-1].effort[2] != pytest.approx(0.04):
        assert time.monotonic() < end, plant.plant.printed()
        plant.more(plant.states, 1)
        now = stamp_of(plant.states[-1])  # on a busy machine several have come
        plant.commands.publish(array_message([0.04, 0.0], f'stamp:{now}', 'source:test'))
    rest(plant)


def test_stamps_go_on_in_whole_periods_through_all_of_this(plant):
    plant.more(plant.states, 20)  # where this test alone is repeated
    stamps = [stamp_of(state) for state in plant.states]
    assert {later - sooner for sooner, later in pairwise(stamps)} == {5_000_000}


@pytest.fixture(scope='module')
def stepped(tmp_path_factory):
    """Run a plant in lockstep, 1 kHz, on commands that the test makes."""
    with Lab(tmp_path_factory.mktemp('stepped')) as lab:
        lab.states, lab.clock = lab.hear('states'), lab.listen(Clock, '/clock')
        lab.commands = lab.say('commands')
        lab.plant = lab.start('plant_node', mode='lockstep', rate=1000.0, wait_for_subscribers=1)
        lab.until(lambda: lab.states and lab.commands.get_subscription_count())
        yield lab
        assert lab.plant.runs


def test_lockstep_begins_at_zero_and_waits_for_the_command_of_its_state(stepped):
    assert stamp_of(stepped.states[0]) == 0
    repeated = stepped.more(stepped.states, 1)[0]  # it asks again rather than step alone
    assert stamp_of(repeated) == 0
    for wrong in ('stamp:-1000000', 'stamp:1000000', 'stamp:77'):
        stepped.commands.publish(array_message([0.5, 0.5], wrong))
    assert stamp_of(stepped.more(stepped.states, 1)[0]) == 0
    stepped.commands.publish(array_message([0.05, 0.0], 'stamp:0'))
    stepped.until(lambda: stamp_of(stepped.states[-1]) == 1_000_000)
    assert list(stepped.states[-1].effort[2:]) == pytest.approx([0.05, 0.0])


def test_lockstep_obeys_plain_commands_and_keeps_the_clock_at_100_hz(stepped):
    begin = stamp_of(stepped.states[-1])
    for k in range(1, 101):
        stepped.commands.publish(Float64MultiArray(data=[0.001 * k, 0.0]))
        stepped.until(lambda k=k: stamp_of(stepped.states[-1]) == begin + k * 1_000_000)
        assert stepped.states[-1].effort[2] == pytest.approx(0.001 * k)
    stepped.until(lambda: clock_of(stepped.clock[-1]) >= begin + 90_000_000)
    times = [clock_of(message) for message in stepped.clock]
    assert times[0] == 0
    assert {later - sooner for sooner, later in pairwise(times)} == {10_000_000}


def clock_of(message):
    """Return the time of a Clock [ns]."""
    return message.clock.sec * 10**9 + message.clock.nanosec


def test_lockstep_refuses_wrong_commands_and_steps_on_the_next_good_one(stepped):
    stamp = stamp_of(stepped.states[-1])
    for data in ((), (0.5,), (0.5,) * 3, (NAN, 0.0), (0.0, -INF)):
        stepped.commands.publish(array_message(data, f'stamp:{stamp}'))
    stepped.commands.publish(array_message([0.02, 0.03], f'stamp:{stamp}'))
    stepped.until(lambda: stamp_of(stepped.states[-1]) > stamp)
    assert list(stepped.states[-1].effort[2:]) == pytest.approx([0.02, 0.03])
    assert 'command refused: ' in stepped.plant.printed()
