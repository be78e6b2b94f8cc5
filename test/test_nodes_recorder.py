# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""`gms_flex record` as a process; what kill -9 and a full disk leave: bench/test/test_faults."""

import signal
import time

from gms_flex_control.data.bag import Bag, summarise
from gms_flex_control.data.cdr import unpack_joint_state
from gms_flex_control.experiment.driven import executable
from node_harness import Lab, stamp_of, STATES
import pytest


@pytest.fixture(scope='module')
def lab(tmp_path_factory):
    """Run a plant at 500 Hz, which publishes what is recorded."""
    with Lab(tmp_path_factory.mktemp('recorder')) as running:
        running.heard = running.hear('states')
        running.start('plant_node', rate=500.0)
        running.until(lambda: running.heard)
        yield running


def record(lab, out, *options):
    """Start a recorder."""
    return lab.run([*executable('gms_flex'), 'record', '--out', str(out), *options],
                   f'record{len(list(lab.folder.iterdir()))}')


@pytest.mark.parametrize(('number', 'options'), [
    (signal.SIGINT, ['--all']), (signal.SIGTERM, ['--topics', 'joint_states'])])
def test_a_signal_closes_the_bag_and_exits_0(lab, tmp_path, number, options):
    before = time.time_ns()
    recorder = record(lab, tmp_path / 'bag', *options)
    lab.until(lambda: f'subscribed to {STATES} (sensor_msgs/msg/JointState' in recorder.printed())
    last = stamp_of(lab.more(lab.heard, 200)[-1])
    assert recorder.signal(number) == 0
    summary = summarise(tmp_path / 'bag')
    assert summary.complete
    assert f'{tmp_path / "bag"}: {summary.count} messages\n' in recorder.printed()
    stamps = [unpack_joint_state(data)[0] for batch in Bag(tmp_path / 'bag').batches()
              for topic, _, _, data in batch if topic == STATES]
    assert stamps[-1] >= last
    # receive times are those of the system clock
    assert before * 1e-9 < summary.start < time.time()


def test_a_topic_that_nobody_publishes_is_named(lab, tmp_path):
    recorder = record(lab, tmp_path / 'bag', '--topics', '/nobody', '--duration', '0.5')
    assert recorder.wait() == 1
    for sentence in ("not recorded: topic '/nobody' never had a publisher", ': 0 messages',
                     'nothing was received'):
        assert sentence in recorder.printed()
