# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Killed, cut and flipped bags: what is sound comes back, what is gone is named."""

import json
from pathlib import Path
import re
import shutil
import sqlite3
import struct

from gms_flex_control.cli.main import main
from gms_flex_control.data import cdr
from gms_flex_control.data.bag import Bag, BagWarning, summarise
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.writer import BagWriter
from gms_flex_control.errors import BagError
import numpy as np
import pytest

REAL = Path(__file__).parent / 'data' / 'ros2_bag_record'
COUNT = 300


def write_bag(path):
    """Write a bag in chunks; return its file."""
    types = {'/joint_states': cdr.JOINT_STATE, '/clock': 'rosgraph_msgs/msg/Clock'}
    with BagWriter(path, types, chunk_size=4000, flush_period=10.0) as writer:
        for k in range(COUNT):
            writer.write('/joint_states', k, cdr.pack_joint_states(['a'], [k * 10**6], [[k]])[0])
            if k % 3 == 0:
                writer.write('/clock', k, struct.pack('<4siI', cdr.LITTLE_ENDIAN, k, 0))
    return path / f'{path.name}_0.mcap'


def contents(path):
    bag = Bag(path)
    found = [message for batch in bag.batches() for message in batch]
    return found, bag


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return the bytes of a sound bag file and its messages."""
    path = tmp_path_factory.mktemp('whole') / 'bag'
    file = write_bag(path)
    return file.read_bytes(), contents(path)[0]


def killed(raw):
    """Return what the file held before its recorder could close it."""
    with_end = raw.rindex(b'\x0f\x04\0\0\0\0\0\0\0')
    return raw[:raw.rindex(b'rosbag2', 0, with_end) - 13]


def is_part_of(found, original):
    """Return whether ``found`` is ``original`` with some messages left out."""
    rest = iter(original)
    return all(message in rest for message in found)


@pytest.mark.parametrize('fraction', [0.1, 0.3, 0.5, 0.77, 0.9, 0.97, 0.999])
@pytest.mark.parametrize('metadata', [True, False])
def test_a_file_cut_off_anywhere_gives_all_that_came_before(tmp_path, fraction, metadata):
    file = write_bag(tmp_path / 'bag')
    original, raw = contents(tmp_path / 'bag')[0], file.read_bytes()
    left = raw[:int(fraction * len(raw))]
    file.write_bytes(left)
    if not metadata:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    found, bag = contents(tmp_path / 'bag')
    assert found == original[:len(found)]
    # the next message is not in what is left of the file
    following = original[len(found)][3] if len(found) < len(original) else None
    assert following is None or left.count(following) == sum(m[3] == following for m in found)
    assert not bag.complete and bag.notes


@pytest.mark.parametrize('end', ['closed', 'killed'])
def test_flipped_bits_never_change_data_and_never_lose_any_in_silence(tmp_path, whole, end):
    raw, original = whole
    raw = raw if end == 'closed' else killed(raw)
    file = tmp_path / 'bag_0.mcap'
    rng = np.random.default_rng(5)
    places = np.unique(np.concatenate([
        np.arange(60), rng.integers(0, len(raw), 250), len(raw) - 1 - np.arange(60)]))
    for place in places.tolist():
        flipped = bytearray(raw)
        flipped[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(flipped)
        try:
            found, bag = contents(file)
        except BagError as error:
            assert 'is not an mcap file' in str(error)
            continue
        assert is_part_of(found, original), place
        assert len(found) == len(original) or bag.damage or bag.notes, place


def test_a_damaged_chunk_is_named_and_left_out(tmp_path, capsys):
    file = write_bag(tmp_path / 'bag')
    original, raw = contents(tmp_path / 'bag')[0], bytearray(file.read_bytes())
    raw[len(raw) // 2] ^= 8
    file.write_bytes(raw)
    pattern = r'bag_0\.mcap: chunk (\d+) \(at byte \d+\) fails its checksum and is left out'
    with pytest.warns(BagWarning, match=pattern):
        assert COUNT - 60 < len(read_recording(tmp_path / 'bag').time) < COUNT - 10
    assert main(['info', str(tmp_path / 'bag'), '--json']) == 1
    summary = json.loads(capsys.readouterr().out)
    assert int(re.match(pattern, summary['damage'][0])[1]) > 1
    assert len(original) - 60 < summary['count'] < len(original) - 10


def test_a_bad_first_chunk_does_not_cost_the_topics(tmp_path):
    file = write_bag(tmp_path / 'bag')
    raw = bytearray(file.read_bytes())
    raw[raw.index(b'float64[] position')] ^= 1
    file.write_bytes(raw)
    found, bag = contents(tmp_path / 'bag')
    assert {message[0] for message in found} == {'/joint_states', '/clock'}
    assert len(bag.damage) == 1 and len(found) < COUNT + COUNT // 3


def test_a_real_bag_without_checksums_survives_a_cut_and_lost_metadata(tmp_path):
    shutil.copytree(REAL / 'rosbag2_mcap', tmp_path / 'bag')
    original, _ = contents(REAL / 'rosbag2_mcap')
    file = tmp_path / 'bag' / 'rosbag2_mcap_0.mcap'
    file.write_bytes(file.read_bytes()[:50_000])
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    found, bag = contents(tmp_path / 'bag')
    assert 400 < len(found) < 830 and found == original[:len(found)]
    for words in (f'ends without its index after {len(found)} messages', 'has no metadata.yaml'):
        assert words in ' '.join(bag.notes)


def test_a_damaged_sqlite3_says_that_something_is_missing(tmp_path):
    shutil.copytree(REAL / 'rosbag2_sqlite3', tmp_path / 'bag')
    file = tmp_path / 'bag' / 'rosbag2_sqlite3_0.db3'
    raw = bytearray(file.read_bytes())
    page = 4096
    raw[20 * page:24 * page] = bytes(4 * page)
    file.write_bytes(raw)
    found, bag = contents(tmp_path / 'bag')
    assert len(found) < 914 and 'cannot be read whole' in bag.damage[0]
    assert is_part_of(found, contents(REAL / 'rosbag2_sqlite3')[0])


def test_sqlite3_of_a_killed_recorder_gives_what_it_had_committed(tmp_path):
    folder = tmp_path / 'bag'
    folder.mkdir()
    shutil.copy(REAL / 'rosbag2_sqlite3' / 'rosbag2_sqlite3_0.db3', tmp_path / 'live.db3')
    database = sqlite3.connect(tmp_path / 'live.db3')
    database.execute('PRAGMA journal_mode = WAL')
    database.execute('INSERT INTO messages (topic_id, timestamp, data) '
                     'SELECT topic_id, timestamp, data FROM messages')
    database.commit()
    for end in ('', '-wal'):  # as a kill would leave them
        shutil.copy(tmp_path / f'live.db3{end}', folder / f'bag_0.db3{end}')
    database.close()
    found, bag = contents(folder)
    assert len(found) == 2 * 914
    assert any('was left open by its recorder' in note for note in bag.notes)


def test_metadata_that_announces_more_than_there_is_is_damage(tmp_path):
    write_bag(tmp_path / 'bag')
    path = tmp_path / 'bag' / 'metadata.yaml'
    path.write_text(path.read_text().replace('message_count: 400', 'message_count: 410'))
    assert summarise(tmp_path / 'bag').damage == (
        'bag: metadata.yaml announces 410 messages, 400 were found',)


@pytest.mark.parametrize('text', ['', 'a: [1', 'rosbag2_bagfile_information: 7', '\0'])
def test_a_bag_is_read_without_broken_metadata(tmp_path, text):
    write_bag(tmp_path / 'bag')
    (tmp_path / 'bag' / 'metadata.yaml').write_text(text)
    found, bag = contents(tmp_path / 'bag')
    assert len(found) == 400 and 'is not the metadata of a bag' in bag.notes[0]


def test_a_missing_part_of_a_bag_is_damage(tmp_path):
    shutil.copytree(REAL / 'rosbag2_mcap', tmp_path / 'bag')
    path = tmp_path / 'bag' / 'metadata.yaml'
    path.write_text(path.read_text().replace(
        '  - rosbag2_mcap_0.mcap', '  - rosbag2_mcap_0.mcap\n    - rosbag2_mcap_1.mcap', 1))
    with pytest.warns(BagWarning, match='rosbag2_mcap_1.mcap is missing'):
        read_recording(tmp_path / 'bag')
