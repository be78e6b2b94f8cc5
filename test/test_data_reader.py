# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A bag becomes a recording, with its phases: by stamp and by name, or with a sentence why not."""

from dataclasses import replace
from pathlib import Path
import re
import shutil
import warnings

from gms_flex_control.data import cdr
from gms_flex_control.data.bag import BagWarning, summarise
from gms_flex_control.data.reader import read_experiment, read_recording
from gms_flex_control.data.recording import Phase, Recording, Topics
from gms_flex_control.data.writer import BagWriter, write_recording
from gms_flex_control.errors import BagError
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

pytestmark = pytest.mark.fast

REAL = Path(__file__).parent / 'data' / 'ros2_bag_record'
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = {'/joint_states': cdr.JOINT_STATE,
         '/effort_controller/commands': cdr.MULTI_ARRAY,
         '/reference': cdr.MULTI_ARRAY}
PERIOD = 2_000_000


def write_bag(path, states, commands=(), references=(), phases=None):
    """Write messages given as (receive time, bytes) on the three topics, and phases on theirs."""
    types = TYPES if phases is None else TYPES | {cdr.PHASE_TOPIC: cdr.MULTI_ARRAY}
    with BagWriter(path, types) as writer:
        for topic, rows in zip(types, (states, commands, references, phases), strict=False):
            for time, data in rows:
                writer.write(topic, time, data)
    return path


def state(k, names=('a', 'b', 'b_motor'), stamp=None):
    """Return state ``k``: position encodes name and sample."""
    stamp = k * PERIOD if stamp is None else stamp
    values = [100 * ord(name[0]) + (50 if name.endswith('motor') else 0) + k for name in names]
    return stamp, cdr.pack_joint_states(names, [stamp], [values], None, [[-v for v in values]])[0]


def make_recording(samples=40):
    rng = np.random.default_rng(3)
    q = rng.normal(size=(6, samples, 2))
    q[2, :, 1] = np.nan
    return Recording(
        joints=('x', 'y'), time=np.arange(samples) * 1e-3, q_link=q[0], dq_link=q[1],
        q_motor=q[2], dq_motor=np.where(np.isnan(q[2]), np.nan, q[3]), tau_motor=q[4],
        command=np.vstack([q[5][:-1], [[np.nan, np.nan]]]),
        reference=rng.normal(size=(samples, 5, 2)), friction_hat=rng.normal(size=(samples, 2)),
        supply=24.0 + 0.1 * rng.normal(size=samples), source='made')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_real_bags_are_read_and_each_command_answers_its_state(storage):
    path = REAL / f'rosbag2_{storage}'
    recording = read_recording(path, topics=Topics(command='/effort_cmd'))
    assert recording.joints == ('motor', 'load')
    # whoever recorded them sent a hundredth of the velocity as the torque
    np.testing.assert_allclose(recording.command[:, 0] * 100, recording.dq_link[:, 0])
    np.testing.assert_array_equal(recording.tau_motor, [[1.0, 2.0]] * len(recording.time))
    with Reader(path) as reader:
        states = [STORE.deserialize_cdr(data, connection.msgtype)
                  for connection, _, data in reader.messages()
                  if connection.topic == '/joint_states']
    np.testing.assert_array_equal(recording.q_link, [message.position for message in states])


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_summary_of_the_real_bags_equals_their_metadata(storage):
    path = REAL / f'rosbag2_{storage}'
    text = (path / 'metadata.yaml').read_text()
    summary = summarise(path)
    assert summary.count == int(re.search(r'message_count: (\d+)', text)[1])
    assert round(summary.duration * 1e9) == pytest.approx(
        int(re.search(r'nanoseconds: (\d+)', text)[1]), abs=1000)
    assert {topic.name: topic.type_name for topic in summary.topics} == {
        '/effort_cmd': cdr.MULTI_ARRAY, '/joint_states': cdr.JOINT_STATE}
    assert summary.complete
    assert 'joints: motor, load' in summary.text()


