# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Killed, cut and flipped bags: what is sound comes back, what is gone is counted."""

import json
from pathlib import Path
import re
import shutil
import sqlite3
import struct

from gms_flex_control.cli.main import main
from gms_flex_control.data import cdr
from gms_flex_control.data.bag import Bag, BagWarning
from gms_flex_control.data.inspection import repair_bag, summarise
from gms_flex_control.data.reader import read_recording
from gms_flex_control.data.writer import BagWriter
from gms_flex_control.errors import BagError
from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags.rosbag2 import Reader

REAL = Path(__file__).parent / 'data' / 'ros2_bag_record'
COUNT = 300


def write_bag(path, chunk_size=4000):
    types = {'/joint_states': cdr.JOINT_STATE, '/clock': 'rosgraph_msgs/msg/Clock'}
    with BagWriter(path, types,
                   chunk_size=chunk_size, flush_period=10.0) as writer:
        for k in range(COUNT):
            writer.write('/joint_states', k, cdr.pack_joint_state(['a'], k * 10**6, [k]))
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


def test_a_sound_bag_needs_no_repair(tmp_path):
    write_bag(tmp_path / 'bag')
    result = repair_bag(tmp_path / 'bag')
    assert (result.out, result.lost, result.kept) == ('', 0, COUNT + COUNT // 3)
    assert 'nothing to repair' in result.text()
    assert not (tmp_path / 'bag_repaired').exists()


@pytest.mark.parametrize('fraction', [0.1, 0.3, 0.5, 0.77, 0.9, 0.97, 0.999])
@pytest.mark.parametrize('metadata', [True, False])
def test_a_file_cut_off_anywhere_gives_all_that_came_before(tmp_path, fraction, metadata):
    original = contents_of_new(tmp_path / 'bag')
    file = tmp_path / 'bag' / 'bag_0.mcap'
    raw = file.read_bytes()
    file.write_bytes(raw[:int(fraction * len(raw))])
    if not metadata:
        (tmp_path / 'bag' / 'metadata.yaml').unlink()
    found, bag = contents(tmp_path / 'bag')
    assert found == original[:len(found)]
    with open(tmp_path / 'bag' / 'bag_0.mcap', 'rb') as stream:
        ends = stream.read()
    # the next message is not in what is left of the file
    following = original[len(found)][3] if len(found) < len(original) else None
    assert following is None or ends.count(following) == sum(m[3] == following for m in found)
    assert not bag.complete and (bag.sound or metadata)
    result = repair_bag(tmp_path / 'bag')
    assert result.kept == len(found)
    assert result.lost == (len(original) - len(found) if metadata else 0)
    check_with_others(tmp_path / 'bag_repaired', found)


def contents_of_new(path):
    write_bag(path)
    return contents(path)[0]


def check_with_others(path, expected):
    """Compare a bag with what it must hold, by two other libraries."""
    assert summarise(path).complete and summarise(path).checksums == 'hold'
    with Reader(path) as reader:
        assert sorted((c.topic, t, bytes(d)) for c, t, d in reader.messages()) == sorted(
            (topic, time, data) for topic, time, _, data in expected)
    with open(next(path.glob('*.mcap')), 'rb') as stream:
        assert [(channel.topic, message.log_time, message.publish_time, message.data)
                for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(
                    log_time_order=False)] == expected


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
            assert 'is no mcap file' in str(error)
            continue
        assert is_part_of(found, original), place
        missing = len(original) - len(found)
        lost = [item.lost for item in bag.damage]
        assert missing == 0 or None in lost or sum(lost) == missing, (place, bag.damage)
        if end == 'closed':
            assert bag.damage or bag.notes, place  # every bit of a closed bag is guarded


def test_a_damaged_chunk_is_named_refused_and_repaired_around(tmp_path, capsys):
    original = contents_of_new(tmp_path / 'bag')
    file = tmp_path / 'bag' / 'bag_0.mcap'
    raw = bytearray(file.read_bytes())
    raw[len(raw) // 2] ^= 8
    file.write_bytes(raw)
    pattern = r'bag_0\.mcap: chunk (\d+) \(at byte \d+\): fails its checksum; (\d+) messages lost'
    with pytest.raises(BagError, match=pattern + r"; run 'gms_flex repair .*' to keep the rest"):
        read_recording(tmp_path / 'bag')
    code, printed = run(capsys, 'info', tmp_path / 'bag', '--json')
    assert code == 1
    summary = json.loads(printed)
    number, lost = map(int, re.match(pattern, summary['damage'][0]).groups())
    assert 1 < number and 10 < lost < 60
    assert summary['count'] == len(original) - lost and summary['checksums'] == 'damaged'
    code, printed = run(capsys, 'repair', tmp_path / 'bag', '--out', tmp_path / 'new')
    assert code == 1
    assert f'{len(original) - lost} messages kept, {lost} lost' in printed
    found, _ = contents(tmp_path / 'new')
    assert is_part_of(found, original) and len(found) == len(original) - lost
    check_with_others(tmp_path / 'new', found)


def run(capsys, *arguments):
    code = main([*map(str, arguments)])
    return code, capsys.readouterr().out


def test_a_bad_first_chunk_does_not_cost_the_topics(tmp_path):
    write_bag(tmp_path / 'bag')
    file = tmp_path / 'bag' / 'bag_0.mcap'
    raw = bytearray(file.read_bytes())
    raw[raw.index(b'float64[] position')] ^= 1
    file.write_bytes(raw)
    found, bag = contents(tmp_path / 'bag')
    assert {message[0] for message in found} == {'/joint_states', '/clock'}
    assert [item.lost for item in bag.damage] == [COUNT + COUNT // 3 - len(found)]


def test_a_cut_bag_is_read_with_a_warning(tmp_path):
    file = write_bag(tmp_path / 'bag')
    file.write_bytes(killed(file.read_bytes()))
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    with pytest.warns(BagWarning) as caught:
        assert len(read_recording(tmp_path / 'bag').time) == COUNT
    texts = [str(warning.message) for warning in caught]
    assert any('ends without its index after 400 messages' in text for text in texts)
    assert any('has no metadata.yaml' in text for text in texts)


def test_a_real_bag_without_checksums_survives_a_cut_and_lost_metadata(tmp_path):
    shutil.copytree(REAL / 'rosbag2_mcap', tmp_path / 'bag')
    original, _ = contents(REAL / 'rosbag2_mcap')
    file = tmp_path / 'bag' / 'rosbag2_mcap_0.mcap'
    file.write_bytes(file.read_bytes()[:50_000])
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    result = repair_bag(tmp_path / 'bag')
    assert 400 < result.kept < 830
    assert f'first {result.kept} messages are whole but could not be checked' in result.text()
    check_with_others(tmp_path / 'bag_repaired', original[:result.kept])


def test_sqlite3_without_metadata_becomes_a_sound_bag_with_the_same_messages(tmp_path):
    shutil.copytree(REAL / 'rosbag2_sqlite3', tmp_path / 'bag')
    original, _ = contents(REAL / 'rosbag2_sqlite3')
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    result = repair_bag(tmp_path / 'bag')
    assert (result.kept, result.lost) == (914, 0)
    check_with_others(tmp_path / 'bag_repaired', original)
    hashes = re.compile('RIHS01_[0-9a-f]{64}')
    assert set(hashes.findall((tmp_path / 'bag_repaired' / 'metadata.yaml').read_text())) == set(
        hashes.findall((REAL / 'rosbag2_sqlite3' / 'metadata.yaml').read_text()))


def test_a_damaged_sqlite3_says_how_much_is_missing(tmp_path):
    shutil.copytree(REAL / 'rosbag2_sqlite3', tmp_path / 'bag')
    file = tmp_path / 'bag' / 'rosbag2_sqlite3_0.db3'
    raw = bytearray(file.read_bytes())
    page = 4096
    raw[20 * page:24 * page] = bytes(4 * page)
    file.write_bytes(raw)
    result = repair_bag(tmp_path / 'bag')
    assert 0 < result.kept < 914
    assert result.lost == 914 - result.kept
    original, _ = contents(REAL / 'rosbag2_sqlite3')
    assert is_part_of(contents(tmp_path / 'bag_repaired')[0], original)


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
        'bag: metadata.yaml announces 410 messages, 400 were found; 10 messages lost',)


@pytest.mark.parametrize('text', ['', 'a: [1', 'rosbag2_bagfile_information: 7', '\0'])
def test_broken_metadata_is_written_anew(tmp_path, text):
    write_bag(tmp_path / 'bag')
    (tmp_path / 'bag' / 'metadata.yaml').write_text(text)
    result = repair_bag(tmp_path / 'bag')
    assert (result.kept, result.lost) == (400, 0)
    assert 'is no metadata of a bag' in result.notes[0]


def test_a_missing_part_of_a_bag_is_damage(tmp_path):
    shutil.copytree(REAL / 'rosbag2_mcap', tmp_path / 'bag')
    path = tmp_path / 'bag' / 'metadata.yaml'
    path.write_text(path.read_text().replace(
        '  - rosbag2_mcap_0.mcap', '  - rosbag2_mcap_0.mcap\n    - rosbag2_mcap_1.mcap', 1))
    with pytest.raises(BagError, match='rosbag2_mcap_1.mcap: is missing'):
        read_recording(tmp_path / 'bag')


def test_repair_never_overwrites(tmp_path):
    file = write_bag(tmp_path / 'bag')
    file.write_bytes(killed(file.read_bytes()))
    (tmp_path / 'bag_repaired').mkdir()
    with pytest.raises(BagError, match='bag_repaired: exists already'):
        repair_bag(tmp_path / 'bag')
