# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The fault table: every row that can be tried, and the table filled in."""

from contextlib import nullcontext
from dataclasses import asdict
import json
from pathlib import Path
import tempfile
import time

from bench.faults import bags, clocks, exceptions, lost_nodes, silence, traffic, wrong_messages
from bench.faults.node_bench import Bench
from bench.faults.tally import FAILED, Fault, judged, Tally

_LIMIT = wrong_messages.LIMIT * 1.001  # rounding aside

FAULTS = {fault.name: fault for fault in (
    Fault(name='dead-controller', fault='controller killed or frozen',
          required='no torque within 50 ms, the silence is reported',
          figure='torque ends after', limit=50.0, unit='ms', tries=(4, 20),
          run=lost_nodes.try_dead_controller),
    Fault(name='silence', fault='joint states stop or repeat themselves',
          required='zero after 30 ms (and 20 ms for a busy machine), observer frozen',
          figure='zero commanded after', limit=50.0, unit='ms', tries=(4, 20),
          run=silence.try_silence),
    Fault(name='frozen-encoders', fault='angles stay the same while their stamps go on',
          required='zero once a velocity makes 20 mrad (and 30 ms; 20 ms for a busy machine), '
                   'or the torque changed; encoder named',
          figure='zero commanded after 20 mrad and', limit=50.0, unit='ms', tries=(3, 12),
          run=silence.try_frozen_encoders),
    Fault(name='numbers', fault='NaN, Inf, 1e308, wrong lengths in states and references',
          required='refused whole, torque bounded, zero if it lasts',
          figure='largest torque', limit=_LIMIT, unit='N m', tries=(40, 106),
          run=wrong_messages.try_numbers),
    Fault(name='commands', fault='NaN, Inf, 1e308, wrong lengths in commands',
          required='refused whole, torque bounded', figure='largest torque', limit=_LIMIT,
          unit='N m', tries=(14, 140), run=wrong_messages.try_commands),
    Fault(name='names', fault='names reordered, added, repeated, unknown, missing',
          required='mapped by name, or refused', figure='largest torque', limit=_LIMIT,
          unit='N m', tries=(1, 8), run=wrong_messages.try_names),
    Fault(name='clocks', fault='stamps jump by +-1000 s, err, are mixed; /clock stops',
          required='observer begins anew with a warning, no torque spike',
          figure='largest torque', limit=1.0, unit='N m', tries=(7, 21),
          run=clocks.try_stamps),
    Fault(name='parameters', fault='illegal parameters while moving',
          required='refused with a reason in 100 ms, 99 % of states answered meanwhile',
          figure='slowest answer', limit=100.0, unit='ms', tries=(150, 1000),
          run=wrong_messages.try_parameters),
    Fault(name='exceptions', fault='exception in a callback',
          required='one traceback, zero torque, FAULT reported, executor alive',
          figure='torque in FAULT', limit=0.0, unit='N m', tries=(3, len(exceptions.PLACES)),
          run=exceptions.try_exceptions),
    Fault(name='restart', fault='controller restarted while moving',
          required='resumes where the arm is', figure='resumed after', limit=5.0, unit='s',
          tries=(1, 5), run=lost_nodes.try_restarted_controller),
    Fault(name='lost-reference', fault='trajectory node killed while moving',
          required='held for 1 s, then let go in 0.5 s, as set',
          figure='zero torque after', limit=2.0, unit='s', tries=(1, 3),
          run=lost_nodes.try_lost_reference),
    Fault(name='two-controllers', fault='two controllers command at once',
          required='no torque within 50 ms, both named', figure='torque ends after',
          limit=50.0, unit='ms', tries=(1, 5), run=lost_nodes.try_two_controllers),
    Fault(name='two-trajectories', fault='two trajectory nodes send references at once',
          required='no torque within 50 ms, both named, resumes gently with one of them',
          figure='torque ends after', limit=50.0, unit='ms', tries=(2, 10),
          run=lost_nodes.try_two_trajectories),
    Fault(name='storms', fault='message storm on one topic after the other',
          required='99 % of ticks within 10 ms of each other, torque bounded',
          figure='time between ticks, p99', limit=10.0, unit='ms', tries=(2, 4),
          run=traffic.try_storms),
    Fault(name='mismatch', fault='endpoints whose quality of service does not fit',
          required='named within 3 s', figure='named after', limit=3.0, unit='s', tries=(2, 6),
          run=traffic.try_mismatch),
    Fault(name='emergency-stop', fault='emergency stop by topic and service, also in a storm',
          required='no torque within 20 ms, latched', figure='torque ends after', limit=20.0,
          unit='ms', tries=(4, 12), run=traffic.try_emergency_stop),
    Fault(name='signals', fault='SIGINT, SIGTERM to each node on a busy machine',
          required='last command zero, exit 0, no traceback', figure='slowest end', limit=10.0,
          unit='s', tries=(1, 3), run=lost_nodes.try_signals),
    Fault(name='bags', fault='recorder killed, disk full, bag cut, bits flipped, no metadata',
          required='at most 0.2 s lost, never fewer messages in silence',
          figure='lost at the end', limit=0.2, unit='s', tries=(5, 15), run=bags.try_bags))}


def try_fault(fault, tries, folder=None, priority=0):
    """
    Try one fault, ``tries`` times; return its Row.

    Logs and bags go to ``folder``, which the caller has made, or to one that is removed. A bench
    that fails is a problem of the row, not an exception.
    """
    tally, begin = Tally(), time.monotonic()
    with (nullcontext(folder) if folder else tempfile.TemporaryDirectory()) as place:
        try:
            with Bench(Path(place), priority) as bench:
                fault.run(bench, tries, tally)
        except Exception as error:  # noqa: B902  the other rows are tried all the same
            first = next(iter(str(error).splitlines()), '')
            tally.problems.append(f'the bench failed ({type(error).__name__}: {first})')
    return judged(fault, tally, time.monotonic() - begin, priority)


def figure_of(row):
    """Return the worst figure of a Row as text; 'none' where nothing was measured."""
    return 'none' if row.worst is None else f'{row.worst:.3g} {row.unit}'


def table(rows):
    """Return Rows as aligned lines of text, what is wrong below them."""
    cells = [('fault', 'tries', 'worst figure', 'limit', 'verdict')]
    cells += [(row.fault, str(row.tries), f'{row.figure} {figure_of(row)}',
               f'{row.limit:.4g} {row.unit}', row.verdict) for row in rows]
    widths = [max(len(cell[i]) for cell in cells) for i in range(5)]
    lines = ['  '.join(text.ljust(width) for text, width in zip(cell, widths, strict=True)
                       ).rstrip() for cell in cells]
    for row in rows:
        lines += [f'{row.name}: {problem}' for problem in dict.fromkeys(row.problems)]
        lines += [f'{row.name}: ({note})' for note in row.notes]
    return '\n'.join(lines)


def as_json(rows):
    """Return Rows as JSON text."""
    return json.dumps([asdict(row) for row in rows], indent=2)


def all_held(rows):
    """Return whether every row is as required."""
    return not any(row.verdict == FAILED for row in rows)
