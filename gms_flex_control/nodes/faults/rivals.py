# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""References of two nodes at once."""

import time

from gms_flex_control.nodes.faults.bench import REFERENCE
from gms_flex_control.nodes.faults.lost_nodes import first_torques, GENTLE, zero_applied
from gms_flex_control.nodes.faults.rigs import CONTROLLER, largest_torque, Loop, PERIOD
from gms_flex_control.nodes.faults.wire import stamp_of
from gms_flex_control.nodes.messages import DERIVATIVE, ReferenceWriter
import numpy as np
from std_msgs.msg import Float64MultiArray

_RIVAL = '/rival#1'
_TOGETHER = 0.3   # both send so long [s]
_START = 30.0     # of a node, until it is heard [s]


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
        tally.expect(most <= GENTLE, f'it resumed with {most:.2g} N m')
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
    """Start a second trajectory node; end the first once no torque flows."""
    first = loop.trajectory
    loop.start_trajectory(name)
    names = [f'/trajectory#{node.process.pid}' for node in (first, loop.trajectory)]
    end = time.monotonic() + _START
    loop.bench.until(lambda: all(name in loop.diagnostics.sentence(CONTROLLER) for name in names)
                     or time.monotonic() > end)
    _expect_named(loop, tally, *names)
    begin = loop.run(_TOGETHER)
    tally.expect(zero_applied(loop, begin), 'two trajectory nodes, and torque goes on')
    first.kill()


def _expect_named(loop, tally, *names):
    told = loop.diagnostics.sentence(CONTROLLER)
    tally.expect(all(name in told for name in names),
                 f'the controller does not name both: {told!r}')