def test_a_written_recording_reads_back_equal(tmp_path):
    recording = make_recording()
    write_recording(tmp_path / 'bag', recording, start=7)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        back = read_recording(tmp_path / 'bag')
    assert back.joints == ('x', 'y')
    for name in ('time', 'q_link', 'dq_link', 'q_motor', 'dq_motor', 'tau_motor', 'command',
                 'reference', 'friction_hat', 'supply'):
        np.testing.assert_allclose(getattr(back, name), getattr(recording, name), atol=1e-9)
    assert summarise(tmp_path / 'bag').complete


def test_the_voltage_of_the_supply_may_come_now_and_then(tmp_path):
    """Between two messages a straight line, NaN without any, one number each."""
    recording = replace(make_recording(), supply=np.where(
        np.arange(40) % 10 == 0, 24.0 - 0.01 * np.arange(40), np.nan))
    write_recording(tmp_path / 'bag', recording)
    seen = read_recording(tmp_path / 'bag').supply
    np.testing.assert_allclose(seen[:31], 24.0 - 0.01 * np.arange(31), atol=1e-9)
    np.testing.assert_allclose(seen[31:], 23.7)
    write_recording(tmp_path / 'without', replace(recording, supply=np.nan))
    assert np.isnan(read_recording(tmp_path / 'without').supply).all()
    with pytest.raises(BagError, match="topic '/reference' message 0 has 10 numbers, expected "
                                       'the voltage of the supply alone'):
        read_recording(tmp_path / 'bag', topics=Topics(supply='/reference', reference='/no'))


@pytest.mark.parametrize('storage, mode', [
    (StoragePlugin.MCAP, CompressionMode.FILE), (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.STORAGE),
    (StoragePlugin.SQLITE3, CompressionMode.FILE),
    (StoragePlugin.SQLITE3, CompressionMode.MESSAGE)])
@pytest.mark.parametrize('with_metadata', [True, False])
def test_zstd_bags_read_the_same(tmp_path, storage, mode, with_metadata):
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer, Reader(REAL / 'rosbag2_mcap') as reader:
        known = {connection.topic: writer.add_connection(
            connection.topic, connection.msgtype, typestore=STORE)
            for connection in reader.connections}
        for connection, time, data in reader.messages():
            writer.write(known[connection.topic], time, data)
    if not with_metadata:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with warnings.catch_warnings():
        warnings.simplefilter('ignore' if not with_metadata else 'error')
        back = read_recording(tmp_path / 'bag', topics=Topics(command='/effort_cmd'))
    original = read_recording(REAL / 'rosbag2_mcap', topics=Topics(command='/effort_cmd'))
    np.testing.assert_array_equal(back.q_link, original.q_link)
    np.testing.assert_array_equal(back.command, original.command)


def test_joints_are_found_by_name_whatever_their_order(tmp_path):
    orders = [('b_motor', 'a', 'b'), ('a', 'b', 'b_motor'), ('b', 'b_motor', 'a')]
    path = write_bag(tmp_path / 'bag', [state(k, orders[k % 3]) for k in range(50)])
    k = np.arange(50.0)
    by_default = read_recording(path)
    assert by_default.joints == ('a', 'b')
    np.testing.assert_array_equal(by_default.q_link, np.column_stack([9700 + k, 9800 + k]))
    np.testing.assert_array_equal(by_default.q_motor[:, 1], 9850 + k)
    assert np.isnan(by_default.q_motor[:, 0]).all() and np.isnan(by_default.dq_link).all()
    # the torque of a joint without motor side is the link's
    np.testing.assert_array_equal(by_default.tau_motor, np.column_stack([-9700 - k, -9850 - k]))
    with pytest.warns(BagWarning, match='has b_motor as well, which this robot has not'):
        chosen = read_recording(path, joints=['b'], motors=['a'])
    np.testing.assert_array_equal(chosen.q_link[:, 0], 9800 + k)
    np.testing.assert_array_equal(chosen.q_motor[:, 0], 9700 + k)


def moving(names, courses):
    """Return states with names, each on a course: sample -> position."""
    return [(k * PERIOD, cdr.pack_joint_states(
        names, [k * PERIOD], [[course(k) for course in courses]], None, None)[0])
        for k in range(100)]


LEFT, RIGHT = (lambda k: np.sin(0.1 * k)), (lambda k: np.sin(0.15 * k))


