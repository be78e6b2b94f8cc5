# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Plant or bridge, controller and trajectory in one process: as three, and to the last bit."""

from pathlib import Path
import struct

from bridge_lab import ask, bridge_lab, move
from gms_flex_control.data.reader import read_recording
from gms_flex_control.experiment.driven import executable, TOPICS
from gms_flex_control.experiment.simulated import read_plan, simulate_to_bag
from gms_flex_control.nodes import messages
from gms_flex_control.nodes.topics import Deserialized, Serialized
from node_harness import (
    array_message,
    COMMANDS,
    CONFIG,
    FILES,
    Float64MultiArray,
    JointState,
    Lab,
    REFERENCE,
    stamp_of,
    STATES,
    TERM,
    traceback_free,
    Trigger,
)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import MultiArrayDimension
from test_nodes_lockstep import assert_equal
from test_nodes_loop import (  # noqa: F401  they hold here as well
    listen,
    RATE,
    test_a_gain_changes_and_a_whole_number_is_taken_for_a_double,
    test_a_group_is_taken_whole_or_not_at_all,
    test_compensation_changes_while_it_moves,
    test_controller_publishes_error_estimate_and_blocks,
    test_effort_of_a_motor_is_the_torque_applied_in_the_sample_before,
    test_joint_states_name_links_then_motors,
    test_reference_and_command_carry_layout_stamp_and_source,
)
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)
MOTION = [*FILES, CONFIG / 'sinusoid.yaml']


def test_lockstep_in_one_process_is_the_simulation_to_the_last_bit(tmp_path):
    with Lab(tmp_path) as lab:
        recorder = lab.run([*executable('gms_flex'), 'record', '--topics', *TOPICS, '--out',
                            str(tmp_path / 'driven')], 'recorder')
        loop = lab.start('loop_node', files=MOTION, trajectory__autostart=True, mode='lockstep',
                         rate=500.0, duration=3.0, wait_for_subscribers=3)
        assert loop.wait() == 0
        assert recorder.signal(TERM) == 0
        assert traceback_free(loop, recorder)
        heard = [line for line in recorder.printed().splitlines() if 'subscribed to' in line]
        assert STATES in heard[-1]  # the plant begins then: every answer is heard by then
    plan = read_plan(MOTION, duration=3.0, overrides={'compensation': 'gms', 'rate': 500.0})
    simulate_to_bag(plan, tmp_path / 'simulated')
    driven, simulated = (read_recording(tmp_path / name, plan.robot.joints, plan.robot.motors)
                         for name in ('driven', 'simulated'))
    assert len(driven.time) == 1500 and np.ptp(driven.q_link[:, 0]) > 0.3  # it moved
    assert_equal(driven, simulated)


@pytest.fixture(scope='module')
def loop(tmp_path_factory):
    """Run the loop in one process, moving along the sinusoid; yield a Lab as test_nodes_loop."""
    with Lab(tmp_path_factory.mktemp('loop')) as lab:
        lab.controller = lab.trajectory = lab.plant = lab.start(
            'loop_node', files=MOTION, rate=RATE, trajectory__autostart=True, silence_timeout=1.0)
        listen(lab)
        yield lab
        assert lab.plant.signal(TERM) == 0
        lab.until(lambda: not any(lab.commands[-1].data))
        assert traceback_free(lab.plant)


def test_each_state_is_answered_once_and_nothing_is_heard_twice(loop):
    loop.more(loop.states, 100)
    stamps = [stamp_of(command) for command in loop.commands
              if any(command.data)]  # zero is sent again where the whole process stood still
    assert len(set(stamps)) == len(stamps) > 100
    assert 'at once' not in loop.plant.printed()  # two controllers, or two trajectories


