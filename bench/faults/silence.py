# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Joint states stop, come again with the same stamp, or with the same angles and fresh stamps."""

from itertools import cycle, islice
import time

from bench.faults.rigs import CONTROLLER, HeldRobot, PERIOD, zero_after
from bench.faults.wire import NAMES, stamp_of
from gms_flex_control.control.frozen_encoders import TURNED
from sensor_msgs.msg import JointState

_LONG_ENOUGH = 0.3   # of silence [s]; the observer outlives it
_REMEMBERED = 0.3    # of the friction estimate before it, at least; a reset leaves nothing
_FAINT = 0.02        # an estimate too small to compare [N m]
_FAST = 0.25         # links move at least that fast when an encoder freezes [rad/s]
_LONGEST = 5.0       # until it is reported [s]
_AFTERWARDS = 0.5    # so long it stays after it was reported [s]


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


def try_frozen_encoders(bench, tries, tally):
    """Let angles stay the same in motion, their stamps going on."""
    robot = HeldRobot(bench)
    since_frozen = [_try_to_freeze(robot, *case, tally)
                    for case in islice(cycle(_FREEZES), tries)]
    tally.notes.append(f'{max(since_frozen):.3g} ms after an angle froze, at most')
    tally.expect(robot.controller.runs, 'the controller ended')


def _try_to_freeze(robot, name, angles, moving, tally):
    """Freeze angles once; return how long a torque came after that [ms], 0 if it may."""
    tally.tries += 1
    robot.settle()
    robot.until(lambda: min(map(abs, robot.message().velocity[:2])) > _FAST)
    before, begin, moment = _count(robot), robot.stamp, time.monotonic()
    robot.spoil = freeze = _Freeze(robot, angles, moving)
    named = robot.until(lambda: all(NAMES[k] in robot.diagnostics.sentence(CONTROLLER)
                                    for k in angles), _LONGEST)
    tally.expect(named, f'{name}: the controller says {robot.diagnostics.sentence(CONTROLLER)!r}')
    later = robot.run(_AFTERWARDS)
    tally.expect(not robot.largest(later), f'{name}: a torque though it was reported')
    torques = [stamp_of(one) for _, one in robot.commands.since(moment) if any(one.data)]
    zero = max(torques, default=begin) + PERIOD
    if moving:  # the other way round it hangs on the torque
        tally.figure(max(0, zero - (freeze.wrong or zero)) / 1e6)
    robot.spoil = lambda message: None
    tally.expect(robot.settle(), f'{name}: no motion once the angles change again')
    tally.expect(robot.until(lambda: _count(robot) > before, 3.0), f'{name}: it is not counted')
    return (zero - begin) / 1e6 if moving else 0.0


def _count(robot):
    return robot.diagnostics.figure(CONTROLLER, 'frozen encoders')


# what freezes, which of the angles, and whether their velocities go on
_FREEZES = (('a link', (0,), True), ('a motor without its velocity', (3,), False),
            ('all angles', (0, 1, 2, 3), True), ('a motor', (2,), True))


class _Freeze:
    """
    Replaces some angles of a state by those of now, and their velocities by zero if asked.

    From the stamp ``wrong`` [ns] on one of the angles is further off than a velocity may explain.
    """

    def __init__(self, robot, angles, moving):
        self._angles, self._moving = angles, moving
        self._held, self.wrong = list(robot.message().position), None

    def __call__(self, message):
        for k in self._angles:
            if self.wrong is None and abs(message.position[k] - self._held[k]) > TURNED:
                self.wrong = stamp_of(message)
            message.position[k] = self._held[k]
            if not self._moving:
                message.velocity[k] = 0.0