@pytest.mark.parametrize('links', [('joint1', 'joint2'), ('q 1', 'q 2')])
@pytest.mark.parametrize('courses', [(LEFT, RIGHT), (LEFT, LEFT)])
def test_links_that_the_robot_calls_otherwise_are_not_taken_for_absent(tmp_path, links, courses):
    """By the name of their motors, or because they move with them, all alike or not."""
    springs = [lambda k, course=course: course(k) + 0.02 * np.sin(k) for course in courses]
    motors = ('joint1_motor', 'joint2_motor')
    path = write_bag(tmp_path / 'bag', moving((*links, *motors), (*courses, *springs)))
    with pytest.raises(BagError, match="lacks link 'shoulder', 'elbow' but has "
                       f'{links[0]}, {links[1]}, which the robot does not; rename in `joints`'):
        read_recording(path, ['shoulder', 'elbow'], motors)


@pytest.mark.parametrize('others', [
    {'gripper': RIGHT}, {'rail': lambda k: 0.0}, {'a': LEFT, 'b': LEFT},
    {'joint9': LEFT, 'joint9_motor': LEFT}])
def test_motors_alone_are_read_beside_names_of_other_things(tmp_path, others):
    """A gripper, a thing at rest, more joints on the same course than lack a link, a whole one."""
    path = write_bag(tmp_path / 'bag', moving(('joint1_motor', *others), (LEFT, *others.values())))
    with pytest.warns(BagWarning, match='which this robot has not: left out'):
        recording = read_recording(path, ['joint1'], ['joint1_motor'])
    assert recording.motors_alone.all()


def test_one_joint_of_a_bag_has_its_own_columns_of_commands_and_references(tmp_path):
    """The messages were made for both joints; a robot file may describe but one of them."""
    recording = make_recording()
    write_recording(tmp_path / 'bag', recording)
    for k, name in enumerate(recording.joints):
        with pytest.warns(BagWarning, match=f'has {recording.joints[1 - k]}.* as well'):
            back = read_recording(tmp_path / 'bag', joints=[name])
        np.testing.assert_allclose(back.command[:, 0], recording.command[:, k], atol=1e-9)
        np.testing.assert_allclose(back.reference[..., 0], recording.reference[..., k], atol=1e-9)


def test_states_of_other_machines_on_the_same_topic_are_passed_over(tmp_path):
    states = [state(k) for k in range(20)]
    other = [(k * PERIOD + 5, cdr.pack_joint_states(['gripper'], [k * PERIOD + 5], [[1.0]])[0])
             for k in range(20)]
    mixed = [row for pair in zip(states, other, strict=True) for row in pair]
    recording = read_recording(write_bag(tmp_path / 'bag', mixed))
    assert len(recording.time) == 20


def test_a_command_belongs_to_the_state_whose_stamp_it_carries(tmp_path):
    # each answer arrives three periods late and out of order
    commands = [((k + 3) * PERIOD + 10, cdr.pack_command([k, 0.5], k * PERIOD, 'x'))
                for k in (3, 1, 2, 7)]
    commands.append((9 * PERIOD, cdr.pack_command([99.0, 99.0], 3 * PERIOD)))
    commands.append((9 * PERIOD, cdr.pack_command([99.0, 99.0], 12345)))
    recording = read_recording(write_bag(tmp_path / 'bag', [state(k) for k in range(10)],
                                         commands))
    expected = np.full(10, np.nan)
    expected[[1, 2, 3, 7]] = [1, 2, 3, 7]
    np.testing.assert_array_equal(recording.command[:, 0], expected)


def test_a_plain_command_belongs_to_the_last_state_before_it(tmp_path):
    commands = [(k * PERIOD + 400_000, cdr.pack_command([k, 0.0])) for k in (0, 1, 2, 5)]
    commands.append((11 * PERIOD, cdr.pack_command([77.0, 0.0])))
    recording = read_recording(write_bag(tmp_path / 'bag', [state(k) for k in range(8)], commands))
    np.testing.assert_array_equal(
        recording.command[:, 0], [0, 1, 2, np.nan, np.nan, 5, np.nan, np.nan])


