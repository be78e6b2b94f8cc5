# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Nodes that are killed, frozen, ended and started again, or there twice, while the arm moves."""

import signal
import sys
import time

from bench.faults.node_bench import REFERENCE
from bench.faults.rigs import CONTROLLER, largest_torque, Loop, PERIOD, PLANT
from bench.faults.wire import stamp_of
from gms_flex_control.nodes.messages import DERIVATIVE, ReferenceWriter, to_nanoseconds
import numpy as np
from std_msgs.msg import Float64MultiArray

_GONE = 0.3          # how long a controller is missed before it is started again [s]
_BEGINNING = 0.05    # of a resumed motion [s]
_GENTLE = 1.2         # largest torque then [N m]; the limit of the controller is 2
_HOLD, _RELAX = 1.0, 0.5  # of a lost reference here [s]
_STILL = 0.02        # a held arm moves less [rad]
_SIGNALS = ((signal.SIGINT,), (signal.SIGTERM,), (signal.SIGINT, signal.SIGTERM))
_BUSY = 'while True: pass'
_RIVAL, _SECOND = '/rival#1', 'second'
_TOGETHER = 0.3      # two trajectory nodes send so long [s]
_START = 30.0        # of a node, until it is heard [s]


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
        reported = loop.diagnostics.sentence(PLANT)
        tally.expect('no command from /cascade_controller' in reported and ' ms' in reported,
                     f'the plant says {reported!r} of a silence')
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
        tally.expect(most <= _GENTLE, f'it resumed with {most:.2g} N m')
        bench.until(loop.moves)


def _pushed(loop, begin):
    """
    Return (time, state) of the plant's states with torque since a moment.

    What the new controller sends would show less: the bench may discover it seconds later than
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
            tally.notes.append('the machine was too busy to show whether the arm was held still')
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
    """Start a second controller, of another name, beside the first."""
    loop = Loop(bench)
    for k in range(tries):
        tally.tries += 1
        first = loop.controller
        known = len(loop.commands)
        loop.start_controller(f'controller_node.second{k}', ('-r', f'__node:={_SECOND}'))
        second, loop.controller = loop.controller, first
        bench.until(lambda known=known, pid=second.process.pid: _heard(loop, known, pid))
        begin = next(when for when, command in zip(
            loop.commands.times[known:], loop.commands[known:], strict=True)
            if _is_from(command, second.process.pid))
        loop.run(_GONE)
        zero = zero_applied(loop, begin)
        tally.figure((zero - begin) * 1e3 if zero else np.inf)
        reported = loop.diagnostics.sentence(PLANT)
        tally.expect(str(first.process.pid) in reported and str(second.process.pid) in reported,
                     f'the plant does not name both: {reported!r}')
        second.kill()
        loop.run(_GONE)
        loop.release()
    tally.expect(largest_torque(loop.commands.since(0.0)) < np.inf, 'a command is not finite')


def _is_from(message, pid):
    return any(dim.label.endswith(f'#{pid}') for dim in message.layout.dim)


def _heard(loop, known, pid):
    return any(_is_from(command, pid) for command in loop.commands[known:])


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


def try_two_trajectories(bench, tries, tally):
    """Send references beside the trajectory node, from here and from a second one in turn."""
    loop = Loop(bench)
    publisher = bench.speak(Float64MultiArray, REFERENCE)
    bench.until(publisher.get_subscription_count)
    for k in range(tries):
        tally.tries += 1
        if k % 2:
            _start_second(loop, f'trajectory_node.second{k}', tally)
        else:
            _send_beside(loop, publisher, tally)
        resumed = time.monotonic()
        bench.until(loop.moves)
        loop.run(_TOGETHER)
        most = first_torques([(stamp_of(pair[1]), largest_torque([pair]))
                              for pair in loop.commands.since(resumed) if any(pair[1].data)])
        tally.expect(most <= _GENTLE, f'it resumed with {most:.2g} N m')
    tally.expect(loop.controller.runs and loop.plant.runs, 'a node has ended')


def _send_beside(loop, publisher, tally):
    """Ask for rest at zero in the next sample, sample by sample, as another source."""
    writer, seen, begin = ReferenceWriter(2, _RIVAL), [None], time.monotonic()

    def over():
        stamp = stamp_of(loop.states[-1])
        if stamp != seen[-1]:
            seen.append(stamp)
            publisher.publish(writer.write(np.zeros((5, 2)), DERIVATIVE, stamp + PERIOD))
        return time.monotonic() > begin + _TOGETHER
    loop.bench.until(over)
    zero = zero_applied(loop, begin)
    tally.figure((zero - begin) * 1e3 if zero else np.inf)
    _expect_named(loop, tally, _RIVAL, f'/trajectory#{loop.trajectory.process.pid}')


def _start_second(loop, name, tally):
    """Start a second trajectory node, of another name; end it once no torque flows."""
    first = loop.trajectory
    loop.start_trajectory(name, arguments=('-r', f'__node:={_SECOND}'))
    second, loop.trajectory = loop.trajectory, first
    names = [f'/trajectory#{first.process.pid}', f'/{_SECOND}#{second.process.pid}']
    end = time.monotonic() + _START
    loop.bench.until(lambda: all(name in loop.diagnostics.sentence(CONTROLLER) for name in names)
                     or time.monotonic() > end)
    _expect_named(loop, tally, *names)
    begin = loop.run(_TOGETHER)
    tally.expect(zero_applied(loop, begin), 'two trajectory nodes, and torque goes on')
    second.kill()


def _expect_named(loop, tally, *names):
    reported = loop.diagnostics.sentence(CONTROLLER)
    tally.expect(all(name in reported for name in names),
                 f'the controller does not name both: {reported!r}')
