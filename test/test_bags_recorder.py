# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""A live recorder process: killed, interrupted, refused."""

from pathlib import Path
import queue
import signal
import struct
import subprocess
import sys
import threading
import time

from gms_flex_control.data import cdr
from gms_flex_control.data.bag import Bag
from gms_flex_control.data.inspection import repair_bag, summarise
from processes import environment_of
import pytest

# other processes of the machine can delay real nodes beyond any bound
pytestmark = pytest.mark.flaky(reruns=2)

pytest.importorskip('rclpy')

HERE = Path(__file__).parent
PERIOD = 0.002       # of the publisher [s]
PROMISED = 0.2       # what kill -9 may take [s]
PATIENCE = 30.0      # for anything that has to start [s]
RECORD = """if True:
    import sys
    from gms_flex_control.cli.main import build_parser
    from gms_flex_control.errors import GmsFlexError
    args = build_parser().parse_args(sys.argv[1:])
    try:
        sys.exit(args.run(args))
    except GmsFlexError as error:
        sys.exit(f'refused: {error}')
"""


@pytest.fixture(scope='module')
def environment():
    take_domain = pytest.importorskip('bench.faults.node_bench').take_domain
    domain, lock = take_domain()
    with lock:
        yield environment_of(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')


@pytest.fixture(params=['reliable', 'best_effort'], scope='module')
def last_stamp(request, environment, tmp_path_factory):
    """Run a publisher at 500 Hz; yield a function that returns its last stamp [ns]."""
    shared = tmp_path_factory.mktemp('stamp') / 'last'
    shared.write_bytes(bytes(8))
    publisher = subprocess.Popen(
        [sys.executable, str(HERE / 'bags_publisher.py'), str(shared), request.param],
        env=environment)
    try:
        yield lambda: struct.unpack('<Q', shared.read_bytes())[0]
    finally:
        publisher.kill()
        publisher.wait()


class Recording:
    """A recorder process whose output is read as it comes."""

    def __init__(self, environment, out, *options):
        self.process = subprocess.Popen(
            [sys.executable, '-c', RECORD, 'record', '--out', str(out), *options],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.file = out / f'{out.name}_0.mcap'
        self._lines = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self._lines.put(line)
        self._lines.put(None)

    def wait_for(self, text):
        """Return the first line that holds ``text``, fail if none comes in time."""
        seen, end = [], time.monotonic() + PATIENCE
        while (left := end - time.monotonic()) > 0:
            try:
                line = self._lines.get(timeout=left)
            except queue.Empty:
                break
            if line is None:
                break
            seen.append(line)
            if text in line:
                return line
        raise AssertionError(f'{text!r} never came: {seen}')

    def grow_by(self, size):
        """Wait until the bag file has grown by ``size`` bytes."""
        end, goal = time.monotonic() + PATIENCE, self.file.stat().st_size + size
        while self.file.stat().st_size < goal:
            assert time.monotonic() < end and self.process.poll() is None, (
                self.file.stat().st_size, list(self._lines.queue))
            time.sleep(0.005)

    def finish(self):
        """Return the exit code, the process gone."""
        return self.process.wait(timeout=PATIENCE)


@pytest.fixture
def start(environment, tmp_path):
    """Yield a function that starts a recorder; none outlives the test."""
    running = []

    def start_one(*options, out=tmp_path / 'bag'):
        running.append(Recording(environment, out, *options))
        return running[-1]

    yield start_one
    for recording in running:
        recording.process.kill()
        recording.process.wait()


def states_in(path):
    return [cdr.unpack_joint_state(data) for batch in Bag(path).batches()
            for _, _, _, data in batch]


def test_kill_9_loses_no_more_than_promised_and_repair_restores(start, last_stamp, tmp_path):
    recording = start('--topics', 'joint_states')
    recording.wait_for('recording /joint_states')
    recording.grow_by(60_000)
    published = last_stamp()
    recording.process.send_signal(signal.SIGKILL)
    recording.finish()
    states = states_in(tmp_path / 'bag')
    assert (published - states[-1][0]) * 1e-9 <= PROMISED + PERIOD
    result = repair_bag(tmp_path / 'bag')
    assert result.kept == len(states) and result.lost == 0
    assert states_in(tmp_path / 'bag_repaired') == states
    counters = [int(state[3][0]) for state in states]
    assert counters == list(range(counters[0], counters[0] + len(counters)))  # none left out
    assert summarise(tmp_path / 'bag_repaired').complete


def test_a_signal_closes_the_bag_and_exits_0(start, last_stamp, tmp_path, request):
    number = signal.SIGINT if 'reliable' in request.node.name else signal.SIGTERM
    before = time.time_ns()
    recording = start('--all')
    recording.wait_for('subscribed to /joint_states (sensor_msgs/msg/JointState')
    recording.grow_by(30_000)
    published = last_stamp()
    recording.process.send_signal(number)
    total = recording.wait_for('messages')
    assert recording.finish() == 0
    summary = summarise(tmp_path / 'bag')
    assert summary.complete and summary.checksums == 'hold'
    assert total == f'{tmp_path / "bag"}: {summary.count} messages\n'
    assert states_in(tmp_path / 'bag')[-1][0] >= published
    # receive times are those of the system clock
    assert before * 1e-9 < summary.start < time.time()


def test_a_topic_that_never_comes_is_named_when_the_time_is_up(start):
    recording = start('--topics', '/nobody', '--duration', '0.5')
    recording.wait_for("not recorded: topic '/nobody' never had a publisher")
    recording.wait_for(': 0 messages')
    recording.wait_for('nothing was received')
    assert recording.finish() == 1


@pytest.mark.parametrize('options, sentence', [
    (('--topics', '/a'), 'exists already; bags are never overwritten'),
    (('--topics', '/a', '--duration', 'nan'),
     'refused: --duration nan: must be at least 0.001 and finite'),
    ((), 'one of the arguments --topics --all is required')])
def test_what_cannot_be_recorded_is_refused(start, tmp_path, options, sentence):
    (tmp_path / 'there').mkdir()
    recording = start(*options, out=tmp_path / 'there')
    recording.wait_for(sentence)
    assert recording.finish() != 0
    assert list((tmp_path / 'there').iterdir()) == []