def test_a_reference_between_two_states_is_carried_on_by_its_derivatives(tmp_path):
    def values(t):
        return np.array([[np.sin(t), t**3], [np.cos(t), 3 * t**2], [-np.sin(t), 6 * t],
                         [-np.cos(t), 6.0], [np.sin(t), 0.0]])

    times = [k * PERIOD + 700_000 for k in range(50) if k not in (20, 21, 22, 23, 24)]
    references = [(t, cdr.pack_reference(values(t * 1e-9), t)) for t in times]
    recording = read_recording(write_bag(
        tmp_path / 'bag', [state(k) for k in range(50)], (), references))
    expected = np.array([values(t) for t in recording.time])
    there = ~np.isnan(recording.reference[:, 0, 0])
    assert np.flatnonzero(~there).tolist() == [21, 22, 23]  # further than 1.5 periods away
    np.testing.assert_allclose(recording.reference[there, :2], expected[there, :2], atol=1e-12)


def test_a_torque_reference_is_no_angle(tmp_path):
    references = [(k * PERIOD, cdr.pack_reference([[1.0, 2.0]], k * PERIOD, 'effort'))
                  for k in range(5)]
    recording = read_recording(write_bag(
        tmp_path / 'bag', [state(k) for k in range(5)], (), references))
    assert np.isnan(recording.reference).all()


def test_states_without_stamps_are_placed_by_receive_time(tmp_path):
    recording = read_recording(write_bag(
        tmp_path / 'bag', [(k * PERIOD, state(k, stamp=0)[1]) for k in range(5)]))
    np.testing.assert_allclose(recording.time, np.arange(5) * 2e-3)


def test_messages_without_stamps_among_others_change_nothing_of_these(tmp_path):
    """A state is left out with a warning; a reference serves where none with a stamp is near."""
    def reference(stamp, value):
        return cdr.pack_reference(np.full((5, 2), [[value]] + [[0.0]] * 4), stamp)
    stamps = 10_000_000_000 + PERIOD * np.arange(20)
    states = [(stamp + 300_000, state(k, stamp=stamp)[1]) for k, stamp in enumerate(stamps)]
    states.insert(7, (states[6][0] + 1, state(99, stamp=0)[1]))
    references = [(stamp + 300_000, reference(stamp, float(k)))
                  for k, stamp in enumerate(stamps[:15])]
    references += [(stamp + 300_000, cdr.pack_multi_array(
        [('derivative', 5, 10), ('joint', 2, 2)], [float(-k)] * 2 + [0.0] * 8))
        for k, stamp in enumerate(stamps[15:], 15)]
    path = write_bag(tmp_path / 'bag', states, references=references)
    with pytest.warns(BagWarning, match='has 1 states without a stamp among others: left out'):
        recording = read_recording(path)
    np.testing.assert_array_equal(recording.q_link[:, 0], 9700.0 + np.arange(20))
    np.testing.assert_allclose(recording.reference[:, 0, 0], [
        *range(15), 14, *range(-16, -20, -1)], atol=1e-9)


def test_repeated_stamps_are_taken_once_with_a_warning(tmp_path):
    path = write_bag(tmp_path / 'bag', [state(k) for k in (0, 2, 1, 1, 3)])
    with pytest.warns(BagWarning, match="topic '/joint_states' repeats 1 stamps"):
        recording = read_recording(path)
    np.testing.assert_array_equal(recording.q_link[:, 0], [9700, 9701, 9702, 9703])


