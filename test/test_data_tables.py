# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Messages decoded many at a time are what they are one by one; topics can be chosen."""

from pathlib import Path

from gms_flex_control.data import cdr
from gms_flex_control.data.bag import Bag
from gms_flex_control.data.tables import ArrayTable, JointTable
from gms_flex_control.errors import BagError
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

pytestmark = pytest.mark.fast

REAL = Path(__file__).parent / 'data' / 'ros2_bag_record'
STORE = get_typestore(Stores.ROS2_JAZZY)
KIND = 'std_msgs/msg/Float64MultiArray'


def with_offset(data, offset):
    """Return a Float64MultiArray whose first ``offset`` numbers are none of its data."""
    message = STORE.deserialize_cdr(data, KIND)
    message.layout.data_offset = offset
    return bytes(STORE.serialize_cdr(message, KIND))


ODD = (lambda k: cdr.pack_command([k, -k], 10**18 + k, 'x'), lambda k: cdr.pack_command([k, -k]),
       lambda k: cdr.pack_command([k, -k], 9 * 10**18 + k, 'y'),
       lambda k: with_offset(cdr.pack_multi_array([(f'stamp: {k}_0 ', 1, 1)], [7.0, k, -k]), 1),
       lambda k: cdr.pack_multi_array([(f'n:{k:04d}', 2, 2), (f'stamp:-{k}', 1, 1)], [k, -k]))


def two(_dims, count):
    if count != 2:
        raise BagError(f'has {count}')
    return (2,)


@pytest.mark.parametrize('block', [1, 7, 300])
def test_arrays_read_together_are_those_that_another_library_reads_alone(block):
    rng = np.random.default_rng(5)
    messages = [ODD[rng.integers(len(ODD))](k) for k in range(300)]
    table = ArrayTable((2,), two)
    for k in range(0, 300, block):
        table.add(range(k, min(k + block, 300)), messages[k:k + block])
    alone = [STORE.deserialize_cdr(data, KIND) for data in messages]
    np.testing.assert_array_equal(table.take('values'), [
        message.data[message.layout.data_offset:] for message in alone])
    labels = [[dim.label for dim in message.layout.dim if dim.label.startswith('stamp:')]
              for message in alone]
    np.testing.assert_array_equal(table.take('stamped'), [bool(label) for label in labels])
    np.testing.assert_array_equal(table.take('stamps'), [
        min(int(label[0][6:]), 2**62) if label else 0 for label in labels])
    np.testing.assert_array_equal(table.take('received'), np.arange(300))


def test_the_first_message_that_cannot_be_read_is_named_across_blocks():
    good, bad = cdr.pack_command([1.0, 2.0], 5), cdr.pack_command([1.0, 2.0, 3.0], 5)
    table = ArrayTable((2,), two)
    for block in ([good] * 4, [good, good, bad, good[:-3], bad], [bad]):
        table.add([0] * len(block), block)
    with pytest.raises(BagError, match='^message 6 has 3$'):
        table.take('values')


def test_rows_name_the_message_where_others_are_left_out():
    table = JointTable(('a',), ('effort',))
    for k in range(0, 40, 4):
        names = [('a', 'b') if j % 3 else ('c',) for j in range(k, k + 4)]
        table.add(range(k, k + 4), [cdr.pack_joint_states(
            name, [j], [[j] * len(name)], None, [[2 * j] * len(name)])[0]
            for j, name in enumerate(names, k)])
    rows = [j for j in range(40) if j % 3]
    np.testing.assert_array_equal(table.take('rows'), rows)
    np.testing.assert_array_equal(table.take('stamps'), rows)
    np.testing.assert_array_equal(table.take('effort')[:, 0], 2.0 * np.array(rows))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_is_read_for_one_topic(storage):
    path = REAL / f'rosbag2_{storage}'
    whole, part = Bag(path), Bag(path)
    every = [row for batch in whole.batches() for row in batch]
    chosen = [row for batch in part.batches({'/joint_states'}) for row in batch]
    assert chosen == [row for row in every if row[0] == '/joint_states'] != every
    assert part.complete and part.topics == whole.topics
