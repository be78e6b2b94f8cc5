# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The phases of an experiment, read from its bag."""

from gms_flex_control.data import cdr
from gms_flex_control.data.reader import read_experiment, read_recording
from gms_flex_control.data.recording import Phase, Recording
from gms_flex_control.data.writer import BagWriter, write_recording
from gms_flex_control.errors import BagError
import numpy as np
import pytest

pytestmark = pytest.mark.fast

STATES, COMMANDS = '/joint_states', '/effort_controller/commands'


def written(path, messages, kind=cdr.MULTI_ARRAY):
    """Write joint states from 5 s on and messages of the phase topic."""
    with BagWriter(path, {STATES: cdr.JOINT_STATE, cdr.PHASE_TOPIC: kind}) as writer:
        for k in range(5):
            stamp = 5_000_000_000 + k * 2_000_000
            writer.write(STATES, 10 + k, cdr.pack_joint_state(('a',), stamp, (0.0,)))
        for data in messages:
            writer.write(cdr.PHASE_TOPIC, 20, data)
    return path


def packed(stamp, *rest):
    return cdr.pack_phase(Phase(stamp, *rest))


def test_phases_count_from_the_first_sample_in_the_order_of_time(tmp_path):
    bag = written(tmp_path / 'bag', [
        packed(5_006_000_000, 'idle', '', '', 0.0),
        packed(5_002_000_000, 'sliding', 'a', 'sliding/a/+0.1:x', -0.1)])
    assert read_experiment(bag)[1] == (
        Phase(2_000_000, 'sliding', 'a', 'sliding/a/+0.1:x', -0.1),
        Phase(6_000_000, 'idle', '', '', 0.0))


def test_phases_are_read_as_they_were_written_beside_a_recording(tmp_path):
    recording = Recording(time=2e-3 * np.arange(6), joints=('a',), source='x', q_link=0.0,
                          q_motor=0.0, tau_motor=0.0, command=0.0, reference=0.0)
    phases = (Phase(0, 'approach', 'a', 's/approach', 0.0), Phase(3_000_000, 'sliding', 'a', 's',
                                                                  0.1),
              Phase(12_000_000, 'idle', '', '', 0.0))
    write_recording(tmp_path / 'bag', recording, start=7_000_000_000, phases=phases)
    assert np.array_equal(read_recording(tmp_path / 'bag').time, recording.time)
    both = read_experiment(tmp_path / 'bag')
    assert both[1] == phases
    assert np.array_equal(both[0].time, recording.time)


def test_a_bag_without_the_topic_has_no_phases(tmp_path):
    assert read_experiment(written(tmp_path / 'bag', []))[1] == ()


@pytest.mark.parametrize('message', [
    cdr.pack_multi_array([('stamp:1', 1, 1), ('phase:idle', 1, 1)], [0.0]),
    cdr.pack_multi_array([('phase:x', 1, 1), ('joint:a', 1, 1), ('step:s', 1, 1)], [0.0]),
    cdr.pack_multi_array([], [0.0]),
    packed('soon', 'idle', '', '', 0.0),
    packed(1, 'idle', '', '', 0.0)[:30]])
def test_a_message_that_is_no_phase_is_named(message, tmp_path):
    bag = written(tmp_path / 'bag', [packed(1, 'idle', '', '', 0.0), message])
    with pytest.raises(BagError, match="topic '/identification/phase' message 1 "):
        read_experiment(bag)


def test_another_type_on_the_topic_is_refused(tmp_path):
    state = cdr.pack_joint_state(('a',), 1, (0.0,))
    bag = written(tmp_path / 'bag', [state], kind=cdr.JOINT_STATE)
    with pytest.raises(BagError, match="topic '/identification/phase' is a "
                                       'sensor_msgs/msg/JointState, expected std_msgs'):
        read_experiment(bag)


def test_a_recording_made_in_a_namespace_is_found(tmp_path):
    """Two loops in one bag leave no telling which is meant."""
    def loop(space):
        return {f'{space}{STATES}': cdr.JOINT_STATE, f'{space}{cdr.PHASE_TOPIC}': cdr.MULTI_ARRAY,
                f'{space}/robot{STATES}': cdr.JOINT_STATE, f'{space}{COMMANDS}': cdr.MULTI_ARRAY}

    def filled(path, topics):
        with BagWriter(path, topics) as writer:
            for k in range(5):
                stamp = 5_000_000_000 + k * 2_000_000
                state = cdr.pack_joint_state(('a',), stamp, (0.1 * k,), (0.0,))
                writer.write(next(iter(topics)), 10 + k, state)
            writer.write(list(topics)[1], 20, packed(5_002_000_000, 'idle', '', '', 0.0))
        return path

    bag = filled(tmp_path / 'one', loop('/left'))
    assert np.allclose(read_recording(bag).q_link[:, 0], 0.1 * np.arange(5))
    assert [phase.time_ns for phase in read_experiment(bag)[1]] == [2_000_000]
    both = filled(tmp_path / 'two', loop('/left') | loop('/right'))
    with pytest.raises(BagError, match="has no topic '/joint_states' .topics: "):
        read_recording(both)