GOOD = [state(k) for k in range(5)]
BAD = [
    ({'states': []},
     "has no message on '/joint_states' (topics: /effort_controller/commands, /joint_states, "
     '/reference); record it, or name the topic that has the joint states'),
    ({'states': GOOD[:1]},
     '/joint_states has 1 joint state of these joints; a recording needs at least 2'),
    ({'states': GOOD, 'topics': Topics(joint_states='/js')},
     "has no topic '/js' (topics: /effort_controller/commands, /joint_states, /reference)"),
    ({'states': GOOD, 'joints': ['c']},
     "topic '/joint_states' lacks joint 'c' (has a, b, b_motor); set the names that are there "
     'or record that side as well'),
    ({'states': GOOD, 'joints': ['a'], 'motors': ['a_motor']},
     "topic '/joint_states' lacks joint 'a_motor' (has a, b, b_motor)"),
    ({'states': GOOD, 'joints': ['a', 'b'], 'motors': ['b_motor']},
     '1 motors for 2 joints (a, b); give one each, empty where there is none'),
    ({'states': [*GOOD, state(5, ('a', 'b'))]},
     "topic '/joint_states' message 5 lacks joint 'b_motor' (has a, b)"),
    ({'states': GOOD, 'commands': [(1, cdr.pack_command([1.0, 2.0, 3.0], 0))]},
     "topic '/effort_controller/commands' message 0 has 3 torques for 2 joints (a, b)"),
    ({'states': GOOD, 'commands': [(1, cdr.pack_multi_array([('stamp:soon', 1, 1)], [1.0, 2.0]))]},
     "message 0 has the label 'stamp:soon', expected stamp:<whole nanoseconds>"),
    ({'states': GOOD, 'references': [(1, cdr.pack_reference(np.zeros((5, 3)), 0))]},
     "topic '/reference' message 0 has 15 numbers (derivative 5 x joint 3), expected derivative "
     '5 x joint 2'),
    ({'states': GOOD, 'references': [(1, cdr.pack_reference(np.zeros((6, 2)), 0))]},
     'has 12 numbers (derivative 6 x joint 2), expected derivative 5 x joint 2'),
    ({'states': [*GOOD, (5 * PERIOD, cdr.pack_joint_states(
        ('a', 'b', 'b_motor'), [5 * PERIOD], [[0.0, 0.0, 1e300]], None, None)[0])]},
     "/joint_states has position 1e+300 rad for 'b_motor' at 0.010 s; is it in counts?"),
    ({'states': [*GOOD, (5 * PERIOD, cdr.pack_joint_states(
        ('a', 'b', 'b_motor'), [5 * PERIOD], [[0.0] * 3], None, [[0.0, 0.0, 1e300]])[0])]},
     "/joint_states has effort 1e+300 N m for 'b_motor' at 0.010 s; is it in counts?"),
    ({'states': GOOD, 'commands': [(1, cdr.pack_command([1e300, 2.0], 0))]},
     "/effort_controller/commands has torque 1e+300 N m for 'a' at 0.000 s; is it in counts?"),
    ({'states': [state(k, ('a', 'b', 'b')) for k in range(5)]},
     "topic '/joint_states' names 'b' more than once; who publishes it?"),
    ({'states': [*GOOD, (5 * PERIOD, GOOD[0][1][:60])]},
     "topic '/joint_states' message 5 is cut short: "),
    ({'states': [*GOOD, (5 * PERIOD, b'{"json": 1}')]},
     "topic '/joint_states' message 5 is not plain CDR (begins with '7b 22 6a 73')"),
    ({'states': [*(state(k) for k in range(500)), *GOOD]},
     "topic '/joint_states' goes back from 0.998 s to 0.000 s at message 500: two runs in one "
     'bag? Record each in its own'),
    ({'states': GOOD, 'topics': Topics(command='/joint_states', joint_states='/reference')},
     "topic '/reference' is a std_msgs/msg/Float64MultiArray, expected "
     'sensor_msgs/msg/JointState')]


@pytest.mark.parametrize(('case', 'sentence'), BAD)
def test_what_is_no_recording_is_refused_with_a_sentence(tmp_path, case, sentence):
    path = write_bag(tmp_path / 'bag', case['states'], case.get('commands', ()),
                     case.get('references', ()))
    with pytest.raises(BagError, match=re.escape(sentence)) as caught:
        read_recording(path, case.get('joints'), case.get('motors'), topics=case.get('topics'))
    assert str(caught.value).startswith(f'{path}: ')


@pytest.mark.parametrize('make, sentence', [
    (lambda p: None, 'there is no such bag; give the folder that ros2 bag or gms_flex record'),
    (lambda p: p.mkdir(), 'holds no .mcap or .db3 file; it is not a bag'),
    (lambda p: p.write_text('x'), 'is not a bag file (expected .mcap or .db3, also with .zstd)'),
])
def test_what_is_no_bag_is_refused_with_a_sentence(tmp_path, make, sentence):
    make(tmp_path / 'bag')
    with pytest.raises(BagError, match=re.escape(sentence)):
        read_recording(tmp_path / 'bag')


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
@pytest.mark.parametrize('content, sentence', [
    (b'', 'is empty (0 bytes)'),
    (b'time,position\n' * 9, 'file (begins with 74 69 6d 65 2c 70 6f 73')])
