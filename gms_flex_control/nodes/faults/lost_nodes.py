# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Nodes that are killed, frozen and started again, or there twice, while the arm moves."""

import signal
import time

from gms_flex_control.nodes.faults.rigs import largest_torque, Loop, PLANT
from gms_flex_control.nodes.messages import to_nanoseconds
import numpy as np

_GONE = 0.3          # how long a controller is missed before it is started again [s]
_BEGINNING = 0.05    # of a resumed motion [s]
GENTLE = 1.2         # largest torque then [N m]; the limit of the controller is 2
_HOLD, _RELAX = 1.0, 0.5  # of a lost reference here [s]
_STILL = 0.02        # a held arm moves less [rad]


def torque_of(state):
    """Return the torques the plant says it applied (n,) [N m]."""
    return np.abs(state.effort[2:])


def zero_applied(loop, moment):
    """Return when the plant's torque became zero for good after ``moment`` [s]; None if never."""
    when = None
    for time_of, state in loop.states.since(moment):
        if torque_of(state).any():
            when = None
        elif when is None:
            when = time_of
    return when


def try_dead_controller(bench, tries, tally):
    """Kill the controller, or freeze it, in turn."""
    loop = Loop(bench)
    for k in range(tries):
        tally.tries += 1
        process = loop.controller.process
        begin = time.monotonic()
        process.send_signal(signal.SIGKILL if k % 2 else signal.SIGSTOP)
        loop.run(_GONE)
        zero = zero_applied(loop, begin)
        tally.figure((zero - begin) * 1e3 if zero else np.inf)
        told = loop.diagnostics.sentence(PLANT)
        tally.expect('no command from /cascade_controller' in told and ' ms' in told,
                     f'the plant says {told!r} of a silence')
        if k % 2:
            process.wait()
            loop.start_controller(f'controller_node.{k}')
        else:
            process.send_signal(signal.SIGCONT)
        bench.until(loop.moves)
        loop.run(_GONE)
    tally.expect(loop.plant.runs and loop.trajectory.runs, 'a node has ended')


def try_restarted_controller(bench, tries, tally):
    """Kill the controller and start another: it has to begin where the arm is."""
    loop = Loop(bench)
    for k in range(tries):
        tally.tries += 1
        loop.controller.kill()
        loop.run(_GONE)
        begin = time.monotonic()
        loop.start_controller(f'controller_node.{k}')
        bench.until(lambda begin=begin: _pushed(loop, begin))
        tally.figure(_pushed(loop, begin)[0][0] - begin)
        loop.run(0.5)
        most = first_torques([(to_nanoseconds(state.header.stamp), torque_of(state).max())
                              for _, state in _pushed(loop, begin)])
        tally.expect(most <= GENTLE, f'it resumed with {most:.2g} N m')
        bench.until(loop.moves)


def _pushed(loop, begin):
    """
    Return (time, state) of the plant's states with torque since a moment.

    What the new controller sends would tell less: the bench may discover it seconds later than
    the plant does.
    """
    return [(when, state) for when, state in loop.states.since(begin) if torque_of(state).any()]


def first_torques(stamped):
    """Return the largest of (stamp [ns], torque [N m]) in which a motion begins [N m]."""
    end = stamped[0][0] + _BEGINNING * 1e9
    return max(torque for stamp, torque in stamped if stamp < end)


def try_lost_reference(bench, tries, tally):
    """Kill the trajectory node; the arm has to be held, let go, and taken up again."""
    loop = Loop(bench, controller_parameters={'reference_hold': _HOLD,
                                              'reference_relax': _RELAX})
    for _ in range(tries):
        tally.tries += 1
        loop.run(1.0)
        begin = time.monotonic()
        loop.trajectory.kill()
        loop.run(0.8 * _HOLD)
        late = [state for when, state in loop.states.since(begin + 0.6 * _HOLD)]
        tally.expect(any(torque_of(state).any() for state in late), 'the arm was not held')
        moved = np.ptp([state.position[:2] for state in late], axis=0).max()
        if loop.stalled(begin):
            tally.notes.append('the machine was too busy to tell whether the arm was held still')
        else:
            tally.expect(moved < _STILL, f'the held arm moved by {moved:.3g} rad')
        loop.run(0.5 * _HOLD + _RELAX + 0.5)
        zero = zero_applied(loop, begin)
        tally.figure(zero - begin if zero else np.inf)
        tally.expect(zero is None or zero - begin > _HOLD, 'it was let go too soon')
        loop.start_trajectory()
        bench.until(loop.moves)
    tally.expect(loop.controller.runs and loop.plant.runs, 'a node has ended')


def try_two_controllers(bench, tries, tally):
    """Start a second controller beside the first."""
    loop = Loop(bench)
    for k in range(tries):
        tally.tries += 1
        first = loop.controller
        known = len(loop.commands)
        loop.start_controller(f'controller_node.second{k}')
        second = loop.controller
        bench.until(lambda known=known, pid=second.process.pid: _heard(loop, known, pid))
        begin = next(when for when, command in zip(
            loop.commands.times[known:], loop.commands[known:], strict=True)
            if _is_from(command, second.process.pid))
        loop.run(_GONE)
        zero = zero_applied(loop, begin)
        tally.figure((zero - begin) * 1e3 if zero else np.inf)
        told = loop.diagnostics.sentence(PLANT)
        tally.expect(str(first.process.pid) in told and str(second.process.pid) in told,
                     f'the plant does not name both: {told!r}')
        first.kill()
        bench.until(loop.moves)
        loop.run(_GONE)
    tally.expect(largest_torque(loop.commands.since(0.0)) < np.inf, 'a command is not finite')


def _is_from(message, pid):
    return any(dim.label.endswith(f'#{pid}') for dim in message.layout.dim)


def _heard(loop, known, pid):
    return any(_is_from(command, pid) for command in loop.commands[known:])
