# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Joint states stop, or come again and again with the same stamp."""

import time

from gms_flex_control.nodes.faults.rigs import CONTROLLER, HeldRobot, zero_after
from sensor_msgs.msg import JointState

_LONG_ENOUGH = 0.3   # of silence [s]; the observer outlives it
_REMEMBERED = 0.3    # of the friction estimate before it, at least; a reset leaves nothing
_FAINT = 0.02        # an estimate too small to compare [N m]


def try_silence(bench, tries, tally):
    """Keep the states back, or repeat one; the controller has to let go and remember."""
    robot = HeldRobot(bench)
    estimates = bench.listen(JointState, f'{CONTROLLER}/state')
    for k in range(tries):
        robot.settle()
        robot.run(0.2)
        tally.tries += 1
        before = list(estimates[-1].effort) if estimates else []
        repeated = robot.message() if k % 2 else None
        last = time.monotonic()
        robot.quiet = True
        while time.monotonic() < last + _LONG_ENOUGH:
            if repeated is not None:
                robot.states.publish(repeated)
            robot.step()
        zero = zero_after(robot.commands, last)
        if zero is None:
            tally.expect(False, 'no zero was commanded')
        else:
            tally.figure((zero - last) * 1e3)
            tally.expect(not robot.largest(zero), 'a torque came after the zero')
        seen = len(estimates)
        robot.quiet = False
        tally.expect(robot.until(lambda seen=seen: len(estimates) > seen),
                     'the controller did not go on')
        if before and len(estimates) > seen:
            _compare(tally, before, list(estimates[seen].effort))
    tally.expect(robot.controller.runs, 'the controller ended')


def _compare(tally, before, after):
    kept = all(abs(a) >= _REMEMBERED * abs(b) or abs(b) < _FAINT
               for b, a in zip(before, after, strict=True))
    tally.expect(kept, f'the observer forgot: friction {before} N m before, {after} after')
