# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Recordings whose recorder is killed or has no room, and files that are cut, flipped or bare."""

from itertools import pairwise
import random
import signal
import sys
import time

from bench.faults.node_bench import STATES
from bench.faults.rigs import PERIOD, RATE
from bench.faults.wire import stamp_of
from gms_flex_control.data.bag import Bag
from gms_flex_control.data.cdr import unpack_joint_state
from gms_flex_control.errors import BagError
from gms_flex_control.experiment.driven import executable
from sensor_msgs.msg import JointState

_RECORDED = 1.0      # [s]
_ROOM = 60_000       # on the disk that is full [bytes]
_SEED = 7
_FULL = ('import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); '
         f'resource.setrlimit(resource.RLIMIT_FSIZE, ({_ROOM}, {_ROOM})); '
         'from gms_flex_control.cli.main import main; sys.exit(main(sys.argv[1:]))')


def try_bags(bench, tries, tally):
    """Record a plant, damage what was recorded in every way in turn, and read what is left."""
    bench.start('plant_node', rate=RATE)
    states = bench.listen(JointState, STATES)
    bench.until(lambda: len(states) > 10)
    cases = (_killed, _full, _truncated, _flipped, _bare)
    for k in range(tries):
        tally.tries += 1
        cases[k % len(cases)](bench, bench.folder / f'bag{k}', states, tally)


def _record(bench, out, states, command=None):
    process = bench.run([*(command or executable('gms_flex')), 'record', '--topics', STATES,
                         '--out', str(out)], f'record_{out.name}')
    bench.until(lambda: 'subscribed to' in process.printed() or not process.runs)
    begin = time.monotonic()
    bench.until(lambda: time.monotonic() > begin + _RECORDED or not process.runs)
    return process


def _sound(bench, out, states):
    """Return the storage file and the number of messages of a bag that was closed."""
    _record(bench, out, states).signal(signal.SIGINT)
    return next(out.glob('*.mcap')), len(_stamps(out))


def _stamps(path):
    return [unpack_joint_state(data)[0] for batch in Bag(path).batches()
            for _, _, _, data in batch]


def _killed(bench, out, states, tally):
    process = _record(bench, out, states)
    process.kill()
    last = stamp_of(states[-1])
    kept = _stamps(out)
    tally.figure((last - kept[-1]) / 1e9)
    tally.expect(_gapless(kept), 'messages are missing before the end')


def _full(bench, out, states, tally):
    process = _record(bench, out, states, [sys.executable, '-c', _FULL])
    code = process.wait()
    tally.expect(code == 2 and 'Traceback' not in process.printed(),
                 f'on a full disk the recorder ended with {code}')
    tally.expect(_gapless(_stamps(out)), 'messages are missing after a full disk')


def _truncated(bench, out, states, tally):
    file, count = _sound(bench, out, states)
    file.write_bytes(file.read_bytes()[:int(0.6 * file.stat().st_size)])
    bag = Bag(out)
    found = sum(map(len, bag.batches()))
    tally.expect(0 < found < count and bag.notes, 'a cut bag was not noticed')
    tally.expect(_gapless(_stamps(out)), 'a cut bag lost messages before the cut')


def _flipped(bench, out, states, tally):
    file, count = _sound(bench, out, states)
    whole, rng = file.read_bytes(), random.Random(_SEED)
    for _ in range(10):
        spoilt = bytearray(whole)
        spoilt[rng.randrange(8, len(whole) - 8)] ^= 1 << rng.randrange(8)
        file.write_bytes(spoilt)
        try:
            bag = Bag(out)
            found = sum(map(len, bag.batches()))
            tally.expect(found == count or bag.damage or bag.notes,
                         f'{count - found} messages went missing in silence')
        except BagError:
            pass  # refused in a sentence


def _bare(bench, out, states, tally):
    _, count = _sound(bench, out, states)
    (out / 'metadata.yaml').unlink()
    kept = len(_stamps(out))
    tally.expect(kept == count, f'{count - kept} messages lost with metadata.yaml')


def _gapless(stamps):
    return all(later - sooner == PERIOD for sooner, later in pairwise(stamps))