def test_names_topics_and_services_are_those_of_three_nodes(loop):
    names = {'plant', '_plant_safety', 'cascade_controller', 'trajectory'}
    assert names <= set(loop.node.get_node_names())
    for name, topics in {
            'plant': {STATES}, 'trajectory': {REFERENCE},
            'cascade_controller': {COMMANDS, *(f'/cascade_controller/{what}' for what in (
                'state', 'blocks', 'sticking'))}}.items():
        assert topics <= {topic for topic, _ in
                          loop.node.get_publisher_names_and_types_by_node(name, '/')}
    for name, topics in {'plant': {COMMANDS}, 'trajectory': {STATES},
                         'cascade_controller': {STATES, REFERENCE}}.items():
        assert topics <= {topic for topic, _ in
                          loop.node.get_subscriber_names_and_types_by_node(name, '/')}


def test_services_act_on_the_motion(loop):
    assert loop.call(Trigger, '/trajectory/stop').success
    loop.until(lambda: not any(loop.references[-1].data[2:]))
    assert loop.call(Trigger, '/trajectory/start').success
    loop.until(lambda: any(loop.references[-1].data[2:]))


def test_another_controller_is_noticed(loop):
    """Commands of other processes come by DDS as before."""
    other = loop.speak(Float64MultiArray, COMMANDS)

    def told():
        other.publish(array_message([0.0, 0.0], f'stamp:{stamp_of(loop.states[-1])}',
                                    'source:/other'))
        return '2 controllers command at once' in loop.plant.printed()
    loop.until(told)
    loop.until(lambda: any(loop.states[-1].effort[2:]))  # one is left: torque flows again


def test_a_day_long_motion_beyond_the_limits_is_refused_while_the_loop_goes_on(tmp_path):
    """It is checked where it may bend, without the lock that each sample of the loop takes."""
    arm = Path(__file__).parents[1] / 'examples' / 'light_arm'
    names = [f'joint{j}' for j in range(1, 8)]
    points = [JointTrajectoryPoint(positions=[0.1 * (k % 2)] * 7) for k in range(1, 1001)]
    for k, point in enumerate(points):
        point.time_from_start.sec = 86 * (k + 1)
    points[-1].positions[0] = 50.0
    with Lab(tmp_path) as lab:
        states = lab.listen(JointState, STATES)
        goals = lab.speak(JointTrajectory, '/trajectory/joint_trajectory')
        loop = lab.start('loop_node', files=[arm / 'robot.yaml', arm / 'controller.yaml'])
        lab.until(lambda: states and goals.get_subscription_count())
        goal = JointTrajectory(joint_names=names, points=points)
        lab.until(lambda: goals.publish(goal) or (
            'joint trajectory refused: joint1 goes to 50' in loop.printed()))
        lab.more(states, 10)


def report_after(lab, figure):
    """Return the figures of the plant (dict of int) from the first report that has a figure."""
    values = lab.until(lambda: next((
        values for one in lab.reports
        if figure in (values := {item.key: item.value for item in one.values})), None))
    return {key: int(value) for key, value in values.items() if value.isdigit()}


@pytest.mark.flaky(reruns=5)  # a machine that stands still for 30 ms stops the torque
def test_a_bridge_in_one_process_moves_a_robot_and_leaves_zero(tmp_path):
    with bridge_lab(tmp_path, composed=True) as lab:
        move(lab)
        figures = report_after(lab, 'efforts sent ahead')
        assert figures['efforts sent ahead'] > 0 == figures['efforts corrected']
        assert ask(lab, 'emergency_stop').success
        lab.until(lambda: not any(lab.efforts.last))
        move(lab)
        assert lab.plant.signal(TERM) == 0
        lab.until(lambda: not any(lab.efforts.last))
        assert traceback_free(lab.plant)


