# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The simulated plant has the same limits, services and faults as the bridge."""

from bridge_lab import ask, client_of, enable
from node_harness import array_message, Lab, MOTION, stamp_of, TERM
import numpy as np
import pytest
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

LIMITS = {'limits__joint1__torque': 0.05, 'limits__joint2__upper': 0.3,
          'limits__joint2__position_margin': 0.05}
RATE = 500.0
THREE = ('plant_node', 'controller_node', 'trajectory_node')


def push(lab, torque, condition):
    """Command ``torque`` at each new state until ``condition(effort of the motors)`` holds."""
    seen = [0]

    def pushed():
        if len(lab.states) > seen[0]:
            seen[0] = len(lab.states)
            lab.commands.publish(array_message(torque, f'stamp:{stamp_of(lab.states[-1])}',
                                               'source:/test'))
        return condition(list(lab.states[-1].effort[2:]))
    lab.until(pushed)


def test_a_range_left_during_a_silence_is_a_fault_that_outlasts_the_silence(tmp_path):
    with Lab(tmp_path) as lab:
        lab.plant = lab.start('plant_node', files=MOTION, rate=200.0,
                              silence_timeout=0.04, **LIMITS)
        lab.states = lab.hear('states')
        lab.commands = lab.say('commands')
        lab.until(lambda: lab.states and lab.commands.get_subscription_count())
        push(lab, [0.0, 0.4], lambda _: lab.states[-1].position[1] > 0.15)  # and it coasts
        lab.until(lambda: 'joint2 is at 0.3' in lab.plant.printed())
        silent, beyond = lab.plant.printed().split('FAULT: ')[1:]
        assert silent.startswith('no command from /test') and beyond.startswith('joint2 is at')
        begin = len(lab.states)
        push(lab, [0.0, -0.1], lambda _: len(lab.states) > begin + 60)
        assert not any(any(state.effort[2:]) for state in lab.states[begin:])
        assert 'commands come again' not in lab.plant.printed()


@pytest.fixture(scope='module', params=[THREE, ('loop_node',)],
                ids=['three processes', 'one process'])
def loop(request, tmp_path_factory):
    """Run the loop along a large sinusoid that begins by itself."""
    with Lab(tmp_path_factory.mktemp('moving')) as lab:
        lab.clients, lab.used = {}, False
        lab.processes = [lab.start(
            name, files=MOTION, rate=RATE, silence_timeout=1.0, trajectory__autostart=True,
            trajectory__approach_time=1.0) for name in request.param]
        for name in ('plant/enable', 'plant/reset', 'trajectory/start'):
            client_of(lab, f'/{name}')
        lab.states, lab.references = lab.hear('states', 'references')
        yield lab


@pytest.fixture
def moving(loop):
    """Return the loop as it moves, whatever was before."""
    if loop.used:
        assert ask(loop, 'reset').success
        enable(loop)
        assert ask(loop, '/trajectory/start').success
    loop.used = True
    loop.until(lambda: loop.states and np.abs(loop.states[-1].position).max() > 0.4)
    return loop


def test_torque_begins_where_the_arm_is_however_far_the_reference_went(moving):
    lab = moving
    for service in ('emergency_stop', 'reset'):
        assert ask(lab, service).success

    def off():
        """Return how far the reference is from an arm at rest."""
        return max(abs(np.subtract(lab.references[-1].data[:2], lab.states[-1].position[:2]))) * (
            np.abs([state.velocity[:2] for state in lab.states[-20:]]).max() < 0.2)
    lab.until(lambda: lab.references and off() > 0.7, 30.0)
    rest, begin = np.array(lab.states[-1].position[:2]), len(lab.states)
    enable(lab)
    lab.more(lab.states, round(RATE))
    held = np.array([state.position[:2] for state in lab.states[begin:]])
    assert np.abs(held - rest).max() < 0.25
    assert ask(lab, '/trajectory/start').success
    lab.until(lambda: np.abs(np.array(lab.states[-1].position[:2]) - rest).max() > 0.3)


def test_two_controllers_are_a_fault_until_reset(moving):
    """The one that is left has wound up, and its reference went on: nothing passes by itself."""
    lab = moving
    other = lab.say('commands')

    def reported():
        other.publish(array_message([0.0, 0.0], f'stamp:{stamp_of(lab.states[-1])}',
                                    'source:/other'))
        return any('2 controllers command at once' in process.printed()
                   for process in lab.processes)
    lab.until(reported)
    begin = len(lab.states)
    lab.more(lab.states, 300)
    assert not any(any(state.effort[2:]) for state in lab.states[begin + 20:])
    enable(lab)
    lab.until(lambda: any(lab.states[-1].effort[2:]))


def test_points_are_refused_while_no_torque_flows(moving):
    lab = moving
    points = lab.speak(JointTrajectory, '/trajectory/joint_trajectory')
    lab.until(points.get_subscription_count)
    assert ask(lab, 'disable').success
    point = JointTrajectoryPoint(positions=[0.1, 0.1])
    point.time_from_start.sec = 1

    def refused():
        points.publish(JointTrajectory(joint_names=['joint1', 'joint2'], points=[point]))
        return any('joint trajectory refused: no torque flows (ZERO: disabled): call '
                   '/plant/enable first' in process.printed() for process in lab.processes)
    lab.until(refused)
    for process in lab.processes:  # the last with it: no loop runs beside other tests
        assert process.signal(TERM) == 0


@pytest.fixture(scope='module')
def lab(tmp_path_factory):  # behind tests without it, which it would slow down
    """Run a limited plant alone; the test commands it."""
    with Lab(tmp_path_factory.mktemp('safety')) as running:
        running.plant = running.start('plant_node', files=MOTION,
                                      rate=200.0, silence_timeout=1.0, hold_services=[], **LIMITS)
        running.clients = {}
        running.states = running.hear('states')
        running.commands = running.say('commands')
        running.until(lambda: running.states and running.commands.get_subscription_count())
        yield running
        assert running.plant.runs


def test_torque_is_limited_and_ends_and_begins_by_service(lab):
    push(lab, [0.5, 0.02], lambda effort: effort == pytest.approx([0.05, 0.02]))
    assert ask(lab, 'disable').message == 'ZERO'
    push(lab, [0.5, 0.02], lambda effort: effort == [0.0, 0.0])
    assert ask(lab, 'enable').success
    push(lab, [-0.5, 0.02], lambda effort: effort == pytest.approx([-0.05, 0.02]))


def test_an_emergency_stop_lasts_until_reset_and_enable(lab):
    assert 'emergency stop by service' in ask(lab, 'emergency_stop').message
    push(lab, [0.05, 0.02], lambda effort: not any(effort))
    assert not ask(lab, 'enable').success
    assert ask(lab, 'reset').success
    begin = len(lab.states)
    push(lab, [0.05, 0.02], lambda effort: len(lab.states) > begin + 40)
    assert not any(any(state.effort[2:]) for state in lab.states[begin + 1:])
    assert ask(lab, 'enable').success
    push(lab, [0.05, 0.02], any)


def test_a_joint_pushed_beyond_its_range_is_a_fault_and_outward_torque_is_zero_before(lab):
    push(lab, [0.0, 0.4], lambda effort: 'joint2 is at 0.3' in lab.plant.printed())
    assert 'FAULT: joint2 is at 0.3' in lab.plant.printed()
    beyond = [state.effort[3] for before, state in zip(lab.states, lab.states[1:], strict=False)
              if before.position[1] >= 0.3]
    assert beyond and not any(beyond)
    push(lab, [0.0, -0.1], lambda effort: not any(effort))  # latched
