# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Bags written here are read by the libraries of others, and carry the hashes of ROS."""

from contextlib import nullcontext
import errno
from importlib import import_module
import json
import os
from pathlib import Path
import re
import struct

from gms_flex_control.data import cdr
from gms_flex_control.data.writer import BagWriter
from gms_flex_control.errors import BagError
from gms_flex_control.file_io import atomic_path, write_text, written_together
from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from ruamel.yaml import YAML

pytestmark = pytest.mark.fast

REAL = Path(__file__).parent / 'data' / 'ros2_bag_record'
STORE = get_typestore(Stores.ROS2_JAZZY)
CLOCK = 'rosgraph_msgs/msg/Clock'
NAMES = ('joint1', 'joint2', 'joint1_motor')
TYPES = {'/joint_states': cdr.JOINT_STATE, '/commands': cdr.MULTI_ARRAY,
         '/clock': CLOCK}


def pack_clock(stamp):
    return struct.pack('<4siI', cdr.LITTLE_ENDIAN, *divmod(stamp, 10**9))


def write_three_topics(path, count=50, **options):
    """Write ``count`` messages on three topics; return them as (topic, time, bytes)."""
    written = []
    values = np.random.default_rng(1).normal(size=(count, 3))
    with BagWriter(path, TYPES, **options) as writer:
        for k, row in enumerate(values):
            time = 10**18 + k * 2_000_000
            for topic, data in (
                    ('/joint_states', cdr.pack_joint_states(
                        NAMES, [time], [row], [row + 1], [row * 2])[0]),
                    ('/commands', cdr.pack_command(row[:2].tolist(), time, 'test')),
                    ('/clock', pack_clock(time))):
                writer.write(topic, time, data)
                written.append((topic, time, data))
    return written


def read_by_mcap(path):
    file = next(path.glob('*.mcap'))
    with open(file, 'rb') as stream:
        return [(channel.topic, message.log_time, message.data) for _, channel, message in
                make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)]


def test_rosbags_and_mcap_read_the_same_messages_that_were_written(tmp_path):
    written = write_three_topics(tmp_path / 'bag')
    with Reader(tmp_path / 'bag') as reader:
        by_rosbags = [(connection.topic, time, bytes(data))
                      for connection, time, data in reader.messages()]
        assert {topic: info.msgtype for topic, info in reader.topics.items()} == TYPES
        assert reader.message_count == len(written)
        assert reader.ros_distro == 'jazzy'
    assert sorted(by_rosbags) == sorted(written)
    assert read_by_mcap(tmp_path / 'bag') == written
    assert [file.name for file in sorted((tmp_path / 'bag').iterdir())] == [
        'bag_0.mcap', 'metadata.yaml']


def test_metadata_has_the_keys_the_hashes_and_the_order_of_the_real_recorder(tmp_path):
    path = tmp_path / 'rosbag2_mcap'
    types = {'/joint_states': cdr.JOINT_STATE, '/effort_cmd': cdr.MULTI_ARRAY}
    with BagWriter(path, types):
        pass

    def shape(folder):  # text, for the order of the keys
        text = (folder / 'metadata.yaml').read_text()
        return json.dumps(YAML(typ='safe').load(re.sub(
            r'(nanoseconds\w*|message_count): \d+', r'\1: 0', text)))

    assert shape(path) == shape(REAL / 'rosbag2_mcap')


def read_by_others(data, type_name):
    """Return a message as rosbags and rclpy read it, and its bytes as they write them."""
    serialization = pytest.importorskip('rclpy.serialization')
    package, _, name = type_name.split('/')
    from_ros = serialization.deserialize_message(
        data, getattr(import_module(f'{package}.msg'), name))
    decoded = STORE.deserialize_cdr(data, type_name)
    return [decoded, from_ros], [
        data, bytes(serialization.serialize_message(from_ros)),
        bytes(STORE.serialize_cdr(decoded, type_name, little_endian=False))]


@pytest.mark.parametrize('velocity', [None, [3.0, 4.0, np.nan]])
@pytest.mark.parametrize('effort', [None, [5.0, -0.0, np.inf]])
@pytest.mark.parametrize('stamp', [0, 1_795_232_912_665_209_941])
def test_a_packed_joint_state_is_what_two_other_libraries_read(stamp, velocity, effort):
    data = cdr.pack_joint_states(NAMES, [stamp], [[1.0, 2.0, np.pi]], velocity and [velocity],
                                 effort and [effort])[0]
    decoded, written = read_by_others(data, cdr.JOINT_STATE)
    for message in decoded:
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(stamp, 10**9)
        assert tuple(message.name) == NAMES
        np.testing.assert_array_equal(message.position, [1.0, 2.0, np.pi])
        np.testing.assert_array_equal(message.velocity, velocity or [])
        np.testing.assert_array_equal(message.effort, effort or [])
    expected = (stamp, '', NAMES, (1.0, 2.0, np.pi), tuple(velocity or ()), tuple(effort or ()))
    for raw in written:
        np.testing.assert_equal(cdr.unpack_joint_state(raw), expected)