def test_a_file_that_only_looks_like_a_bag_is_refused(tmp_path, suffix, content, sentence):
    (tmp_path / f'bag{suffix}').write_bytes(content)
    with pytest.raises(BagError, match=re.escape(sentence)):
        read_recording(tmp_path / f'bag{suffix}')


def test_a_bag_split_over_files_is_read_in_their_order(tmp_path):
    folder = tmp_path / 'bag'
    folder.mkdir()
    for part in range(11):
        write_bag(tmp_path / 'part', [state(10 * part + k) for k in range(10)])
        shutil.move(tmp_path / 'part' / 'part_0.mcap', folder / f'bag_{part}.mcap')
        shutil.rmtree(tmp_path / 'part')
    with pytest.warns(BagWarning, match='has no metadata.yaml'):
        recording = read_recording(folder)
    np.testing.assert_array_equal(recording.q_link[:, 0], 9700.0 + np.arange(110))


STATES, COMMANDS, _ = TYPES


def packed(stamp, *rest):
    return cdr.pack_phase(Phase(stamp, *rest))


def test_phases_are_read_as_they_were_written_beside_a_recording(tmp_path):
    recording = Recording(time=2e-3 * np.arange(6), joints=('a',), source='x', q_link=0.0,
                          q_motor=0.0, tau_motor=0.0, command=0.0, reference=0.0)
    phases = (Phase(0, 'approach', 'a', 's/approach', 0.0),
              Phase(3_000_000, 'sliding', 'a', 's', 0.1), Phase(12_000_000, 'idle', '', '', 0.0))
    write_recording(tmp_path / 'bag', recording, start=7_000_000_000, phases=phases)
    assert np.array_equal(read_recording(tmp_path / 'bag').time, recording.time)
    both = read_experiment(tmp_path / 'bag')
    assert both[1] == phases
    assert np.array_equal(both[0].time, recording.time)


@pytest.mark.parametrize('message', [
    cdr.pack_multi_array([('stamp:1', 1, 1), ('phase:idle', 1, 1)], [0.0]),
    cdr.pack_multi_array([('phase:x', 1, 1), ('joint:a', 1, 1), ('step:s', 1, 1)], [0.0]),
    cdr.pack_multi_array([], [0.0]),
    packed('soon', 'idle', '', '', 0.0),
    packed(1, 'idle', '', '', 0.0)[:30]])
def test_a_message_that_is_no_phase_is_named(message, tmp_path):
    bag = write_bag(tmp_path / 'bag', GOOD, phases=[
        (20, packed(1, 'idle', '', '', 0.0)), (20, message)])
    with pytest.raises(BagError, match="topic '/identification/phase' message 1 "):
        read_experiment(bag)


def test_a_recording_made_in_a_namespace_is_found(tmp_path):
    """Two loops in one bag leave open which is meant."""
    def loop(space):
        return {f'{space}{STATES}': cdr.JOINT_STATE, f'{space}{cdr.PHASE_TOPIC}': cdr.MULTI_ARRAY,
                f'{space}/robot{STATES}': cdr.JOINT_STATE, f'{space}{COMMANDS}': cdr.MULTI_ARRAY}

    def filled(path, topics):
        with BagWriter(path, topics) as writer:
            for k in range(5):
                stamp = 5_000_000_000 + k * 2_000_000
                state = cdr.pack_joint_states(('a',), [stamp], [[0.1 * k]], [[0.0]])[0]
                writer.write(next(iter(topics)), 10 + k, state)
            writer.write(list(topics)[1], 20, packed(5_002_000_000, 'idle', '', '', 0.0))
        return path

    bag = filled(tmp_path / 'one', loop('/left'))
    assert np.allclose(read_recording(bag).q_link[:, 0], 0.1 * np.arange(5))
    assert [phase.time_ns for phase in read_experiment(bag)[1]] == [2_000_000]
    both = filled(tmp_path / 'two', loop('/left') | loop('/right'))
    with pytest.raises(BagError, match="has no topic '/joint_states' .topics: "):
        read_recording(both)