def test_a_profile_that_lets_nodes_hear_their_own_process_is_refused(tmp_path):
    profile = tmp_path / 'profile.xml'
    profile.write_text('<dds/>')
    with Lab(tmp_path) as lab:
        lab.environment['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(profile)
        loop = lab.start('loop_node', files=MOTION)
        assert loop.wait() == 2
        assert 'loop_node needs the property fastdds.ignore_local_endpoints' in loop.printed()


def test_a_reused_message_is_serialized_as_it_is_each_time():
    state = JointState(name=['a', 'b'], position=[1.0, 2.0], velocity=[3.0, 4.0],
                       effort=[5.0, 6.0])
    reference = messages.ReferenceWriter(2, '/somebody')
    reference.write(np.zeros((5, 2)), 'motion', 0)
    serialized = Serialized(state), Serialized(reference.message)
    for stamp, rows, quantity in ((0, 5, 'motion'), (1_700_000_000_123_456_789, 5, 'motion'),
                                  (12_000_000_007, 1, messages.EFFORT)):
        messages.set_stamp(state.header.stamp, stamp)
        state.position = messages.array('d', [stamp / 3.0, -0.0])
        state.effort = messages.array('d', [float('inf'), float(rows)])
        reference.write(np.arange(2.0 * rows).reshape(rows, 2) - stamp, quantity, stamp)
        for one, message in zip(serialized, (state, reference.message), strict=True):
            assert deserialize_message(one.data(), type(message)) == message


def test_joint_states_are_read_as_they_are_whatever_came_before():
    read = Deserialized().message
    for names, position, velocity, effort in (
            ('ab', [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]),
            ('ab', [-0.0, 1e300], [3.0, 4.5], [7.0, 6.0]),
            ('xb', [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]), ('ab', [1.0, 2.0], [3.0, 4.0], []),
            ('ab', [1.0, 2.0], [3.0], [5.0, 6.0, 7.0]), ('ab', [], [], []), ('', [], [], []),
            ('ab', [1.0, 2.0], [3.0, 4.0], [5.0, 6.0])):
        message = JointState(name=list(names), position=position, velocity=velocity, effort=effort)
        for stamp in (0, 1_700_000_000_123_456_789):
            messages.set_stamp(message.header.stamp, stamp)
            assert read(serialize_message(message)) == message


def test_messages_of_the_other_byte_order_are_read_beside_ours():
    """Zeros look the same in both orders; what comes behind them must not be taken as they are."""
    arrays, states = Deserialized(Float64MultiArray).message, Deserialized().message
    for values, both in (([0.0, 0.0], False), ([1.0, 0.1], False), ([0.0, 0.0], True),
                         ([1.0, 0.1], True)):
        numbers = struct.pack('>2d', *values)
        array = Float64MultiArray(data=values)
        state = JointState(position=values, velocity=values, effort=values)
        assert arrays(struct.pack('>4x3I4x', 0, 0, 2) + numbers) == array
        assert states(struct.pack('>4x3I4x2I', 0, 0, 1, 0, 2) + numbers
                      + 2 * (struct.pack('>I4x', 2) + numbers)) == state
        if both:
            assert arrays(serialize_message(array)) == array
            assert states(serialize_message(state)) == state


def test_arrays_are_read_as_they_are_whatever_came_before():
    read = Deserialized(Float64MultiArray).message
    for labels, data in (
            (('joint', 'stamp:1000', 'source:/a#1'), [1.0, 2.0]),
            (('joint', 'stamp:2345', 'source:/a#1'), [-0.0, float('inf')]),
            (('joint', 'stamp:23x5', 'source:/a#1'), [1.0, 2.0]),
            (('joint', 'stamp:-234', 'source:/a#1'), [1.0, 2.0]),
            (('joint', 'stamp:2345', 'source:/b#1'), [1.0, 2.0]),
            (('joint', 'stamp:2346', 'source:/b#1'), [1.0, 2.0, 3.0]),
            (('source:stamp:2346', 'stamp:2346'), [1.0, 2.0]),
            (('source:stamp:2347', 'stamp:2346'), [1.0, 2.0]),
            (('stamp:2346', 'stamp:2346'), [1.0]), (('stamp:2347', 'stamp:2346'), [1.0]),
            ((), [1.0]), ((), [2.0]), ((), []), (('stamp:1',), []),
            (('joint', 'stamp:1000', 'source:/a#1'), [1.0, 2.0])):
        for size in (1, 2):
            message = Float64MultiArray(data=data)
            message.layout.dim = [MultiArrayDimension(label=label, size=size, stride=1)
                                  for label in labels]
            assert read(serialize_message(message)) == message
