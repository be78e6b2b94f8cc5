# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""SIGINT and SIGTERM to each node while the arm moves and the machine is busy."""

import signal
import sys
import time

from gms_flex_control.nodes.faults.rigs import Loop

_SIGNALS = ((signal.SIGINT,), (signal.SIGTERM,), (signal.SIGINT, signal.SIGTERM))
_BUSY = 'while True: pass'


def try_signals(bench, tries, tally):
    """End the nodes one after the other beside a process that takes all it gets."""
    for k in range(tries):
        with bench.another() as other:
            other.run([sys.executable, '-c', _BUSY], 'busy')
            _try_signal(other, _SIGNALS[k % len(_SIGNALS)], tally)


def _try_signal(bench, numbers, tally):
    loop = Loop(bench)
    tally.tries += 1
    _end(loop.controller, numbers, tally)
    loop.run(0.2)  # what was sent before the end has now come
    last = loop.commands[-1]
    tally.expect(not any(last.data), f'the last command is {list(last.data)}')
    tally.expect(not loop.moves(), 'the arm is still moved')
    _end(loop.trajectory, numbers, tally)
    _end(loop.plant, numbers, tally)


def _end(node, numbers, tally):
    begin = time.monotonic()
    code = node.signal(*numbers)
    tally.figure(time.monotonic() - begin)
    tally.expect(code == 0, f'{node.log.stem} ended with exit code {code}')
    tally.expect('Traceback' not in node.printed(), f'{node.log.stem} printed a traceback')