@pytest.mark.parametrize('dims', [[], [('joint', 2, 2), ('stamp:0', 1, 1), ('source:ü', 1, 1)]])
@pytest.mark.parametrize('values', [[], [1.5, -2.5], [np.nan, np.inf]])
def test_a_packed_multi_array_is_what_two_other_libraries_read(dims, values):
    decoded, written = read_by_others(cdr.pack_multi_array(dims, values), cdr.MULTI_ARRAY)
    for message in decoded:
        assert [(d.label, d.size, d.stride) for d in message.layout.dim] == dims
        np.testing.assert_array_equal(message.data, values)
    for raw in written:
        np.testing.assert_equal(cdr.unpack_multi_array(raw), (tuple(dims), tuple(values)))


def test_an_existing_bag_is_never_overwritten(tmp_path):
    written = write_three_topics(tmp_path / 'bag')
    for atomic in (False, True):
        with pytest.raises(BagError, match='exists already; bags are never overwritten'):
            with BagWriter(tmp_path / 'bag', TYPES, atomic=atomic):
                pass
    assert read_by_mcap(tmp_path / 'bag') == written


def test_a_bag_is_closed_whole_when_its_block_fails(tmp_path):
    with pytest.raises(RuntimeError):
        with BagWriter(tmp_path / 'bag', TYPES) as writer:
            writer.write('/clock', 5, pack_clock(5))
            raise RuntimeError
    assert read_by_mcap(tmp_path / 'bag') == [('/clock', 5, pack_clock(5))]
    with Reader(tmp_path / 'bag') as reader:
        assert reader.message_count == 1


def test_an_atomic_bag_appears_whole_or_not_at_all(tmp_path):
    with pytest.raises(RuntimeError):
        with BagWriter(tmp_path / 'bag', TYPES, atomic=True) as writer:
            writer.write('/clock', 5, pack_clock(5))
            raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    written = write_three_topics(tmp_path / 'bag', atomic=True)
    assert [path.name for path in tmp_path.iterdir()] == ['bag']
    assert read_by_mcap(tmp_path / 'bag') == written


@pytest.mark.parametrize('topic, time, sentence', [
    ('/other', 0, "topic '/other' was not announced (has /joint_states, /commands, /clock)"),
    ('/clock', -1, '/clock has the time -1 ns; a bag holds none before 1970')])
def test_a_message_without_a_place_is_refused(tmp_path, topic, time, sentence):
    with BagWriter(tmp_path / 'bag', TYPES) as writer:
        with pytest.raises(BagError, match=re.escape(sentence)):
            writer.write(topic, time, b'')


def test_a_link_stays_a_link_and_what_it_leads_to_is_written(tmp_path):
    (tmp_path / 'there').mkdir()
    target = tmp_path / 'there' / 'robot.yaml'
    target.write_text('old')
    for name, to in (('link', target), ('new', tmp_path / 'there' / 'new.yaml')):
        (tmp_path / name).symlink_to(to)
        with written_together():
            write_text(tmp_path / name, 'written')
        assert (tmp_path / name).is_symlink() and to.read_text() == 'written'
    assert {one.name for one in target.parent.iterdir()} == {'robot.yaml', 'new.yaml'}


@pytest.mark.parametrize('together', [written_together, nullcontext])
def test_a_pipe_is_written_and_not_replaced(tmp_path, together):
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with together():
            write_text(pipe, 'written')
        assert os.read(reader, 100) == b'written' and pipe.is_fifo()
        with pytest.raises(ValueError, match='half-way'), atomic_path(pipe):
            raise ValueError('half-way')
        assert pipe.is_fifo() and list(tmp_path.iterdir()) == [pipe]
    finally:
        os.close(reader)


def test_a_full_disk_leaves_no_file_and_the_error_names_it(tmp_path):
    """The system's error for an open file has no name."""
    path = tmp_path / 'report.html'
    with pytest.raises(OSError, match='No space left') as caught, atomic_path(path) as temporary:
        temporary.write_text('half')
        raise OSError(errno.ENOSPC, 'No space left on device')
    assert caught.value.filename == str(path) and list(tmp_path.iterdir()) == []
